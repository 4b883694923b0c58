"""Check whether a requested job can be done: its settings and map are looked at before it is queued."""

from __future__ import annotations

from typing import Any

from sqlalchemy.orm import Session

from app.context import Context
from app.http.problems import Problem, disk_full
from app.schemas.jobs import NewJob, OsmFile, OsmOverpass
from app.store.models import DriveFile
from interloc.config import DetectorConfig, parse_config, preset
from interloc.osm.container import MAP_ENDINGS, is_map


def check_request(session: Session, context: Context, new: NewJob) -> dict[str, Any]:
    """Return the request as it is stored and worked on, with all settings spelled out.

    Raises
    ------
    ConfigError
        A setting is refused.
    Problem
        422 there is no such map; 507 the disk is full.
    """
    if context.storage.free_bytes() < context.settings.min_free_bytes:
        raise disk_full()
    if isinstance(new.osm, OsmFile):
        if session.get(DriveFile, (new.drive_id, new.osm.file)) is None:
            raise Problem(
                422,
                "Map not found",
                f"osm.file: there is no {new.osm.file!r} among the files of drive {new.drive_id}. Upload it first: "
                f"PUT /api/v1/drives/{new.drive_id}/files/{{path}}.",
            )
        if not is_map(new.osm.file):
            raise Problem(
                422, "Not a map", f"osm.file: {new.osm.file!r}; expected a name that ends in {', '.join(MAP_ENDINGS)}."
            )
    elif new.osm is not None and not context.settings.overpass:
        raise Problem(
            422,
            "Overpass switched off",
            "osm.overpass: this service does not ask Overpass servers. Upload the map as a file and name it: "
            '{"file": "map.osm.gz"}.',
        )
    _check_placing(new)
    request = new.model_dump(mode="json", exclude={"drive_id", "config"})
    return request | {"config": _config_of(new).model_dump(mode="json")}


def _check_placing(new: NewJob) -> None:
    if new.georeference != "map":
        if new.near is not None:
            raise Problem(422, "Not used", 'near: it says where to search with "georeference": "map"; give both.')
        return
    if new.osm is None:
        raise Problem(
            422,
            "Map needed",
            'georeference: the drive is to be placed on the map, and osm names none. Give it: {"file": "map.osm.gz"}.',
        )
    if isinstance(new.osm, OsmOverpass) and new.near is None:
        raise Problem(
            422,
            "Place needed",
            "near: the map of which place is to be fetched? Say roughly where the drive was, or upload a map.",
        )


def _config_of(new: NewJob) -> DetectorConfig:
    base = preset(new.preset).model_dump(mode="json")
    return parse_config(_merged(base, new.config or {}), strict=True)


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Merge settings into others, section by section; a new `kind` starts from the defaults of that kind."""
    merged = dict(base)
    for name, value in changes.items():
        before = base.get(name)
        merged[name] = value
        if isinstance(before, dict) and isinstance(value, dict) and value.get("kind") in (None, before.get("kind")):
            merged[name] = _merged(before, value)
    return merged
