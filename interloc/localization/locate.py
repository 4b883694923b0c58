"""Placing a drive on a road map without GNSS: search, bend, compare, decide."""

import itertools
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Any

import numpy as np

from interloc.arrays import FloatArray, IntArray, JsonObject
from interloc.drive import Drive, Georeference
from interloc.errors import ConfigError, expect
from interloc.geometry import bearing_deg, rotate_2d, rotation_from_rpy, wrap_angle
from interloc.kernels.roads import score_poses
from interloc.localization.evidence import MIN_LENGTH_M, Decision, Evidence, decide, evidence_of, too_short
from interloc.localization.refine import Chain, Fit, fit, uncertainty
from interloc.localization.roads import NO_ROAD, Nodes, RoadMap, RoadRaster, road_map
from interloc.localization.track import NO_SIGHTINGS, Sightings, Track, resample, sightings_of, track_of
from interloc.osm.graph import RoadGraph
from interloc.processes import Progress
from interloc.results import DriveResult

# Where on a road map a track may have been: a search over the whole map and all headings.
#
# Whoever drives is on a road and looks along it. So the straightest point of a piece of the track (the anchor) is
# laid on every point of every road, in both directions and at headings a few degrees around: some hundred thousand
# places on a town instead of a billion cells and headings, and the time grows with the length of the roads, not with
# the area of the map. Each place is scored by how much of the track around the anchor lies on roads that run its way,
# in an order that gives up early what cannot become good (as branch and bound does in the scan matchers of Olson 2009
# and Hess et al. 2016). The best of them climb to the top of their hill, and are ranked anew with the intersections
# that were seen. That the shape of a track alone finds it on a map is due to Brubaker, Geiger and Urtasun 2013
# ("Lost!").
#
# A long track is searched by several pieces of it: one of them may lie on a road that the map does not have, and drift
# bends the whole.

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
        each = _score_tracks(relative, trial.reshape(-1, 3), raster, _SIGMA_M).reshape(-1, len(_NEIGHBOURS))
        best = each.argmax(axis=1)
        better = each[rows, best] > score
        pose = np.where(better[:, None], trial[rows, best], pose)
        score = np.where(better, each[rows, best], score)
    return pose, score


def _landmarks(local: FloatArray, pose: FloatArray, roads: RoadMap) -> FloatArray:
    """Return the share of (J, 2) intersections seen that lie at nodes, softly, for each of (H, 3) places."""
    at = rotate_2d(local[None], pose[:, None, 2]) + pose[:, None, :2]
    distance, _ = roads.nodes.nearest(at.reshape(-1, 2), 4.0 * _LANDMARK_SIGMA_M)
    near = np.exp(-0.5 * (np.minimum(distance, 1e6) / _LANDMARK_SIGMA_M) ** 2)
    share: FloatArray = near.reshape(-1, len(local)).mean(axis=1)
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


_KEPT = 60
_QUICK_ROUNDS, _ROUNDS = 4, 12
_BENT_FULLY = 12
_ELSEWHERE_M, _ELSEWHERE_RAD = 25.0, 0.5
_LISTED = 8
_MAP_STD_M = 0.7  # of the map itself: what the errors on eight KITTI sequences have beyond those of the fit


@dataclass(frozen=True)
class Place:
    """A place on the map where a drive may have been."""

    lonlat: FloatArray
    """(2,) float64: of the first scan, degrees."""
    heading_deg: float
    """Of the motion there, clockwise from north."""
    middle_lonlat: FloatArray
    """(2,) float64: of the middle of the drive: what lies apart there is another place."""
    evidence: Evidence
    track_lonlat: FloatArray
    """(n, 2) float64: the drive if it was here, every ten metres."""

    @property
    def score(self) -> float:
        """Of its evidence."""
        return self.evidence.score

    def record(self) -> JsonObject:
        """Return it as JSON holds it."""
        evidence = self.evidence
        return {
            "lat_deg": round(float(self.lonlat[1]), 7),
            "lon_deg": round(float(self.lonlat[0]), 7),
            "heading_deg": round(self.heading_deg, 1),
            "middle_lat_deg": round(float(self.middle_lonlat[1]), 7),
            "middle_lon_deg": round(float(self.middle_lonlat[0]), 7),
            "score": round(self.score, 3),
            "on_roads": round(evidence.road, 3),
            "intersections_seen": evidence.seen,
            "intersections_at_nodes": evidence.at_nodes,
            "branches_agreeing": round(evidence.branches, 3),
            "nodes_passed": evidence.passed,
            "nodes_missed": evidence.missed,
        }


