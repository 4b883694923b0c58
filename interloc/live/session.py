"""A session: scans in, in their order; out come the detections of each keyframe, and what became of the map by them."""

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from interloc.arrays import FloatArray
from interloc.config import DEFAULT, DetectorConfig
from interloc.detection.detector import Detector, KeyframeDetections, Window, locate
from interloc.detection.occupancy import PATCH_STEP_M, road_patch
from interloc.detection.scan import checked_pose
from interloc.errors import DriveError, GeoreferenceError
from interloc.geometry import enu_from_lonlat
from interloc.live.scan import Fix, LiveScan, georeference_of
from interloc.mapping.fusion import fuse
from interloc.mapping.georeferencing import build_tables
from interloc.results import DetectionTable, IntersectionTable, KeyframeTable, RoadPatch

# The fused map of a drive that is under way: after each keyframe only what lies around it is fused anew.

CONFIRMED = 0.5
"""Confidence from which an intersection that was seen several times counts as confirmed."""

_CONFIRMED_SIGHTINGS = 3
_MOVED_M = 0.5
_ALL_AROUND = 2**0.5  # the region of interest is a square: from its middle to a corner

Kind = Literal["new", "confirmed", "moved", "seen", "gone"]


@dataclass(frozen=True)
class MapIntersection:
    """An intersection of the growing map, as it is known now."""

    id: int
    """It keeps it as long as the session lasts."""
    world_xy: FloatArray
    lonlat: FloatArray | None
    """(2,) float64: metres in W; longitude and latitude, or None without fixes."""
    position_std_m: float
    position_cov_m2: FloatArray
    """(3,) float64: as `IntersectionTable.position_cov_m2`."""
    confidence: float
    """0..1"""
    observations: int
    bearings_deg: FloatArray
    widths_m: FloatArray
    """(B,) float64: of its branches."""
    is_confirmed: bool = False
    """Whether it was ever sure enough to be reported as such."""


@dataclass(frozen=True)
class Event:
    """What became of an intersection by the sightings of one keyframe."""

    kind: Kind
    """{"new", "confirmed", "moved", "seen", "gone"}: confirmed: sure enough for the first time. Moved: more than 0.5 m
    from where it was last said to be. Seen: once more, with all else as it was, or less sure. Gone: what was seen
    later leaves no intersection there."""
    intersection: MapIntersection


