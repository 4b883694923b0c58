"""Where on a road map a track may have been: a search over the whole map and all headings.

Whoever drives is on a road and looks along it. So the straightest point of a piece of the track (the anchor) is laid on
every point of every road, in both directions and at headings a few degrees around: some hundred thousand places on a
town instead of a billion cells and headings, and the time grows with the length of the roads, not with the area of the
map. Each place is scored by how much of the track around the anchor lies on roads that run its way, in an order that
gives up early what cannot become good (as branch and bound does in the scan matchers of Olson 2009 and Hess et al.
2016). The best of them climb to the top of their hill, and are ranked anew with the intersections that were seen.
That the shape of a track alone finds it on a map is due to Brubaker, Geiger and Urtasun 2013 ("Lost!").

A long track is searched by several pieces of it: one of them may lie on a road that the map does not have, and drift
bends the whole.
"""

from collections.abc import Iterator

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.geometry import rotate_2d
from interloc.kernels.roads import score_poses
from interloc.localization.roads import NO_ROAD, RoadMap, RoadRaster
from interloc.localization.track import Sightings, Track, resample

STEP_M = 8.0
ALONG_M = 4.0
TURNS_RAD = np.radians(np.arange(-12.0, 12.1, 3.0))

_FIRST_REACH_M = 200.0  # the track this far around the anchor is compared first ...
_REACH_M = 400.0  # ... and this far by the climb
_SIGMA_M = 5.0  # roads as blurred as the places are apart
_FAR_SIGMA_M = 10.0  # beyond the reach drift counts
_WRONG_WAY = 0.25
_HOPELESS = 0.55
_LANDMARK_SIGMA_M = 5.0
_FAR_SHARE, _LANDMARK_SHARE = 0.5, 0.7
_FIRST_KEPT = 4000
_CHUNK = 400_000
_CLIMB = ((3.0, np.radians(2.0)), (3.0, np.radians(2.0)), (3.0, np.radians(2.0)), (1.5, np.radians(1.0)))
_NEIGHBOURS = np.vstack([np.eye(3), -np.eye(3)])
_SAME_PLACE_M, _SAME_TURN_RAD = 12.0, np.radians(9.0)


def guess(track: Track, sightings: Sightings, roads: RoadMap, *, kept: int) -> Iterator[tuple[float, FloatArray]]:
    """Search a map for a track: once per kilometre, three times at most, each around the straightest point there.

    On a straight the heading of the vehicle is that of the road; in a curve it may be anything. Yields for each such
    anchor the distance driven there, and (C, 3) places and directions of motion of it in M, best first: `kept` for one
    anchor, fewer for each of several.
    """
    at_m, points = resample(track, STEP_M)
    bend = np.convolve(np.abs(np.gradient(points[:, 2])), np.ones(5), "same")
    pieces = int(np.clip(round(at_m[-1] / 1000.0), 1, 3))
    for piece in range(pieces):
        first, last = (round((piece + share) / pieces * (len(points) - 1)) for share in (1 / 3, 2 / 3))
        row = first + int(np.argmin(bend[first : last + 1]))
        yield float(at_m[row]), _guess_around(row, at_m, points, sightings, roads, round(kept / pieces**0.5))


def _guess_around(
    row: int, at_m: FloatArray, points: FloatArray, sightings: Sightings, roads: RoadMap, kept: int
) -> FloatArray:
    raster, turn, away = roads.raster, float(points[row, 2]), np.abs(at_m - at_m[row])
    relative = np.column_stack([rotate_2d(points[:, :2] - points[row, :2], -turn), points[:, 2] - turn])
    pose, score = _exhaust(_shuffled(relative[away <= _FIRST_REACH_M]), roads)
    pose, score = _distinct(pose, score, _FIRST_KEPT)
    pose, score = _climb(_shuffled(relative[away <= _REACH_M]), pose, raster)
    score = score + _FAR_SHARE * _score_tracks(relative, pose, raster, _FAR_SIGMA_M)
    if len(sightings) and len(roads.node_xy):
        local = rotate_2d(sightings.xy - points[row, :2], -turn)
        score = score + _LANDMARK_SHARE * _landmarks(local, pose, roads)
    return _distinct(pose, score, kept)[0]