@dataclass(frozen=True)
class Location:
    """Where a drive was, or why that is not known."""

    decision: Decision
    places: list[Place]
    """Best first, all apart from each other; the first is where it was if the decision is "found"."""
    chance: float = 0.0
    """Best score of the drive seen in a mirror."""
    georeference: Georeference | None = None
    """Of every scan, where found. Heights are those of the poses, over the first scan."""
    position_std_m: FloatArray | None = None
    """(N,) one sigma of the position of each scan: root of the mean variance of east and north, the map included."""
    heading_std_deg: FloatArray | None = None
    leaving_out: dict[int, Georeference] = field(default_factory=dict)
    """The same without the use of one node of the map, by its OSM id: what scores that node fairly."""
    facts: JsonObject = field(default_factory=dict)
    """Size of drive and map, seconds; for run.json."""

    def __repr__(self) -> str:
        best = ""
        if self.places:
            lon, lat = self.places[0].lonlat.tolist()
            best = f", best {lat:.5f}, {lon:.5f} (latitude, longitude), score {self.places[0].score:.2f}"
        return f"<Location {self.decision.outcome}: {len(self.places)} places{best}>"

    def record(self) -> JsonObject:
        """Return it as JSON holds it; `run.json` and `--json` do."""
        deviations = {"position_std_m": self.position_std_m, "heading_std_deg": self.heading_std_deg}
        return {
            "outcome": self.decision.outcome,
            "reason": self.decision.reason,
            "advice": self.decision.advice,
            "chance_score": round(self.chance, 3),
            "places": [place.record() for place in self.places],
            **{name: None if std is None else round(float(np.median(std)), 3) for name, std in deviations.items()},
            **self.facts,
        }


def locate(
    drive: Drive,
    graph: RoadGraph,
    *,
    result: DriveResult | None = None,
    near: tuple[float, float] | None = None,
    radius_m: float | None = None,
    leave_one_out: bool = False,
    progress: Progress | None = None,
) -> Location:
    """Find out where on a map a drive was, from its trajectory and the intersections along it.

    Parameters
    ----------
    drive
        Its poses are used; a georeference that it has is not.
    graph
        The map: it must hold the roads driven, and may hold many more.
    result
        Result of `detect` on the drive. None: the trajectory alone, which needs to be longer.
    near, radius_m
        Latitude, longitude and metres: search only there.
    leave_one_out
        Also compute what scores each node fairly; see `Location.leaving_out`.
    progress
        Called with the steps done and the steps in all.

    Returns
    -------
    Location

    Raises
    ------
    MapError
        The map holds no roads for cars, or is too large to be searched as a whole.
    ConfigError
        Only one of `near` and `radius_m` is given, or it is out of range.
    """
    began = time.perf_counter()
    expect(drive, Drive)
    expect(graph, RoadGraph)
    _check_near(near, radius_m)
    track = track_of(drive.T_world_lidar)
    if track.length_m < MIN_LENGTH_M:
        return Location(too_short(track.length_m), [], facts={"length_m": round(track.length_m, 1)})
    sightings = NO_SIGHTINGS if result is None else sightings_of(result, drive.frames, track)
    roads = road_map(graph, near, radius_m)
    roads.prepare()
    lock, done = Lock(), itertools.count(1)  # the two searches run side by side

    def add(_: int, total: int) -> None:
        with lock:
            if progress is not None:
                progress(min(next(done), 2 * total), 2 * total)

    with ThreadPoolExecutor(2) as pool:  # the kernels let go of the interpreter
        mirrored = pool.submit(_find_places, track.mirrored(), sightings.mirrored(), roads, add)
        found = _find_places(track, sightings, roads, add)
        by_chance = mirrored.result()
    chance = by_chance[0].evidence.score if by_chance else 0.0
    decision = decide(
        found[0].evidence if found else None,
        found[1].evidence.score if len(found) > 1 else 0.0,
        chance,
        float(found[0].chain.at_m[-1]) if found else 0.0,
    )
    facts: JsonObject = {
        "map": graph.source,
        "map_km": round(roads.length_m / 1000.0, 1),
        "length_m": round(track.length_m, 1),
        "intersections_seen": len(sightings),
    }
    location = Location(decision, [each.place(roads) for each in found[:_LISTED]], chance, facts=facts)
    if decision.outcome == "found":
        name = f"the map {graph.source} (placed by its roads)"
        location = _placed(location, found[0], track, roads, name, leave_one_out=leave_one_out)
    location.facts["seconds"] = round(time.perf_counter() - began, 2)
    return location


