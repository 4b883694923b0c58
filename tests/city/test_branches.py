"""Branches of many places at once are those that one place alone has."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from interloc.city.branches import SAME_DEG, SeenBranches, fuse_branches
from interloc.mapping.estimation import fuse_bearings, fuse_widths


def test_they_are_those_of_each_place_alone() -> None:
    rng = np.random.default_rng(5)
    place = np.repeat(np.arange(30), 6)
    true = [np.sort(rng.choice([0, 60, 120, 180, 240, 300], rng.integers(2, 5), replace=False)) for _ in range(30)]
    bearings = [(true[p][rng.random(len(true[p])) < 0.8] + rng.normal(0, 4)) % 360 for p in place.tolist()]
    widths = [np.where(rng.random(len(each)) < 0.8, rng.uniform(4, 9, len(each)), np.nan) for each in bearings]
    found = fuse_branches(
        SeenBranches(
            bearing_deg=np.concatenate(bearings),
            width_m=np.concatenate(widths),
            sighting=np.repeat(np.arange(180), [len(each) for each in bearings]),
            place=place,
            drive=np.tile([0, 1, 2], 60),
        ),
        0.3,
    )
    for number, (angles, wide, drives) in enumerate(found):
        rows = np.flatnonzero(place == number).tolist()
        own = [bearings[row] for row in rows]
        alone = fuse_bearings(own, np.ones(6), spread_deg=8, separation_deg=25, support=0.3)
        assert_allclose(angles, alone, atol=1e-9)
        assert_allclose(wide, fuse_widths(alone, own, [widths[r] for r in rows], np.ones(6), within_deg=12.5))
        for angle, count in zip(alone.tolist(), drives.tolist(), strict=True):
            saw = {row % 3 for row in rows if (np.abs((bearings[row] - angle + 180) % 360 - 180) <= SAME_DEG).any()}
            assert count == len(saw)
