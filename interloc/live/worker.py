"""A session in a thread of its own, behind a queue that drops the oldest scan when it falls behind.

The documents that it says are the same on the command line, from the service and in ROS.
"""

import logging
import math
import threading
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Literal, NotRequired, TypedDict

import numpy as np

from interloc.arrays import FloatArray
from interloc.errors import InterLocError
from interloc.geometry import bearing_deg, lonlat_from_enu, rotate_2d, yaw_of
from interloc.live.scan import LiveScan
from interloc.live.session import Answer, Kind, LiveSession, MapIntersection
from interloc.results import DetectionTable, KeyframeTable

# What a session says, by its `type`; docs/live.md says what each member means.


class _PlaceDocument(TypedDict):
    world_x_m: float
    world_y_m: float
    lon_deg: NotRequired[float]
    lat_deg: NotRequired[float]


class _BranchesDocument(TypedDict):
    branch_count: int
    branch_bearings_deg: list[float]
    branch_widths_m: list[float | None]


class VehicleDocument(_PlaceDocument):
    """The vehicle."""

    heading_deg: float


class IntersectionDocument(_PlaceDocument, _BranchesDocument):
    """An intersection of the growing map."""

    id: int
    position_std_m: float
    position_cov_m2: list[float]
    confidence: float
    confirmed: bool
    observations: int


class EventDocument(IntersectionDocument):
    """What became of one."""

    kind: Kind


class _DetectionDocument(_PlaceDocument, _BranchesDocument):
    x_m: float
    y_m: float
    score: float


class _KeyframeDocument(VehicleDocument):
    frame: int
    time_s: float | None
    detections: list[_DetectionDocument]


class ScanDocument(TypedDict):
    """The answer to a scan, or at the end to one of the last keyframes."""

    type: Literal["scan"]
    frame: int
    is_keyframe: bool
    vehicle: VehicleDocument | None
    keyframe: _KeyframeDocument | None
    events: list[EventDocument]
    road: list[list[list[list[float]]]] | None
    processing_time_ms: float
    dropped: int


class _DroppedDocument(TypedDict):
    type: Literal["dropped"]
    frame: int
    dropped: int
    reason: NotRequired[str]


class _RefusedDocument(TypedDict):
    """A scan that was refused, or the session as a whole; a fault of InterLoc is "failed"."""

    type: Literal["refused", "failed"]
    frame: int | None
    reason: str


class EndDocument(TypedDict):
    """The last thing that a session says."""

    type: Literal["end"]
    frame: int
    keyframes: int
    dropped: int
    intersections: list[IntersectionDocument]
    drive_id: NotRequired[str]
    job_id: NotRequired[str]
    problem: NotRequired[str]


class RepeatedDocument(TypedDict):
    """What a service says to a scan that has arrived before."""

    type: Literal["repeated"]
    frame: int


class SessionDocument(TypedDict):
    """What a service says when a session begins, or goes on."""

    type: Literal["session"]
    id: str
    last_frame: int


Document = ScanDocument | _DroppedDocument | _RefusedDocument | EndDocument

Say = Callable[[Document, Answer | None], None]
"""Takes what a session says: the document for a client, and the answer that it was made of, if any."""

_ROAD_M = 30.0
_log = logging.getLogger(__name__)