class GrowingMap:
    """Fuses the detections of a session as they come.

    `interloc.mapping.fusion.fuse` is asked after each keyframe about the keyframes from which the same intersections
    can be seen, those of earlier passes too; everything farther away stays as it is. `complete` fuses all at once, as
    `interloc.detect` does. Of the keyframes all have fixes or none (`has_fixes`).
    """

    def __init__(self, config: DetectorConfig) -> None:
        self.has_fixes = False
        self._config = config
        self._found: list[KeyframeDetections] = []
        self._fixes: list[Fix] = []
        self._places = np.zeros((256, 2))  # of the keyframes in a plane, metres; room for more at its end
        self._known: dict[int, MapIntersection] = {}
        self._at: dict[int, FloatArray] = {}  # their places in the plane
        self._said: dict[int, FloatArray] = {}  # places last reported
        self._next_id = 1
        self._reach_m = config.bev.size_m / 2 * _ALL_AROUND + config.fusion.merge_radius_m
        self._far_m = self._reach_m + max(self._reach_m, config.fusion.visible_limit_m)

    @property
    def intersections(self) -> list[MapIntersection]:
        """What is in the map, in the order of first sight."""
        return list(self._known.values())

    def add(self, found: KeyframeDetections, fix: Fix | None) -> list[Event]:
        """Take the detections of the next keyframe, and its fix where the session has any."""
        self._found.append(found)
        if fix is not None:
            self._fixes.append(fix)
        here = self._remember(found, fix)
        away = np.hypot(*(self._places[: len(self._found)] - here).T)
        table = self._fused(np.flatnonzero(away <= self._far_m).tolist())[1]
        places = self._in_plane(table.world_xy, table.lonlat)
        return self._compare(table, places, here)

    def complete(self) -> tuple[KeyframeTable, IntersectionTable, DetectionTable]:
        """Fuse everything at once."""
        return self._fused(list(range(len(self._found))))

    def _remember(self, found: KeyframeDetections, fix: Fix | None) -> FloatArray:
        row = len(self._found) - 1
        if row == len(self._places):
            self._places = np.concatenate([self._places, np.zeros_like(self._places)])
        lonlat = None if fix is None else np.array([[fix.lon_deg, fix.lat_deg]])
        self._places[row] = self._in_plane(found.keyframe.T_world_lidar[None, :2, 3], lonlat)[0]
        here: FloatArray = self._places[row]
        return here

    def _in_plane(self, world_xy: FloatArray, lonlat: FloatArray | None) -> FloatArray:
        """Return (N, 2) metres: east and north of the first fix, or those of W."""
        if lonlat is None or not self._fixes:
            return world_xy
        return enu_from_lonlat(self._fixes[0].lat_deg, self._fixes[0].lon_deg, lonlat)

    def _fused(self, rows: list[int]) -> tuple[KeyframeTable, IntersectionTable, DetectionTable]:
        georeference = georeference_of([self._fixes[row] for row in rows]) if self._fixes else None
        keyframes, detections = build_tables([self._found[row] for row in rows], np.arange(len(rows)), georeference)
        intersections, owner = fuse(keyframes, detections, self._config.fusion, self._config.calibration)
        return keyframes, intersections, replace(detections, intersection=owner)

    def _compare(self, table: IntersectionTable, places: FloatArray, here: FloatArray) -> list[Event]:
        """Find out which of the intersections around the vehicle are known, and what is new about them."""
        radius_m = self._config.fusion.merge_radius_m
        near = np.flatnonzero(np.hypot(*(places - here).T) <= self._reach_m).tolist()
        known = self._at
        free = {id_ for id_, place in known.items() if np.hypot(*(place - here)) <= self._reach_m + radius_m}
        pairs = sorted((float(np.hypot(*(known[id_] - places[row]))), row, id_) for row in near for id_ in free)
        ids: dict[int, int] = {}
        for away_m, row, id_ in pairs:
            if away_m <= radius_m and row not in ids and id_ in free:
                ids[row] = id_
                free.discard(id_)
        events = []
        for row in near:
            before = self._known.get(ids.get(row, 0))  # ids begin at 1
            if before is None:
                ids[row], self._next_id = self._next_id, self._next_id + 1
            id_ = ids[row]
            now = _row_of(table, row, id_, was_confirmed=before is not None and before.is_confirmed)
            self._known[id_], self._at[id_] = now, places[row]
            kind = self._kind(before, now, places[row])
            if kind is not None:
                events.append(Event(kind, now))
        for id_ in sorted(free):
            if np.hypot(*(known[id_] - here)) <= self._reach_m:
                events.append(Event("gone", self._known.pop(id_)))
                del self._said[id_], self._at[id_]
        return events

    def _kind(self, before: MapIntersection | None, now: MapIntersection, place: FloatArray) -> Kind | None:
        if before is None:
            self._said[now.id] = place
            return "new"
        if now.is_confirmed and not before.is_confirmed:
            self._said[now.id] = place
            return "confirmed"
        if np.hypot(*(place - self._said[now.id])) > _MOVED_M:
            self._said[now.id] = place
            return "moved"
        return "seen" if now.observations != before.observations else None


def _row_of(table: IntersectionTable, row: int, id_: int, *, was_confirmed: bool) -> MapIntersection:
    covariance = table.covariances[row]
    confidence, observations = float(table.confidence[row]), int(table.observations[row])
    return MapIntersection(
        id=id_,
        world_xy=table.world_xy[row],
        lonlat=None if table.lonlat is None else table.lonlat[row],
        position_std_m=float(table.position_std_m[row]),
        position_cov_m2=covariance[[0, 0, 1], [0, 1, 1]],
        confidence=confidence,
        observations=observations,
        bearings_deg=table.bearings_deg[row],
        widths_m=table.widths_m[row],
        is_confirmed=was_confirmed or (confidence >= CONFIRMED and observations >= _CONFIRMED_SIGHTINGS),
    )


