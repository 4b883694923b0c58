"""The live sessions of this server: each works in a thread, and tells its sender and all who watch."""

import asyncio
import json
import logging
import secrets
import sys
import threading
import time
from array import array
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractContextManager, nullcontext, suppress
from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, Field, TypeAdapter
from sqlalchemy.exc import SQLAlchemyError

from app.context import Context
from app.drives.commit import begin_commit
from app.drives.models import CommitRequest, DriveOptionsModel, NewDrive
from app.drives.records import create_drive
from app.drives.upload import keep
from app.http.fields import ID, Body, Name
from app.http.intake import Arrival, Intake, check_free_space
from app.http.problem_types import DRIVE_NOT_USABLE, NOT_FOUND, TOO_MANY_SESSIONS
from app.http.problems import Problem
from app.jobs.models import NewJob
from app.jobs.processes import machine_memory
from app.jobs.submission import submit_job
from app.settings import MB, Settings
from interloc.arrays import JsonObject
from interloc.config import DetectorConfig
from interloc.drives.folder import DROPPED
from interloc.drives.georeference.read import geo_csv_text
from interloc.errors import DriveError
from interloc.live.scan import LiveScan, georeference_of
from interloc.live.wire import decode_scan

if TYPE_CHECKING:
    from interloc.live.session import Answer
    from interloc.live.worker import Document, EventDocument, RepeatedDocument, VehicleDocument

# What a sender says at first, and what is told about a session.


class Begin(Body):
    """Begins a session."""

    type: Literal["begin"]
    name: Name = Field(description="Name of the drive.")
    preset: Literal["default", "paper"] = Field("default", description="Settings to start from.")
    config: JsonObject | None = Field(
        None, description="Settings that differ; `keyframes.lookahead` is the number of keyframes an answer waits for."
    )
    keep: bool = Field(False, description="Make a drive of the keyframes; at the end it is checked, and a job runs.")


class Continue(Body):
    """Goes on with a session after a broken connection."""

    type: Literal["continue"]
    session: str = Field(pattern=ID)
    answered: int = Field(-1, ge=-1, description="Last scan whose answer arrived: those after it come again.")


class End(Body):
    """Ends the session: the last keyframes are answered, then the map."""

    type: Literal["end"]


SENT = TypeAdapter[Begin | Continue | End](Annotated[Begin | Continue | End, Field(discriminator="type")])
"""Texts that a sender may send."""


class LiveModel(BaseModel):
    """A live session."""

    id: str
    name: str
    state: Literal["driving", "waiting", "ended"] = Field(
        description="driving; waiting: the sender is away, and may go on with it; ended."
    )
    georeferenced: bool = Field(description="Whether places are longitude and latitude, else metres of W.")
    keyframes: int
    dropped: int = Field(description="Scans that were dropped because the session fell behind.")
    intersections: int


class LiveList(BaseModel):
    """The live sessions of this server, the newest first."""

    sessions: list[LiveModel]


