"""Results as STAC 1.1: a catalogue, and an item for each drive about the result that stands for it."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from typing import Any

from app.http.delivery import MEDIA_TYPES
from app.jobs.chosen import choice_of
from app.overview.features import drive_features
from app.results.folder import Result
from app.stac.models import StacAsset, StacCatalog, StacItem, StacLink
from app.store.database import moment
from app.store.models import Job
from app.store.storage import Storage
from interloc.errors import InterLocError
from interloc.output.credits import Credit
from interloc.output.geojson import box_around, read_json
from interloc.output.layers import LAYERS
from interloc.output.layout import RUN_FILE

STAC_VERSION = "1.1.0"
_JSON = "application/json"
_GEOJSON = MEDIA_TYPES[".geojson"]
_TITLE = "InterLoc: road intersections in LiDAR drives"


def catalog(base: str, drives: Iterable[tuple[str, str]]) -> StacCatalog:
    """Return the catalogue.

    Parameters
    ----------
    base
        Absolute address of the service, without a slash at its end.
    drives
        Id and name of every drive that has a result.
    """
    links = [
        StacLink(rel="root", href=f"{base}/stac", type=_JSON, title=_TITLE),
        StacLink(rel="self", href=f"{base}/stac", type=_JSON, title=_TITLE),
    ]
    links += [
        StacLink(rel="item", href=f"{base}/stac/drives/{drive}", type=_GEOJSON, title=name) for drive, name in drives
    ]
    return StacCatalog(
        stac_version=STAC_VERSION,
        id="interloc",
        title=_TITLE,
        description="Drives with LiDAR, and the road intersections found in them: the pinned or best result of each.",
        links=links,
    )


def item(base: str, storage: Storage, job: Job, result: Result, pinned: str | None) -> StacItem:
    """Return the item of a drive.

    Parameters
    ----------
    base
        As of `catalog`.
    job, result
        The job that stands for the drive, and what it left.
    pinned
        Id of the job that was pinned.

    Raises
    ------
    DamagedResultError
        A file of the result is damaged or missing.
    """
    run = read_json(result.folder / RUN_FILE)
    geometry = next(drive_features(storage, result.drive_id, result.drive_name, job, pinned))["geometry"]
    credit = _credit_of(result)
    here = f"{base}/stac/drives/{result.drive_id}"
    links = [
        StacLink(rel="root", href=f"{base}/stac", type=_JSON, title=_TITLE),
        StacLink(rel="parent", href=f"{base}/stac", type=_JSON, title=_TITLE),
        StacLink(rel="self", href=here, type=_GEOJSON, title=result.drive_name),
        StacLink(rel="alternate", href=f"{base}/#job={job.id}", type="text/html", title="The result on the map"),
    ]
    if credit.license is not None:
        links.append(StacLink(rel="license", href=credit.license, type="text/html", title="ODbL 1.0"))
    return StacItem(
        stac_version=STAC_VERSION,
        id=result.drive_id,
        geometry=geometry,
        bbox=None if geometry is None else box_around([geometry]),
        properties={
            "title": result.drive_name,
            **_time_of(run, job),
            "created": _text(moment(job.finished_at or job.created_at)),
            "interloc:job": job.id,
            "interloc:chosen": choice_of(pinned, job.id),
            "interloc:intersections": (job.summary or {}).get("intersections"),
            "attribution": credit.attribution,
            **({} if credit.license is None else {"license": "ODbL-1.0"}),
        },
        links=links,
        assets=_assets(f"{base}{result.address}", result),
    )


def _time_of(run: dict[str, Any], job: Job) -> dict[str, Any]:
    """Return when a drive was; STAC needs a time, which not every drive has."""
    first, last = run.get("first_time"), run.get("last_time")
    if first is None or last is None:
        return {"datetime": _text(moment(job.created_at)), "interloc:datetime_of": "job"}
    return {"datetime": None, "start_datetime": first, "end_datetime": last, "interloc:datetime_of": "drive"}


def _credit_of(result: Result) -> Credit:
    try:
        return (
            LAYERS["intersections"].read(result.layer("intersections")).credit if result.is_georeferenced else Credit()
        )
    except InterLocError:  # damaged: `interloc check` finds it
        return Credit()


def _assets(address: str, result: Result) -> dict[str, StacAsset]:
    """Return the files of a result, those in metres where it has no georeference."""
    named = {
        "intersections": ("/intersections", ".geojson", "Intersections", ["data"]),
        "geopackage": ("/export.gpkg", ".gpkg", "All layers, for GIS", ["data"]),
        "pmtiles": ("/export.pmtiles", ".pmtiles", "All layers as vector tiles, for web maps", ["data", "visual"]),
    }
    if not result.is_georeferenced:
        named = {"intersections": ("/files/intersections.local.json", ".json", "Intersections, in metres", ["data"])}
    if (result.folder / "report.html").exists():
        named["report"] = ("/report?format=html", ".html", "Scored against OpenStreetMap", ["metadata"])
    named["run"] = ("/run", ".json", "Settings, versions, timings", ["metadata"])
    return {
        name: StacAsset(href=f"{address}{path}", type=MEDIA_TYPES[suffix].partition(";")[0], title=title, roles=roles)
        for name, (path, suffix, title, roles) in named.items()
    }


def _text(time: datetime) -> str:
    return time.isoformat(timespec="milliseconds").replace("+00:00", "Z")
