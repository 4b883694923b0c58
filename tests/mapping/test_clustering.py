"""Heaps of points that are clear by eye."""

import numpy as np

from interloc.mapping.clustering import assign, find_peaks, join_peaks


def test_peaks_of_two_heaps() -> None:
    xy = np.array([[0.0, 0.0], [0.4, 0.0], [0.0, 0.9], [8.0, 0.0], [8.3, 0.3], [30.0, 0.0]])
    labels = find_peaks(xy, np.ones(6), bandwidth_m=2.0)
    assert labels[0] == labels[1] == labels[2]
    assert labels[3] == labels[4]
    assert len({labels[0], labels[3], labels[5]}) == 3


def test_heaps_join_unless_seen_side_by_side() -> None:
    xy = np.array([[0.0, 0.0], [0.0, 0.0], [6.0, 0.0], [6.0, 0.0]])
    labels = np.array([0, 0, 1, 1])

    def join(keyframe: list[int], radius_m: float = 10.0) -> list[int]:
        return join_peaks(labels, xy, np.ones(4), np.array(keyframe), radius_m=radius_m, together=0.15).tolist()

    assert join([0, 1, 2, 3]) == [0, 0, 0, 0]
    assert join([0, 1, 1, 3]) == [0, 0, 1, 1]
    assert join([0, 1, 2, 3], radius_m=5.0) == [0, 0, 1, 1]


def test_a_chain_does_not_grow_beyond_the_radius() -> None:
    xy = np.stack([np.arange(6) * 7.0, np.zeros(6)], axis=-1)
    joined = join_peaks(np.arange(6), xy, np.ones(6), np.arange(6), radius_m=10.0, together=0.15)
    for group in range(joined.max() + 1):
        assert np.ptp(xy[joined == group, 0]) <= 10.0


def test_a_centre_takes_one_detection_of_a_keyframe() -> None:
    centres = np.array([[0.0, 0.0], [12.0, 0.0]])
    xy = np.array([[1.0, 0.0], [3.0, 0.0], [5.0, 0.0], [40.0, 0.0]])
    assert assign(xy, np.array([0, 0, 1, 1]), centres, radius_m=10.0).tolist() == [0, 1, 0, -1]
    assert assign(xy, np.array([0, 0, 1, 1]), centres[:1], radius_m=10.0).tolist() == [0, -1, 0, -1]