_ROAD, _OTHER = 11, 2  # road surface and ground, by the ids of LAS: they may be all that was sent
_OF_SESSION = 64 * MB  # that it may hold: no client fills the memory of the server
_MAX_OF_ALL = min(16, max(4, machine_memory() // 16 // _OF_SESSION))
_LARGE = 4 * MB
_WAITING = Settings.max_live_message_bytes  # of one session
_UNREAD = 256  # messages that a slow watcher may be behind, then it has to begin anew
_UNANSWERED = 512  # likewise of a sender; so many are kept to be repeated, more than the last keyframes can be
_MAX_PLACES = 20_000  # of the track
_MAX_ROAD = 4 * MB  # of pieces of road, as text
_MAX_WATCHING = 24  # of one client: each may hold a state that it does not read

_log = logging.getLogger(__name__)
_one_at_a_time = threading.Lock()

Written = TypeVar("Written")


def _turn(scan: LiveScan) -> AbstractContextManager[object]:
    """Let no two large scans be worked on at once: each takes several times its size."""
    return _one_at_a_time if scan.nbytes > _LARGE else nullcontext()


class Keeper:
    """Writes the keyframes of a session into a drive of SemanticKITTI's layout, numbered anew from 0.

    It is used by the thread of the session; the drive takes files until `finish`.
    """

    def __init__(self, context: Context, owner: str, begin: Begin, config: DetectorConfig) -> None:
        check_free_space(context, 0)
        options = DriveOptionsModel(label_scheme="las", pose_frame="lidar")
        drive, _ = create_drive(context, owner, NewDrive(name=begin.name, options=options))
        self.drive_id = drive.id
        self._context, self._owner, self._preset, self._config = context, owner, begin.preset, config
        self._scans: list[LiveScan] = []  # without their points
        self._lost: list[int] = []

    def keep(self, scan: LiveScan) -> None:
        """Write the points of a keyframe; a 413 where the drive, a 507 where the disk would be too full."""
        ground, number = scan.ground, len(self._scans)
        points = np.pad(ground.xyz, ((0, 0), (0, 1)))
        labels = np.where(ground.is_road, _ROAD, _OTHER).astype("<u4")
        check_free_space(self._context, points.nbytes + labels.nbytes)
        self._write(
            {
                f"velodyne/{number:06d}.bin": points.astype("<f4").tobytes(),
                f"labels/{number:06d}.label": labels.tobytes(),
            }
        )
        without = np.empty((0, 4), np.float32)  # a slice would hold all points
        self._scans.append(LiveScan(scan.frame, scan.T_world_lidar, without, time_s=scan.time_s, fix=scan.fix))

    def lose(self, frame: int) -> None:
        """Take note of a scan that was dropped or refused."""
        self._lost.append(frame)

    def finish(self) -> tuple[str, str]:
        """Write poses, times, fixes, losses; begin check and job of the drive (429: too many wait); return both ids."""
        if not self._scans:
            raise Problem(DRIVE_NOT_USABLE, "no keyframe came, so that there is nothing to check; it expires.")
        poses = [" ".join(f"{value:.17g}" for value in scan.T_world_lidar[:3].ravel()) for scan in self._scans]
        files = {"poses.txt": poses}
        if all(scan.time_s is not None for scan in self._scans):
            files["times.txt"] = [f"{scan.time_s:.17g}" for scan in self._scans]
        if self._lost:  # by the scans before them, as they are numbered here
            after = np.searchsorted([scan.frame for scan in self._scans], self._lost) - 1
            counts = zip(*np.unique(after, return_counts=True), strict=True)
            files[DROPPED] = ["after_frame,scans", *(f"{frame},{scans}" for frame, scans in counts)]
        contents = {name: "".join(f"{line}\n" for line in lines) for name, lines in files.items()}
        fixes = [scan.fix for scan in self._scans if scan.fix is not None]  # all have one, or none
        if fixes:
            contents["geo.csv"] = geo_csv_text(np.arange(len(fixes)), georeference_of(fixes), exact=True)
        _patiently(lambda: self._write({name: content.encode() for name, content in contents.items()}))
        context, owner = self._context, self._owner
        _patiently(lambda: begin_commit(context, self.drive_id, owner, CommitRequest()))
        new = NewJob(drive_id=self.drive_id, preset=self._preset, config=self._config.model_dump(mode="json"))
        job, _ = _patiently(lambda: submit_job(context, owner, new, key=f"live-{self.drive_id}"))
        return self.drive_id, job.id

    def _write(self, files: dict[str, bytes]) -> None:
        arrivals: list[Arrival] = []
        intakes = [Intake(self._context, path, len(content)) for path, content in files.items()]
        try:
            for intake, content in zip(intakes, files.values(), strict=True):
                intake.write(content)
                arrivals.append(intake.finish())
            keep(self._context, self.drive_id, arrivals)
        finally:
            for intake in intakes:
                intake.discard()


def _patiently(write: Callable[[], Written]) -> Written:
    """Write into the database, again where it is away for a moment: scans that come meanwhile are dropped at worst."""
    for wait_s in (0.5, 1, 2, 4, 8):
        try:
            return write()
        except SQLAlchemyError as error:
            _log.warning("a live session waits for the database: %s", error)
            time.sleep(wait_s)
    return write()


class LiveEntry:
    """One session. All but what `_say` does belongs to the event loop."""

    def __init__(self, begin: Begin, owner: str, config: DetectorConfig, when_quiet: Callable[[], object]) -> None:
        self.id = secrets.token_hex(8)
        self.name, self.owner = begin.name, owner
        self.sender: asyncio.Queue[str | None] | None = None
        self.quiet_since: float | None = time.monotonic()
        self.last_frame = -1  # of the scans that were handed in
        self._arrived = array("q")  # their numbers
        self.is_over = False
        self.refusal: str | None = None
        self._loop = asyncio.get_running_loop()
        self._when_quiet = when_quiet
        self._said: deque[tuple[int, str]] = deque(maxlen=_UNANSWERED - 1)  # all fit in the queue of a sender
        self._watchers: set[asyncio.Queue[str | None]] = set()
        self._track: deque[list[float]] = deque(maxlen=_MAX_PLACES)
        self._road: deque[str] = deque()
        self._road_bytes = 0
        self._intersections: dict[int, EventDocument] = {}
        self._vehicle: VehicleDocument | None = None
        self._keyframes = self._dropped = 0  # of what was told: the thread may be further, and its answer on the way
        self.keeper: Keeper | None = None
        self._held: dict[str, int] = {}  # bytes by what they are for
        from interloc.live.session import LiveSession  # noqa: PLC0415 - as the method, which is loaded by now
        from interloc.live.worker import LiveWorker  # noqa: PLC0415

        session = LiveSession(config, partial(self.hold, "window"))
        self._worker = LiveWorker(session, self._say, keep=self._keep, queue_bytes=_WAITING, turn=_turn)

    @property
    def state(self) -> Literal["driving", "waiting", "ended"]:
        """Whether it goes on."""
        if self.is_over:
            return "ended"
        return "waiting" if self.sender is None else "driving"

    def attach(self, answered: int) -> asyncio.Queue[str | None]:
        """Take a connection as that of the sender; an earlier one is told to end by None.

        The answers to scans after the last one whose answer has arrived come first.
        """
        if self.sender is not None:
            _put(self.sender, None)
        self.sender, self.quiet_since = asyncio.Queue(_UNANSWERED), None
        for frame, text in self._said:
            if frame > answered:
                self.sender.put_nowait(text)
        if self.is_over:
            self.sender.put_nowait(None)
        return self.sender

    def detach(self, sender: asyncio.Queue[str | None]) -> None:
        """Take note that a connection is gone: the session waits for another one."""
        if self.sender is sender:
            self.sender, self.quiet_since = None, time.monotonic()
            self._when_quiet()

    def take(self, data: bytes) -> None:
        """Hand a scan to the session; a `DriveError` says that it is none."""
        scan = decode_scan(data)
        if scan.frame <= self.last_frame and scan.frame in self._arrived:  # sent again after a broken connection
            self._tell({"type": "repeated", "frame": scan.frame})
        else:
            self._arrived.append(scan.frame)
            self.last_frame = max(self.last_frame, scan.frame)
            try:
                self.hold("scans", self._worker.held_bytes + scan.nbytes)
            except DriveError as error:
                self._worker.drop(scan.frame, str(error))
            else:
                self._worker.put(scan)

    def hold(self, what: str, size: int) -> None:
        """Hold so many bytes of something from now on; a `DriveError` says that the session may not."""
        held = sum(own for name, own in [*self._held.items()] if name != what) + size
        if held > _OF_SESSION:
            raise DriveError(
                f"the session would hold {held / MB:,.0f} MB of the memory of the service, and may hold "
                f"{_OF_SESSION / MB:,.0f} MB. Send the points of the ground only, or take fewer keyframes "
                "(keyframes.window, keyframes.lookahead), larger cells (bev.resolution_m) or less range "
                "(bev.max_range_m)."
            )
        self._held[what] = size

    def finish(self) -> None:
        """Let the session answer its last keyframes and end."""
        self._worker.finish()

    def refuse(self, reason: str) -> None:
        """End the session for a reason."""
        self._worker.abandon()
        self._tell({"type": "refused", "frame": None, "reason": reason})

    def model(self) -> LiveModel:
        """Return what is told about it."""
        return LiveModel(
            id=self.id,
            name=self.name,
            state=self.state,
            georeferenced=self._worker.session.map.has_fixes,
            keyframes=self._keyframes,
            dropped=self._dropped,
            intersections=len(self._intersections),
        )

    async def watch(self) -> AsyncIterator[str | None]:
        """Yield the session as it is, then what it says; once a second None, so that the caller can leave."""
        queue: asyncio.Queue[str | None] = asyncio.Queue(_UNREAD)
        self._watchers.add(queue)
        state = {
            "type": "state",
            "session": self.model().model_dump(mode="json"),
            "vehicle": self._vehicle,
            "track": list(self._track),
            "intersections": list(self._intersections.values()),
        }
        try:
            yield f'{json.dumps(state)[:-1]}, "roads": [{", ".join(self._road)}]}}'
            while not (self.is_over and queue.empty()):
                text = None
                with suppress(TimeoutError):
                    text = await asyncio.wait_for(queue.get(), 1.0)
                    if text is None:  # it was too slow
                        return
                yield text
        finally:
            self._watchers.discard(queue)

    def _say(self, document: "Document", _answer: "Answer | None") -> None:
        """Pass on what the session says; called by its thread, and of what is dropped by the event loop."""
        if document["type"] in ("dropped", "refused") and document["frame"] is not None and self.keeper is not None:
            self.keeper.lose(document["frame"])
        if document["type"] == "end" and self.keeper is not None:
            try:
                document["drive_id"], document["job_id"] = self.keeper.finish()
            except Problem as problem:
                document["drive_id"], document["problem"] = self.keeper.drive_id, problem.detail
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._tell, document)

    def _keep(self, scan: LiveScan) -> None:
        if self.keeper is not None:
            try:
                _patiently(partial(self.keeper.keep, scan))
            except Problem as problem:
                raise DriveError(f"the scan could not be kept: {problem.detail}") from problem

    def _tell(self, document: "Document | RepeatedDocument") -> None:
        if self.is_over:
            return
        self._held["scans"] = self._worker.held_bytes
        self._remember(document)
        text = json.dumps(document)
        frame = document["frame"]
        is_final = document["type"] in ("end", "failed") or (document["type"] == "refused" and frame is None)
        if frame is None or is_final or (document["type"] == "scan" and document["vehicle"] is None):
            frame = sys.maxsize  # it always comes again: the last keyframes share a number
        self._said.append((frame, text))
        listeners = self._watchers if self.sender is None else {self.sender, *self._watchers}
        for queue in listeners:
            _put(queue, text)
        if is_final:
            self._worker.abandon()
            self.refusal = document["reason"] if document["type"] in ("refused", "failed") else None
            self.is_over, self.quiet_since = True, time.monotonic()
            self._when_quiet()
            if self.sender is not None:
                _put(self.sender, None)

    def _remember(self, document: "Document | RepeatedDocument") -> None:
        if document["type"] in ("scan", "dropped", "end"):
            self._dropped = document["dropped"]
        if document["type"] != "scan":
            return
        self._keyframes += document["is_keyframe"]
        vehicle = document["vehicle"]
        if vehicle is not None:
            self._vehicle = vehicle
            x, y = vehicle["world_x_m"], vehicle["world_y_m"]
            self._track.append([vehicle.get("lon_deg", x), vehicle.get("lat_deg", y)])
        if document["road"]:
            self._road.append(json.dumps(document["road"]))
            self._road_bytes += len(self._road[-1])
            while self._road_bytes > _MAX_ROAD:
                self._road_bytes -= len(self._road.popleft())
        for event in document["events"]:
            if event["kind"] == "gone":
                self._intersections.pop(event["id"], None)
            else:
                self._intersections[event["id"]] = event


def _put(queue: asyncio.Queue[str | None], text: str | None) -> None:
    """Pass on a message; a listener that is too far behind is sent away by None instead."""
    if queue.full():
        queue.get_nowait()
        text = None
    queue.put_nowait(text)


class LiveSessions:
    """The sessions of this server; to be used in the event loop."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self.watching: Counter[str] = Counter()
        """How many times each client watches."""
        self._entries: dict[str, LiveEntry] = {}

    def begin(self, begin: Begin, owner: str, config: DetectorConfig) -> LiveEntry:
        """Begin a session; a 429 where the client, or all together, have too many."""
        self.tidy()
        running = [each for each in self._entries.values() if not each.is_over]
        limit = min(self._context.settings.max_live_sessions, _MAX_OF_ALL // 2)
        if sum(each.owner == owner for each in running) >= limit or len(running) >= _MAX_OF_ALL:
            raise Problem(
                TOO_MANY_SESSIONS,
                f"A client may have {limit} live sessions at a time, all together {_MAX_OF_ALL}. End one "
                "(DELETE /api/v1/live/{id}), or wait until one that is abandoned expires.",
            )
        idle_s, loop = self._context.settings.live_idle_s, asyncio.get_running_loop()
        entry = LiveEntry(begin, owner, config, lambda: loop.call_later(idle_s + 1.0, self.tidy))
        self._entries[entry.id] = entry
        return entry

    def find(self, session: str, owner: str | None = None) -> LiveEntry:
        """Return a session, of an owner if one is given; a 404 where there is none, or it has ended long ago."""
        self.tidy()
        entry = self._entries.get(session)
        if entry is None or owner not in {None, entry.owner}:
            raise Problem(NOT_FOUND, f"There is no live session {session} that goes on. Begin another one.")
        return entry

    def watched(self, session: str, client: str) -> LiveEntry:
        """Return a session that a client is to watch, as `find`; a 429 where it watches too many times already."""
        if self.watching[client] >= _MAX_WATCHING:
            detail = f"A client may watch live sessions {_MAX_WATCHING} times at once. Close another page first."
            raise Problem(TOO_MANY_SESSIONS, detail)
        return self.find(session)

    def list(self) -> list[LiveEntry]:
        """Return the sessions, the newest first."""
        self.tidy()
        return list(self._entries.values())[::-1]

    def tidy(self) -> None:
        """Forget what nobody has used for a while."""
        before = time.monotonic() - self._context.settings.live_idle_s
        for entry in list(self._entries.values()):
            if entry.quiet_since is not None and entry.quiet_since < before:
                entry.refuse("its sender was away for too long.")
                del self._entries[entry.id]

    def stop(self) -> None:
        """End all of them."""
        for entry in self._entries.values():
            entry.refuse("the server stops.")
