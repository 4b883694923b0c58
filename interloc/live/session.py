"""A session: scans in, in their order; out come the detections of each keyframe, and what became of the map by them."""

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from interloc.arrays import FloatArray
from interloc.config import DEFAULT, DetectorConfig
from interloc.detection.detector import Detector, Window, locate
from interloc.detection.occupancy import PATCH_STEP_M, road_patch
from interloc.detection.scan import checked_pose
from interloc.errors import DriveError, GeoreferenceError
from interloc.live.growing_map import Event, GrowingMap
from interloc.live.scan import Fix, LiveScan, georeference_of
from interloc.mapping.georeferencing import build_tables
from interloc.results import DetectionTable, IntersectionTable, KeyframeTable, RoadPatch


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

    def __init__(self, config: DetectorConfig = DEFAULT, room: Callable[[int], None] = lambda _bytes: None) -> None:
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
