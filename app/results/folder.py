"""The result folder of a job, or the reason why there is none."""

import asyncio
import logging
import re
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from app.context import Context, part_of_app
from app.http import problem_types as kinds
from app.http.problems import Problem
from app.jobs.runner import Runner
from app.jobs.view import find_job
from app.paths import without_folder
from app.results.work import VIEW, draw_keyframe, draw_road_picture, write_export
from app.states import JobKind, JobState
from app.work.requests import IntersectionsJob, StoredRequest
from interloc.arrays import JsonObject
from interloc.errors import DamagedResultError, OutputError
from interloc.output.layout import ROAD_FILE, ROAD_LAYERS, RUN_FILE, file_names

_STATES = {
    JobState.ACCEPTED: "It waits for its turn; follow GET {job}/events.",
    JobState.RUNNING: "It runs; follow GET {job}/events.",
    JobState.FAILED: "It failed; GET {job} says why.",
    JobState.DISMISSED: "It was cancelled; submit it again.",
}


@dataclass(frozen=True)
class Result:
    """The result of a successful job."""

    job_id: str
    drive_id: str
    drive_name: str
    address: str
    """Of the job, below the root of the service."""
    folder: Path
    drive: Path
    """Folder of its drive."""
    cache: Path
    """Folder for what is derived from the result; it goes with the job."""
    request: StoredRequest
    """What the job was asked for, completed."""
    is_scored: bool

    @property
    def is_georeferenced(self) -> bool:
        """Whether positions have longitude and latitude."""
        return (self.folder / file_names(georeferenced=True)["keyframes"]).exists()

    @property
    def slug(self) -> str:
        """Name of the drive, fit for file names, in whatever script."""
        return re.sub(r"[^\w.-]+", "_", self.drive_name).strip("._")[:80] or "drive"

    def damaged(self) -> Problem:
        """Return the problem of a result that is not whole."""
        detail = f"A file of the result of job {self.job_id} is damaged or missing. Submit the job again."
        return Problem(kinds.RESULT_DAMAGED, detail)

    def layer(self, name: str) -> Path:
        """Return the GeoJSON file of a layer, or a 404 that says why there is none."""
        path = self.folder / f"{name}.geojson"
        local = file_names(georeferenced=False).get(name)
        if local is not None:
            if not path.exists():
                self.require_georeference(f"The same in metres of its own frame: {self.address}/files/{local}")
                if name in ROAD_LAYERS:
                    detail = f"Job {self.job_id} has no {path.name}: an older version made its result. Submit it again."
                    raise Problem(kinds.NOT_IN_THIS_RESULT, detail)
                raise self.damaged()
            return path
        if not path.exists():
            self.evaluation_file("report.json")
            raise Problem(kinds.NOT_IN_THIS_RESULT, f"The result of job {self.job_id} has no {path.name}.")
        return path

    def layer_file(self, name: str) -> Path:
        """Return the file of a layer to be exported: in metres of its own frame where the drive has no georeference.

        A 404 says why the result has none.
        """
        local = self.folder / file_names(georeferenced=False).get(name, "")
        return local if local.is_file() else self.layer(name)

    def require_georeference(self, hint: str) -> None:
        """Raise a 404 where the drive has no georeference."""
        if not self.is_georeferenced:
            raise Problem(
                kinds.NOT_GEOREFERENCED,
                f"Drive {self.drive_name} has no georeference (neither oxts/ nor geo.csv), so nothing of it has "
                f"longitude and latitude. {hint}.",
            )

    def evaluation_file(self, name: str) -> Path:
        """Return a file of the evaluation; a 404 where the job was not scored."""
        path = self.folder / name
        if not path.exists():
            if self.is_scored:
                raise self.damaged()
            self.require_georeference("Only a drive with one can be scored")
            raise Problem(
                kinds.NOT_SCORED,
                f"Job {self.job_id} has no evaluation: no map was given, or it did not serve (`summary.missing`). "
                'Submit one with "osm": {"file": "map.osm.gz"} or {"overpass": true}.',
            )
        return path

    def road(self) -> Path:
        """Return the GeoTIFF of the road seen by LiDAR, or a 404 that says why there is none."""
        path = self.folder / ROAD_FILE
        if not path.exists():
            detail = (
                f"The result of job {self.job_id} has no {ROAD_FILE}: no road was seen, or an older version of the "
                "service made it. Submit the job again."
            )
            raise Problem(kinds.NOT_IN_THIS_RESULT, detail)
        return path

    def file(self, name: str) -> Path:
        """Return any file of the result by its path in it; a 404 where there is none."""
        path = self.folder / name
        try:
            inside = "\0" not in name and path.resolve().is_relative_to(self.folder.resolve())
            is_there = inside and path.is_file()
        except OSError:  # no file system has names so long
            is_there = False
        if not is_there:
            raise Problem(kinds.FILE_NOT_FOUND, f"The result has no file {name!r}; {self.address}/files lists them.")
        return path

    def files(self) -> list[Path]:
        """Return the paths of all files, relative to the folder, in order."""
        return sorted(p.relative_to(self.folder) for p in self.folder.rglob("*") if p.is_file())


