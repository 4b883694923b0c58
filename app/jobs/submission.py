"""Check whether a requested job can be done: its settings, map and labels are looked at before it is queued."""

from typing import cast

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.context import Context
from app.http import problem_types as kinds
from app.http.intake import job_limit
from app.http.problems import Problem, disk_full
from app.jobs.folders import label_folders
from app.jobs.models import JobModel, NewJob, OsmFile, OsmOverpass
from app.jobs.queue import submit
from app.jobs.view import find_job, job_models
from app.jobs.webhooks import check_subscriber
from app.states import DriveState, JobKind
from app.store.models import IS_MAP, Drive, DriveFile
from app.store.storage import Storage
from app.work.requests import StoredRequest
from app.work.task import no_georeference
from interloc.arrays import JsonObject
from interloc.config import DetectorConfig, parse_config, preset
from interloc.drives.inspect import DriveReport
from interloc.errors import ConfigError
from interloc.osm.untrusted import MAP_ENDINGS, is_map


def submit_job(context: Context, owner: str, new: NewJob, key: str | None) -> tuple[JobModel, bool]:
    """Queue a job that finds intersections; return it, and whether it is new."""
    with context.database.writing() as session:
        job, is_new = submit(
            session,
            context.database,
            kind=JobKind.INTERSECTIONS,
            drive_id=new.drive_id,
            owner=owner,
            request=check_request(session, context, new),
            key=key,
            limit=job_limit(context, owner),
        )
        (model,) = job_models(session, context, [find_job(session, job.id)])
    context.jobs_changed.set()
    return model, is_new


def check_request(session: Session, context: Context, new: NewJob) -> StoredRequest:
    """Return the request as it is stored and worked on, with all settings spelled out.

    A `ConfigError` refuses a setting, a `GeoreferenceError` a map for a drive without georeference; there is a 422 for
    labels or a map that are not there, a 507 for a full disk.
    """
    if context.storage.free_bytes() < context.settings.min_free_bytes:
        raise disk_full()
    if isinstance(new.osm, OsmFile):
        _check_map_file(session, new.drive_id, new.osm.file)
    elif new.osm is not None and not context.settings.overpass_url:
        raise Problem(
            kinds.OVERPASS_SWITCHED_OFF,
            "osm.overpass: this service does not ask Overpass servers. Upload the map as a file and name it: "
            '{"file": "map.osm.gz"}.',
        )
    _check_placing(new)
    _check_drive(session, context.storage, new)
    request = new.model_dump(mode="json", exclude={"drive_id", "config", "subscriber"})
    request["config"] = config_of(new.preset, new.config).model_dump(mode="json")
    return cast("StoredRequest", request | check_subscriber(context.settings, new.subscriber))


def _check_map_file(session: Session, drive_id: str, name: str) -> None:
    """Refuse (422) a map that is not among the files of the drive, or has no name of one."""
    if session.get(DriveFile, (drive_id, name)) is None and session.get(Drive, drive_id) is not None:
        maps = session.scalars(select(DriveFile.path).where(DriveFile.drive_id == drive_id, IS_MAP).limit(5)).all()
        known = f"It has {', '.join(map(repr, maps))}. " if maps else ""
        raise Problem(
            kinds.MAP_NOT_FOUND,
            f"osm.file: there is no {name!r} among the files of drive {drive_id}. {known}Upload it first: "
            f"PUT /api/v1/drives/{drive_id}/files/{{path}}.",
        )
    if not is_map(name):
        raise Problem(kinds.NOT_A_MAP, f"osm.file: {name!r}; expected a name that ends in {', '.join(MAP_ENDINGS)}.")


def _check_placing(new: NewJob) -> None:
    if new.georeference != "map":
        if new.near is not None:
            raise Problem(kinds.NOT_USED, 'near: it says where to search with "georeference": "map"; give both.')
        return
    if new.osm is None:
        raise Problem(
            kinds.MAP_NEEDED,
            'georeference: the drive is to be placed on the map, and osm names none. Give it: {"file": "map.osm.gz"}.',
        )
    if isinstance(new.osm, OsmOverpass) and new.near is None:
        raise Problem(
            kinds.PLACE_NEEDED,
            "near: the map of which place is to be fetched? Say roughly where the drive was, or upload a map.",
        )


def _check_drive(session: Session, storage: Storage, new: NewJob) -> None:
    """Refuse what a ready drive lacks; of one whose check still runs the job itself finds out."""
    drive = session.get(Drive, new.drive_id)
    if drive is None or drive.state != DriveState.READY:
        return
    folders = [] if new.labels is None else label_folders(storage, new.drive_id)
    if folders and new.labels not in folders:
        raise Problem(
            kinds.LABELS_NOT_FOUND,
            f"labels: drive {new.drive_id} has no {new.labels!r}. Expected one of its label_folders: "
            f"{', '.join(folders)}; or leave `labels` out.",
        )
    lacks_fixes = drive.report is not None and DriveReport.model_validate(drive.report).georeference is None
    if new.osm is not None and new.georeference == "drive" and lacks_fixes:
        raise no_georeference(drive.name)


def config_of(name: str, changes: JsonObject | None) -> DetectorConfig:
    """Return a preset with the settings that a request changes; a `ConfigError` refuses one."""
    if (given := (changes or {}).get("preset", name)) != name:
        raise ConfigError(f"config.preset: found {given!r} beside {name!r}: give `preset` itself, beside `config`")
    return parse_config(_merged(preset(name).model_dump(mode="json"), changes or {}), strict=True)


def _merged(base: JsonObject, changes: JsonObject) -> JsonObject:
    """Merge settings into others, section by section; a new `kind` starts from the defaults of that kind."""
    merged = dict(base)
    for name, value in changes.items():
        before = base.get(name)
        merged[name] = value
        if isinstance(before, dict) and isinstance(value, dict) and value.get("kind") in (None, before.get("kind")):
            merged[name] = _merged(before, value)
    return merged