@dataclass(frozen=True)
class _Found:
    """A place in the making: the chain bent onto the roads there, and what speaks for it."""

    chain: Chain
    fit: Fit
    evidence: Evidence

    def is_elsewhere(self, other: "_Found") -> bool:
        """Tell whether the middle of the drive lies apart from that of another place."""
        middle = len(self.chain) // 2
        here, there = self.fit.pose[middle], other.fit.pose[middle]
        turned = abs(float(wrap_angle(float(here[2] - there[2]))))
        return float(np.hypot(*(here[:2] - there[:2]))) > _ELSEWHERE_M or turned > _ELSEWHERE_RAD

    def place(self, roads: RoadMap) -> Place:
        """Return it in degrees."""
        pose = self.fit.pose
        lonlat = roads.lonlat(pose[:, :2])
        heading_rad = pose[0, 2] - self.chain.pose[0, 2]  # ahead of the vehicle, not along its first chord
        heading_deg = float(bearing_deg(heading_rad - roads.north_rad(pose[0, :2])))
        return Place(lonlat[0], heading_deg, lonlat[len(pose) // 2], self.evidence, lonlat)


def _find_places(track: Track, sightings: Sightings, roads: RoadMap, done: Progress) -> list[_Found]:
    """Return the places that explain a drive best, best first, apart from each other."""
    chain = Chain.of(track, sightings)

    def bend(start: FloatArray, anchor: int | None, rounds: int) -> _Found:
        bent = fit(chain, start, roads, anchor=anchor, rounds=rounds)
        return _Found(chain, bent, evidence_of(chain, bent, roads))

    bent = []
    for at_m, poses in guess(track, sightings, roads, kept=_KEPT):
        anchor = int(np.argmin(np.abs(chain.at_m - at_m)))
        for number, pose in enumerate(poses):
            done(number, len(poses))
            bent.append(bend(chain.placed(anchor, pose), anchor, _QUICK_ROUNDS))
    return _apart([bend(each.fit.pose, None, _ROUNDS) for each in _apart(bent)[:_BENT_FULLY]])


def _apart(found: list[_Found]) -> list[_Found]:
    kept: list[_Found] = []
    for each in sorted(found, key=lambda place: -place.evidence.score):
        if all(each.is_elsewhere(other) for other in kept):
            kept.append(each)
    return kept


def _placed(
    location: Location, best: _Found, track: Track, roads: RoadMap, source: str, *, leave_one_out: bool
) -> Location:
    """Add to a location what it says of every scan."""
    chain, fitted = best.chain, best.fit
    covariance = uncertainty(chain, fitted, roads)
    rows = np.round(np.interp(track.at_m, chain.at_m, np.arange(len(chain)))).astype(np.int64)
    position_std_m = np.sqrt((covariance[rows, 0, 0] + covariance[rows, 1, 1]) / 2.0 + _MAP_STD_M**2)
    distance, nearest = roads.nodes.nearest(chain.seen_at(fitted.pose), _ELSEWHERE_M)
    used = np.unique(nearest[np.isfinite(distance)])
    leaving_out = {}
    for node in used.tolist() if leave_one_out else ():
        others = Nodes(np.delete(roads.node_xy, node, axis=0))
        again = fit(chain, fitted.pose, roads, nodes=others, rounds=_ROUNDS)
        leaving_out[int(roads.node_osm_id[node])] = georeference_by(chain, again, track, roads, source)
    georeference = georeference_by(chain, fitted, track, roads, source)
    more = {"lane_offset_m": round(fitted.offset_m, 2), "scale": round(fitted.scale, 4), "nodes_used": len(used)}
    return replace(
        location,
        georeference=replace(georeference, position_std_m=position_std_m),
        position_std_m=position_std_m,
        heading_std_deg=np.degrees(np.sqrt(covariance[rows, 2, 2])),
        leaving_out=leaving_out,
        facts=location.facts | more,
    )


def georeference_by(chain: Chain, fitted: Fit, track: Track, roads: RoadMap, source: str) -> Georeference:
    """Return the geodetic pose of the LiDAR at every scan, from the bent chain.

    A scan moves with the two poses of the chain between which it lies, each carrying it rigidly, in proportion.
    """
    at = np.interp(track.at_m, chain.at_m, np.arange(len(chain)))
    first = np.minimum(at.astype(np.int64), len(chain) - 2)
    share = (at - first)[:, None]
    turn = np.unwrap(fitted.pose[:, 2] - chain.pose[:, 2])

    def carried(row: Any) -> FloatArray:  # noqa: ANN401 - rows of an array
        return rotate_2d(track.xy - chain.pose[row, :2], turn[row]) + fitted.pose[row, :2]

    xy = (1.0 - share) * carried(first) + share * carried(first + 1)
    turned = (1.0 - share[:, 0]) * turn[first] + share[:, 0] * turn[first + 1]
    lonlat = roads.lonlat(xy)
    zero = np.zeros(len(xy))
    R_enu_level = rotation_from_rpy(zero, zero, turned - roads.north_rad(xy))
    return Georeference(lonlat[:, 1], lonlat[:, 0], track.z_m.copy(), R_enu_level @ track.R_level_lidar, source)


def _check_near(near: tuple[float, float] | None, radius_m: float | None) -> None:
    if (near is None) != (radius_m is None):
        raise ConfigError("near and radius_m belong together: a position and how far around it to search.")
    if near is not None and not (abs(near[0]) <= 89.0 and abs(near[1]) <= 180.0):
        raise ConfigError(
            f"near {near[0]:g}, {near[1]:g} is no place on earth. Expected latitude, longitude in degrees."
        )
    if radius_m is not None and not radius_m > 0.0:
        raise ConfigError(f"radius_m is {radius_m:g}. Expected a positive number of metres.")
