"""Which sightings of several drives are of the same place."""

from __future__ import annotations

import numpy as np

from interloc.arrays import FloatArray, IntArray, distinct
from interloc.city.settings import CityConfig
from interloc.mapping.clustering import cells_of, find_peaks, join_peaks

LINK_M = 8.0
"""Sightings farther apart than this, and not linked by others between them, have no say about each other."""

CELL_M = 1.0
"""Sightings in one cell of this side are linked as one, and not told apart where their density is looked at."""

_SIMPLE_M = 3.0  # radius within which sightings are one place whatever their density


def linked(xy: FloatArray) -> IntArray:
    """Return the neighbourhood of each of (N, 2) sightings, (N,) from 0: what is linked by steps of `LINK_M`."""
    from scipy.sparse import coo_array  # noqa: PLC0415 - slow to import
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415
    from scipy.spatial import cKDTree  # noqa: PLC0415

    if not len(xy):
        return np.zeros(0, dtype=np.int64)
    cell = cells_of(xy, CELL_M)
    corner = np.zeros((int(cell.max()) + 1, 2))
    corner[cell] = np.floor(xy / CELL_M) * CELL_M
    i, j = cKDTree(corner).query_pairs(LINK_M, output_type="ndarray").T
    _, label = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(len(corner),) * 2), directed=False)
    return label[cell].astype(np.int64)


def group(xy: FloatArray, drive: IntArray, neighbourhood: IntArray, config: CityConfig) -> IntArray:
    """Group sightings by place.

    Parameters
    ----------
    xy : (N, 2) float64
        Metres, roughly without the offsets of the drives.
    drive : (N,) int64
    neighbourhood : (N,) int64
        Of `linked`; whole ones.
    config

    Returns
    -------
    (N,) int64
        Number of the place, from 0.

    Notes
    -----
    A neighbourhood that no drive saw twice, and that is small, is one place. In all others the peaks of the density of
    the sightings are joined, closest first, unless drives saw them side by side: the steps by which the detections of
    one drive are fused, with drives instead of keyframes. Nothing depends on the order.
    """
    count = int(neighbourhood.max(initial=-1)) + 1
    if not count:
        return neighbourhood.copy()
    size = np.bincount(neighbourhood, minlength=count)
    middle = np.stack([np.bincount(neighbourhood, xy[:, i], count) / size for i in (0, 1)], axis=-1)
    reach = np.zeros(count)
    np.maximum.at(reach, neighbourhood, np.hypot(*(xy - middle[neighbourhood]).T))
    drives = int(drive.max()) + 1
    seen_once = np.bincount(distinct(neighbourhood * drives + drive) // drives, minlength=count) == size
    simple = (seen_once & (reach <= _SIMPLE_M))[neighbourhood]
    place = neighbourhood.copy()
    rest = np.flatnonzero(~simple)
    ones = np.ones(len(rest))
    peaks = find_peaks(xy[rest], ones, bandwidth_m=config.bandwidth_m, cell_m=CELL_M)
    joined = join_peaks(peaks, xy[rest], ones, drive[rest], radius_m=config.gate_m, together=config.together)
    place[rest] = count + joined
    return np.unique(place, return_inverse=True)[1].reshape(-1).astype(np.int64)
