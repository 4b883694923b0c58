"""Placing a drive on a road map without GNSS: search, bend, compare, decide."""

from __future__ import annotations

import itertools
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.drive import Drive, Georeference
from interloc.errors import ConfigError, expect
from interloc.geometry import bearing_deg, rotate_2d, rotation_from_rpy, wrap_angle
from interloc.localization.evidence import MIN_LENGTH_M, Decision, Evidence, decide, evidence_of, too_short
from interloc.localization.refine import Chain, Fit, fit, uncertainty
from interloc.localization.roads import Nodes, RoadMap, road_map
from interloc.localization.search import guess
from interloc.localization.track import NO_SIGHTINGS, Sightings, Track, sightings_of, track_of
from interloc.osm.graph import RoadGraph
from interloc.processes import Progress
from interloc.results import DriveResult

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

    def record(self) -> dict[str, Any]:
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
    facts: dict[str, Any] = field(default_factory=dict)
    """Size of drive and map, seconds; for run.json."""

    def __repr__(self) -> str:
        best = ""
        if self.places:
            lon, lat = self.places[0].lonlat.tolist()
            best = f", best {lat:.5f}, {lon:.5f} (latitude, longitude), score {self.places[0].score:.2f}"
        return f"<Location {self.decision.outcome}: {len(self.places)} places{best}>"

    def record(self) -> dict[str, Any]:
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
    chance = by_chance[0].score if by_chance else 0.0
    decision = decide(
        found[0].evidence if found else None,
        found[1].score if len(found) > 1 else 0.0,
        chance,
        float(found[0].chain.at_m[-1]) if found else 0.0,
    )
    facts: dict[str, Any] = {
        "map": graph.source,
        "map_km": round(roads.length_m / 1000.0, 1),
        "length_m": round(track.length_m, 1),
        "intersections_seen": len(sightings),
    }
    location = Location(decision, [each.place(roads) for each in found[:_LISTED]], chance, facts=facts)
    if decision.found:
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

    @property
    def score(self) -> float:
        """Of its evidence."""
        return self.evidence.score

    def is_elsewhere(self, other: _Found) -> bool:
        """Tell whether the middle of the drive lies apart from that of another place."""
        middle = len(self.chain) // 2
        here, there = self.fit.pose[middle], other.fit.pose[middle]
        turned = abs(float(wrap_angle(float(here[2] - there[2]))))
        return float(np.hypot(*(here[:2] - there[:2]))) > _ELSEWHERE_M or turned > _ELSEWHERE_RAD

    def place(self, roads: RoadMap) -> Place:
        """Return it in degrees."""
        pose = self.fit.pose
        lonlat = roads.lonlat(pose[:, :2])
        heading_deg = float(bearing_deg(pose[0, 2] - roads.north_rad(pose[0, :2])))
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
    for each in sorted(found, key=lambda place: -place.score):
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
        xy: FloatArray = rotate_2d(track.xy - chain.pose[row, :2], turn[row]) + fitted.pose[row, :2]
        return xy

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