class LiveWorker:
    """Answers every scan that is put in, in its thread: with what was found, or that it was dropped or refused.

    `say` is called from the thread, but for dropped scans, which are reported by the thread that put the next one in;
    `keep` with each scan that was a keyframe, before it is answered. At most `queue_size` scans wait, of `queue_bytes`
    in all: a map of roads needs no scan in particular, and one that waits makes all after it late. `turn` is entered
    while a scan is worked on.
    """

    def __init__(
        self,
        session: LiveSession,
        say: Say,
        *,
        keep: Callable[[LiveScan], None] | None = None,
        queue_size: int = 4,
        queue_bytes: int = 64 * 1024**2,
        turn: Callable[[LiveScan], AbstractContextManager[object]] = nullcontext,
    ) -> None:
        self.session = session
        self._say = say
        self._keep = keep
        self._queue_size, self._queue_bytes = queue_size, queue_bytes
        self._turn = turn
        self._waiting: deque[LiveScan] = deque()
        self._at_work: LiveScan | None = None
        self._changed = threading.Condition()
        self._is_complete = False
        self._goes_on = True
        self.dropped = 0
        self._unheard: Exception | None = None
        self._thread = threading.Thread(target=self._work, name="live", daemon=True)
        self._thread.start()

    def put(self, scan: LiveScan) -> None:
        """Hand in the next scan; never waits."""
        oldest = []
        with self._changed:
            self._waiting.append(scan)
            while len(self._waiting) > self._queue_size or (
                len(self._waiting) > 1 and sum(each.nbytes for each in self._waiting) > self._queue_bytes
            ):
                oldest.append(self._waiting.popleft())
            self._changed.notify()
        for each in oldest:
            self.drop(each.frame)

    @property
    def held_bytes(self) -> int:
        """Size of the scans that wait, and of the one that is worked on."""
        with self._changed:
            return sum(each.nbytes for each in (*self._waiting, self._at_work) if each is not None)

    def drop(self, frame: int, reason: str | None = None) -> None:
        """Say that a scan is left out: the session is too slow, unless there is another reason."""
        self.dropped += 1
        document: _DroppedDocument = {"type": "dropped", "frame": frame, "dropped": self.dropped}
        if reason is not None:
            document["reason"] = reason
        self._say(document, None)

    def finish(self) -> None:
        """Let it answer what waits, the last keyframes too, and end; `join` waits for that."""
        with self._changed:
            self._is_complete = True
            self._changed.notify()

    def abandon(self) -> None:
        """End it without the last keyframes."""
        self._goes_on = False
        self.finish()

    def join(self) -> None:
        """Wait for the thread to end; raise the error by which `say` has ended it."""
        self._thread.join()
        if self._unheard is not None:
            raise self._unheard

    def _work(self) -> None:
        try:
            while (scan := self._next()) is not None and self._goes_on:
                self._take(scan)
                del scan  # it may be large, and the next one may be long in coming
                self._at_work = None
            if self._goes_on:
                for answer in self.session.finish():
                    self._say(answer_document(answer, dropped=self.dropped), answer)
                self._say(end_document(self.session, dropped=self.dropped), None)
        except Exception:  # noqa: BLE001 - whatever it is, the client gets a line
            reason = "a fault of InterLoc itself; its log has the details."
            try:
                self._say({"type": "failed", "frame": None, "reason": reason}, None)
            except Exception as error:  # noqa: BLE001 - raised by `join`
                self._unheard = error
            else:
                _log.exception("a live session has failed")
        finally:
            with self._changed:
                self._waiting.clear()
                self._at_work = None
            self.session.close()

    def _next(self) -> LiveScan | None:
        """Wait for the next scan; None where there are no more."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._is_complete)
            self._at_work = self._waiting.popleft() if self._waiting else None
            return self._at_work

    def _take(self, scan: LiveScan) -> None:
        try:
            with self._turn(scan):
                answer = self.session.push(scan)
            if answer.is_keyframe and self._keep is not None:
                self._keep(scan)
        except InterLocError as error:
            self._say({"type": "refused", "frame": scan.frame, "reason": str(error)}, None)
        else:
            self._say(answer_document(answer, scan, dropped=self.dropped), answer)


def end_document(session: LiveSession, *, dropped: int = 0) -> EndDocument:
    """Return the last thing that a session says: how much it has seen, and its map."""
    return {
        "type": "end",
        "frame": session.last_frame,
        "keyframes": session.keyframes,
        "dropped": dropped,
        "intersections": [intersection_document(each) for each in session.map.intersections],
    }


def answer_document(answer: Answer, scan: LiveScan | None = None, *, dropped: int = 0) -> ScanDocument:
    """Return what is said to a scan (docs/live.md), with the place of the vehicle where the scan is given."""
    keyframe = None
    if answer.keyframes is not None and answer.detections is not None:
        keyframe = _keyframe_document(answer.keyframes, answer.detections)
    return {
        "type": "scan",
        "frame": answer.frame,
        "is_keyframe": answer.is_keyframe,
        "vehicle": None if scan is None else vehicle_document(scan),
        "keyframe": keyframe,
        "events": [{"kind": each.kind, **intersection_document(each.intersection)} for each in answer.events],
        "road": _road_document(answer),
        "processing_time_ms": round(1000.0 * answer.seconds, 3),
        "dropped": dropped,
    }


def vehicle_document(scan: LiveScan) -> VehicleDocument:
    """Return where the vehicle is; its heading clockwise from north, or from +y of W without a fix."""
    fix, T = scan.fix, scan.T_world_lidar
    place = _place(T[:2, 3], None if fix is None else np.array([fix.lon_deg, fix.lat_deg]))
    return {**place, "heading_deg": float(bearing_deg(yaw_of(T[:3, :3] if fix is None else fix.R_enu_lidar)))}


def intersection_document(intersection: MapIntersection) -> IntersectionDocument:
    """Return an intersection of the growing map, named as in intersections.geojson."""
    return {
        "id": intersection.id,
        **_place(intersection.world_xy, intersection.lonlat),
        "position_std_m": intersection.position_std_m,
        "position_cov_m2": intersection.position_cov_m2.tolist(),
        "confidence": intersection.confidence,
        "confirmed": intersection.is_confirmed,
        "observations": intersection.observations,
        **_branches(intersection.bearings_deg, intersection.widths_m),
    }


def _keyframe_document(keyframes: KeyframeTable, detections: DetectionTable) -> _KeyframeDocument:
    time_s = float(keyframes.time_s[0])
    yaw = keyframes.world_yaw_rad if keyframes.enu_yaw_rad is None else keyframes.enu_yaw_rad
    return {
        "frame": int(keyframes.frame[0]),
        "time_s": None if math.isnan(time_s) else time_s,
        **_place(keyframes.world_xy[0], None if keyframes.lonlat is None else keyframes.lonlat[0]),
        "heading_deg": float(bearing_deg(yaw[0])),
        "detections": [
            {
                "x_m": float(detections.lidar_xy[row, 0]),
                "y_m": float(detections.lidar_xy[row, 1]),
                **_place(detections.world_xy[row], None if detections.lonlat is None else detections.lonlat[row]),
                "score": float(detections.score[row]),
                **_branches(detections.bearings_deg[row], detections.widths_m[row]),
            }
            for row in range(len(detections))
        ],
    }


def _road_document(answer: Answer) -> list[list[list[list[float]]]] | None:
    """Return polygons of the road within some metres of the keyframe: rings of places, the outer one first."""
    patch, keyframes = answer.road, answer.keyframes
    if patch is None or keyframes is None:
        return None
    import shapely  # noqa: PLC0415 - slow to import

    from interloc.roadmap.surface import outlines  # noqa: PLC0415 - likewise

    here = keyframes.world_xy[0]
    around = shapely.Point(here).buffer(_ROAD_M)
    polygons = outlines(patch.cells(), patch.corner_xy, patch.resolution_m, around)
    return [
        [_ring(np.asarray(ring.coords), keyframes).tolist() for ring in (each.exterior, *each.interiors)]
        for each in map(shapely.orient_polygons, polygons)  # holes go the other way round
    ]


def _ring(world_xy: FloatArray, keyframes: KeyframeTable) -> FloatArray:
    """Return places of W as longitude and latitude, by the fix of a keyframe; in W where there is none."""
    if keyframes.lonlat is None or keyframes.enu_yaw_rad is None:
        return np.round(world_xy, 2)
    turn = keyframes.enu_yaw_rad[0] - keyframes.world_yaw_rad[0]
    lon, lat = keyframes.lonlat[0]
    return np.round(lonlat_from_enu(lat, lon, rotate_2d(world_xy - keyframes.world_xy[0], turn)), 7)


def _place(world_xy: FloatArray, lonlat: FloatArray | None) -> _PlaceDocument:
    place: _PlaceDocument = {"world_x_m": float(world_xy[0]), "world_y_m": float(world_xy[1])}
    return place if lonlat is None else {**place, "lon_deg": float(lonlat[0]), "lat_deg": float(lonlat[1])}


def _branches(bearings_deg: FloatArray, widths_m: FloatArray) -> _BranchesDocument:
    return {
        "branch_count": len(bearings_deg),
        "branch_bearings_deg": bearings_deg.tolist(),
        "branch_widths_m": [None if math.isnan(width) else width for width in widths_m.tolist()],
    }