class Results:
    """The results of all jobs.

    To look one up costs three times as much as to answer, so one that was found is believed until something is written
    here, or the second is over: another server may have deleted it.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._find_anew = lru_cache(100)(self._find)

    def open(self, job_id: str) -> Result:
        """Find the result of a job: 404 no such job, or none with results; 409 not successful (yet); 410 gone."""
        result = self._find_anew(job_id, self._context.database.writes, int(time.monotonic()))
        if not (result.folder / RUN_FILE).exists():
            detail = f"The result of job {job_id} is no longer on disk. Submit the job again."
            raise Problem(kinds.RESULT_IS_GONE, detail)
        return result

    def _find(self, job_id: str, _writes: int, _second: int) -> Result:
        with self._context.database.reading() as session:
            job, drive_name = find_job(session, job_id)
        address = f"/api/v1/jobs/{job_id}"
        if job.kind != JobKind.INTERSECTIONS:
            raise Problem(
                kinds.NO_RESULTS, f"Job {job_id} is a {job.kind}; only jobs of kind intersections have results."
            )
        if job.state != JobState.SUCCESSFUL:
            detail = f"Job {job_id} is {job.state}. {_STATES[JobState(job.state)].format(job=address)}"
            raise Problem(kinds.RESULT_NOT_READY, detail, state=job.state)
        storage = self._context.storage
        own = storage.folder(f"jobs/{job_id}")
        return Result(
            job_id=job_id,
            drive_id=job.drive_id,
            drive_name=drive_name,
            address=address,
            folder=own / "result",
            drive=storage.folder(f"drives/{job.drive_id}"),
            cache=own / "cache",
            request=job.request,
            is_scored=bool((job.summary or {}).get("report")),
        )


ResultsDep = Annotated[Results, part_of_app("results")]


# Files that are made from a result when somebody asks for them, by the workers, and kept with the job.

_MAX_DRAWING = 2  # workers that a server lends to pictures: jobs go on in the meantime
_MAX_RUNNING = 64

_log = logging.getLogger(__name__)


class OnDemand:
    """Makes each file once, however many ask for it at the same time."""

    def __init__(self, runner: Runner) -> None:
        self._runner = runner
        self._running: dict[Path, asyncio.Task[Any]] = {}
        self._drawing = asyncio.Semaphore(_MAX_DRAWING)

    async def export(self, result: Result, path: Path, layer: str | None, client: str) -> None:
        """Write a layer of a result, or all, as a file for other programs; 500 where the result is damaged."""
        write = partial(
            self._runner.run_in_worker, write_export, result.folder, path, layer, result.drive_name, client=client
        )
        await self._once_of(result, path, write)

    async def road(self, result: Result, client: str) -> Path:
        """Return the folder of the picture of the road seen by LiDAR; problems as of `export`."""
        folder = result.cache / "road"
        if not (folder / VIEW).exists():
            draw = partial(self._runner.run_in_worker, draw_road_picture, result.folder, folder, client=client)
            await self._once_of(result, folder, draw)
        return folder

    async def keyframe(self, result: Result, frame: int, client: str) -> Path:
        """Return the folder of the pictures of a keyframe (else a 404); 503 where too many wait for pictures."""
        folder = result.cache / "bev" / str(frame)
        if (folder / VIEW).exists():
            return folder
        if folder not in self._running and len(self._running) >= _MAX_RUNNING:
            raise Problem(kinds.BUSY, "Too many keyframes are being drawn.", headers={"Retry-After": "2"})
        nearest = await self._once(folder, lambda: self._draw(result, frame, folder, client))
        if nearest != frame:
            raise Problem(
                kinds.NO_SUCH_KEYFRAME,
                f"Scan {frame} is not a keyframe of job {result.job_id}; the nearest one is {nearest}. "
                f"GET {result.address}/layers/keyframes lists them.",
                nearest=nearest,
            )
        return folder

    async def _draw(self, result: Result, frame: int, folder: Path, client: str) -> int:
        request = IntersectionsJob.model_validate(result.request)
        async with self._drawing:
            return await self._runner.run_in_worker(
                draw_keyframe, result.drive, result.drive_name, request, frame, folder, client=client
            )

    async def _once_of(self, result: Result, path: Path, work: Callable[[], Coroutine[Any, Any, Any]]) -> None:
        """Wait for the work on a file that is made of a result only."""
        try:
            await self._once(path, work)
        except DamagedResultError as error:
            _log.error("job %s: %s", result.job_id, error)
            raise result.damaged() from error
        except OutputError as error:
            raise OutputError(without_folder(str(error), path.parent, result.drive_name)) from error

    async def _once(self, path: Path, work: Callable[[], Coroutine[Any, Any, Any]]) -> Any:  # noqa: ANN401
        """Wait for the work on a file, begun here or by another request; a request that goes away does not end it."""
        if path not in self._running:
            task = asyncio.create_task(work())
            self._running[path] = task
            task.add_done_callback(lambda _: self._running.pop(path, None))
        return await asyncio.shield(self._running[path])


OnDemandDep = Annotated[OnDemand, part_of_app("on_demand")]


# What results look like, for the description of the API.

MEDIA_TYPE = "application/geo+json"

LayerName = Literal[
    "intersections",
    "roads",
    "trajectory",
    "osm_nodes",
    "detections",
    "keyframes",
    "junctions",
    "road_surface",
    "matches",
    "osm_roads",
    "osm_buildings",
    "places",
]
"""The layers that are files of a result, as in `interloc.output.layers.LAYERS`."""


class Feature(BaseModel):
    """A feature of a layer."""

    type: Literal["Feature"]
    id: str | int
    geometry: JsonObject | None = Field(description="Longitude first; lines and areas may have several parts.")
    properties: JsonObject = Field(description="Those that docs/attributes.md lists.")
    details: JsonObject = Field({}, description="What InterLoc itself reads again, such as covariances.")


class FeatureCollection(BaseModel, json_schema_extra={"x-media-type": MEDIA_TYPE}):
    """A layer of a result."""

    type: Literal["FeatureCollection"]
    drive: str | None = None
    job: str | None = None
    preset: str | None = None
    labels: str | None = Field(None, description="Where the labels of the points came from.")
    attribution: str = Field("", description="Whose data it is.")
    license: str = Field("", description="Address of the licence of OpenStreetMap, where it holds data of it.")
    bbox: list[float] = Field([], description="West, south, east, north of all features; absent where there are none.")
    features: list[Feature]


class ResultFile(BaseModel):
    """A file of a result."""

    name: str = Field(examples=["figures/map.png"])
    size_bytes: int
    media_type: str = Field(examples=["image/svg+xml"])
    href: str = Field(examples=["/api/v1/jobs/9b1e44f00c7a2d53/files/figures/map.png"])


class ResultFileList(BaseModel):
    """All files of a result: the result folder exactly as the command line writes it."""

    files: list[ResultFile]