def _score_tracks(
    relative: FloatArray, pose: FloatArray, raster: RoadRaster, sigma_m: float, hopeless: float = 0.0
) -> FloatArray:
    """Return how well a track, (P, 3) seen from its anchor, lies on the roads with that at each of (H, 3) poses."""
    weight = np.exp(-0.5 * (np.arange(256) / 10.0 / sigma_m) ** 2)
    weight[NO_ROAD] = 0.0
    return score_poses(
        raster.distance,
        raster.directions,
        raster.origin,
        raster.cell_m,
        np.ascontiguousarray(relative),
        np.ascontiguousarray(pose),
        weight,
        _WRONG_WAY,
        hopeless,
    )


def _exhaust(relative: FloatArray, roads: RoadMap) -> tuple[FloatArray, FloatArray]:
    """Score the anchor every `ALONG_M` along all roads, both ways; return the places, (H, 3), that are not hopeless."""
    a, b = roads.segments[:, :2], roads.segments[:, 2:]
    span = b - a
    count = np.maximum(1, np.round(np.hypot(*span.T) / ALONG_M)).astype(np.int64)
    segment = np.repeat(np.arange(len(a)), count)
    share = (np.arange(len(segment)) - (np.cumsum(count) - count)[segment] + 0.5) / count[segment]
    xy, heading = a[segment] + share[:, None] * span[segment], np.arctan2(span[:, 1], span[:, 0])[segment]
    everywhere = np.concatenate([np.column_stack([xy, heading]), np.column_stack([xy, heading + np.pi])])
    per_chunk = max(1, _CHUNK // len(TURNS_RAD))
    poses, scores = [], []
    for first in range(0, len(everywhere), per_chunk):
        part = np.repeat(everywhere[first : first + per_chunk], len(TURNS_RAD), axis=0)
        part[:, 2] += np.tile(TURNS_RAD, len(part) // len(TURNS_RAD))
        score = _score_tracks(relative, part, roads.raster, _SIGMA_M, _HOPELESS)
        good = score > 0.0
        poses.append(part[good])
        scores.append(score[good])
    return np.concatenate(poses), np.concatenate(scores)


def _climb(relative: FloatArray, pose: FloatArray, raster: RoadRaster) -> tuple[FloatArray, FloatArray]:
    """Move each of (H, 3) places to the best of its neighbours, with shrinking steps."""
    score = _score_tracks(relative, pose, raster, _SIGMA_M)
    rows = np.arange(len(pose))
    for step_m, step_rad in _CLIMB:
        trial = pose[:, None] + _NEIGHBOURS * [step_m, step_m, step_rad]
        each = _score_tracks(relative, trial.reshape(-1, 3), raster, _SIGMA_M).reshape(len(pose), -1)
        best = each.argmax(axis=1) if len(pose) else np.zeros(0, dtype=np.int64)
        better = each[rows, best] > score
        pose = np.where(better[:, None], trial[rows, best], pose)
        score = np.where(better, each[rows, best], score)
    return pose, score


def _landmarks(local: FloatArray, pose: FloatArray, roads: RoadMap) -> FloatArray:
    """Return the share of (J, 2) intersections seen that lie at nodes, softly, for each of (H, 3) places."""
    at = rotate_2d(local[None], pose[:, None, 2]) + pose[:, None, :2]
    distance, _ = roads.nodes.nearest(at.reshape(-1, 2), 4.0 * _LANDMARK_SIGMA_M)
    near = np.exp(-0.5 * (np.minimum(distance, 1e6) / _LANDMARK_SIGMA_M) ** 2)
    share: FloatArray = near.reshape(len(pose), -1).mean(axis=1)
    return share


def _distinct(pose: FloatArray, score: FloatArray, kept: int) -> tuple[FloatArray, FloatArray]:
    """Keep the best place of each small cell of position and heading, best first."""
    order = np.argsort(-score, kind="stable")
    cells = np.column_stack(
        [np.floor(pose[order, :2] / _SAME_PLACE_M), np.floor(pose[order, 2] % (2 * np.pi) / _SAME_TURN_RAD)]
    ).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    rows: IntArray = order[np.sort(first)[:kept]]
    return pose[rows], score[rows]


def _shuffled(relative: FloatArray) -> FloatArray:
    """Return the points of a track in an order in which few of them already tell how the rest will do."""
    return relative[np.random.default_rng(0).permutation(len(relative))]