@dataclass(frozen=True)
class Answer:
    """What a session says to one scan, or at its end to one of the last keyframes."""

    frame: int
    """Scan number."""
    is_keyframe: bool = False
    """Whether the scan was looked at."""
    keyframes: KeyframeTable | None = None
    """The keyframe that it completed, one row: an earlier one, unless the look-ahead is 0."""
    detections: DetectionTable | None = None
    """What was found around that keyframe."""
    events: list[Event] = field(default_factory=list)
    """What became of the map by it."""
    seconds: float = 0.0
    """Time that this took."""
    road: RoadPatch | None = None
    """The road around that keyframe, once every 10 m; its own `keyframe` counts from the beginning of the session."""


class LiveSession:
    """Finds intersections while driving, and keeps the map of them up to date.

    ``config.keyframes.lookahead`` keyframes (20, about 40 m, unless set) pass before a keyframe is answered; 0 answers
    at once, and finds fewer intersections ahead of the vehicle. The detections are those of `interloc.detect` with the
    same settings, to the last digit; `complete` is its map. `room` bounds its memory, as that of `Detector`.
    """

    def __init__(self, config: DetectorConfig = DEFAULT, room: Callable[[int], None] | None = None) -> None:
        self.config = config
        self.map = GrowingMap(config)
        self.last_frame = -1
        self._detector = Detector(config, room)
        self._fixes: deque[Fix | None] = deque()  # of the keyframes that are not answered yet
        self._answered = 0
        self._patch_xy: FloatArray | None = None

    @property
    def keyframes(self) -> int:
        """Number of keyframes so far."""
        return self._detector.keyframes

    def push(self, scan: LiveScan) -> Answer:
        """Take the next scan.

        A `DriveError` or `GeoreferenceError` says that its number is not above that of the last one, that its pose,
        points or fix are not valid, or that it has a fix and those before it had none, or the reverse. It does not
        count: go on with the next.
        """
        began = time.perf_counter()
        if scan.frame <= self.last_frame:
            raise DriveError(f"scan {scan.frame} came after scan {self.last_frame}; the numbers of scans must rise.")
        checked_pose(scan)
        fix = None if scan.fix is None else scan.fix.checked(scan.frame)
        if self._detector.keyframes and (fix is None) == self.map.has_fixes:
            without, others = ("no fix", "have one") if fix is None else ("a fix", "have none")
            raise GeoreferenceError(
                f"scan {scan.frame} has {without}, the scans before it {others}. Expected a fix of every scan, or of "
                "none. Begin another session where the fixes begin or end."
            )
        before = self._detector.keyframes
        window = self._detector.take(scan)
        self.last_frame = scan.frame
        is_keyframe = self._detector.keyframes > before
        if is_keyframe:
            self._fixes.append(fix)
            self.map.has_fixes = fix is not None
        answer = Answer(scan.frame, is_keyframe) if window is None else self._answer(window, scan.frame, is_keyframe)
        return replace(answer, seconds=time.perf_counter() - began)

    def finish(self) -> Iterator[Answer]:
        """Answer the last keyframes, whose windows the end of the drive cuts short."""
        for window in self._detector.completed([]):
            yield self._answer(window, self.last_frame, is_keyframe=False)

    def complete(self) -> tuple[KeyframeTable, IntersectionTable, DetectionTable]:
        """Return keyframes, map and detections as `interloc.detect` has them: all fused at once."""
        return self.map.complete()

    def close(self) -> None:
        """Give back the memory of its window: it takes no more scans."""
        keyframes, self._detector = self.keyframes, Detector(self.config)
        self._detector.keyframes = keyframes

    def _answer(self, window: Window, frame: int, is_keyframe: bool) -> Answer:
        steps, fix = window.steps(), self._fixes.popleft()
        found = locate(steps, window.keyframe, self.config)
        georeference = None if fix is None else georeference_of([fix])
        keyframes, detections = build_tables([found], np.zeros(1, np.int64), georeference)
        events = self.map.add(found, fix)
        road, place = None, keyframes.world_xy[0]
        if self._patch_xy is None or np.hypot(*(place - self._patch_xy)) >= PATCH_STEP_M:
            self._patch_xy = place
            road = road_patch(self._answered, steps.occupancy, steps.roi, window.bev.against)
        self._answered += 1
        return Answer(frame, is_keyframe, keyframes, detections, events, road=road)
