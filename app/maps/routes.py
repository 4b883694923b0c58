"""Endpoints: maps of many drives."""

from functools import partial
from typing import Annotated, Literal

from fastapi import Path, Query, Request, Response
from sqlalchemy import case, delete, func, select, tuple_

from app.context import Context, ContextDep
from app.http.delivery import answer_tagged, deliver
from app.http.fields import ID
from app.http.gate import ClientDep
from app.http.intake import Arrival, Placement, check_quota, receive_file
from app.http.openapi import BINARY, body_of
from app.http.parameters import After, answer_page, cursor_at, place_of
from app.http.prices import priced
from app.http.problem_types import MAP_IS_OF_THE_SERVER, NO_SUCH_MAP, NOT_A_MAP, TOO_MANY_MAPS
from app.http.problems import Problem
from app.http.routing import API, ApiRouter
from app.jobs.queue import no_drive
from app.maps.records import OSM, MapDriveList, MapDriveModel, MapList, MapModel, NewMap, find_map, map_key, map_models
from app.maps.work import AUDIT, CITY
from app.ogc.documents import GEOJSON
from app.ogc.routes import MapId
from app.paths import check_path
from app.store.models import CityMap, Drive, MapDrive
from interloc.osm.untrusted import is_map

router = ApiRouter(f"{API}/maps", tags=["Maps"])

MAX_MAPS = 100
"""Of one client."""

_DriveId = Annotated[str, Path(description="Id of the drive.", pattern=ID)]


@router.post("", status_code=201, summary="Make a map of many drives")
@priced("heavy", bound="the drives of one map")
def create_map(new: NewMap, response: Response, context: ContextDep, client: ClientDep) -> MapModel:
    """Make a map of drives; the best or pinned result of each is merged into it, now and whenever that changes."""
    with context.database.writing() as session:
        context.database.lock_owner(session, client)
        own = session.scalar(select(func.count()).where(CityMap.owner == client)) or 0
        if own >= MAX_MAPS:
            raise Problem(
                TOO_MANY_MAPS, f"{client} has {own} maps, and may have {MAX_MAPS}. Delete one that is done with."
            )
        city = CityMap(name=new.name, owner=client, created_at=context.database.clock(session))
        session.add(city)
        session.flush()
        known = set(session.scalars(select(Drive.id).where(Drive.deleted_at.is_(None))))
        for drive_id in dict.fromkeys(new.drives):
            if drive_id not in known:
                raise no_drive(drive_id)
            session.add(MapDrive(map_id=city.id, drive_id=drive_id, is_member=True))
        session.flush()
        (made,) = map_models(session, context, [city])
    context.maps_changed.set()
    response.headers["Location"] = f"{context.settings.root_path}/api/v1/maps/{made.id}"
    return made


@router.get_and_head("", summary="List maps", response_model=MapList)
@priced("heavy")
def list_maps(
    request: Request, context: ContextDep, after: After = None, limit: Annotated[int, Query(ge=1, le=100)] = 100
) -> Response:
    """List the maps of many drives: that of the server, which holds all drives, first."""
    order = case((CityMap.holds_all, 0.0), else_=CityMap.created_at), CityMap.id
    with context.database.reading() as session:
        asked = select(CityMap, order[0]).order_by(*order)
        if after is not None:
            asked = asked.where(tuple_(*order) > tuple_(*place_of(after)))
        rows = session.execute(asked.limit(limit + 1)).all()
        maps = map_models(session, context, [city for city, _ in rows[:limit]])
    following = cursor_at(rows[limit - 1][1], maps[-1].id) if len(rows) > limit else None
    return answer_page(request, MapList(maps=maps, next=following))


@router.get_and_head("/{map_id}", summary="Show a map", response_model=MapModel)
@priced("heavy", bound="one map")
def show_map(map_id: MapId, request: Request, context: ContextDep) -> Response:
    """Show what is on a map of many drives, and how far it is."""
    with context.database.reading() as session:
        (found,) = map_models(session, context, [find_map(session, map_id)])
    return answer_tagged(request, found.model_dump_json().encode())


@router.delete("/{map_id}", status_code=204, summary="Delete a map")
@priced("cheap")
def delete_map(map_id: MapId, context: ContextDep) -> None:
    """Delete a map for good, with its names of places and all verdicts; its drives stay."""
    with context.database.writing() as session:
        if find_map(session, map_id).holds_all:
            raise Problem(MAP_IS_OF_THE_SERVER, f"The map {map_id} holds all drives of the server, and stays.")
        session.execute(delete(CityMap).where(CityMap.id == map_id))
    context.storage.delete(map_key(map_id))


@router.get_and_head("/{map_id}/drives")
@priced("cheap")
def list_map_drives(
    map_id: MapId,
    request: Request,
    context: ContextDep,
    after: Annotated[str | None, Query(pattern=ID, description="`next` of the previous page.")] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> Response:
    """List the drives that belong to a map or are on it, with why one is not."""
    with context.database.reading() as session:
        find_map(session, map_id)
        is_there = Drive.deleted_at.is_(None)
        asked = select(MapDrive, Drive.name).outerjoin(Drive, (Drive.id == MapDrive.drive_id) & is_there)
        asked = asked.where(
            MapDrive.map_id == map_id,
            MapDrive.is_member.is_not(False),
            MapDrive.job_id.is_not(None) | Drive.id.is_not(None),  # rows of deleted drives may stay
            MapDrive.drive_id > (after or ""),
        )
        rows = session.execute(asked.order_by(MapDrive.drive_id).limit(limit + 1)).all()
    drives = [
        MapDriveModel(drive_id=row.drive_id, name=name, label=row.label, job_id=row.job_id, problem=row.problem)
        for row, name in rows[:limit]
    ]
    return answer_page(request, MapDriveList(drives=drives, next=drives[-1].drive_id if len(rows) > limit else None))


@router.put("/{map_id}/drives/{drive_id}", status_code=204)
@priced("cheap")
def put_drive(map_id: MapId, drive_id: _DriveId, context: ContextDep) -> None:
    """Let a drive belong to a map: its result is merged as soon as there is one. Repeating it changes nothing."""
    _put(context, map_id, drive_id, is_member=True)


@router.delete("/{map_id}/drives/{drive_id}", status_code=204)
@priced("cheap")
def take_drive_out(map_id: MapId, drive_id: _DriveId, context: ContextDep) -> None:
    """Take a drive out of a map: it is then as if it had never been there, but for names of places that stay taken."""
    _put(context, map_id, drive_id, is_member=False)


def _put(context: Context, map_id: str, drive_id: str, *, is_member: bool) -> None:
    with context.database.writing() as session:
        city = find_map(session, map_id, lock=True)
        drive, row = session.get(Drive, drive_id), session.get(MapDrive, (map_id, drive_id))
        if (is_member or row is None) and (drive is None or drive.deleted_at is not None):
            raise no_drive(drive_id)
        if row is None:
            row = MapDrive(map_id=map_id, drive_id=drive_id)
            session.add(row)
        row.is_member = None if is_member and city.holds_all else is_member
    context.maps_changed.set()


@router.put(
    "/{map_id}/osm/{name}",
    status_code=204,
    summary="Give a map the OpenStreetMap data to compare it with",
    openapi_extra=body_of({"application/octet-stream": BINARY}),
)
@priced("streaming")
async def put_osm(
    map_id: MapId,
    name: Annotated[str, Path(max_length=200, description="Its name: .osm, .osm.gz, .osm.bz2 or .osm.pbf.")],
    request: Request,
    context: ContextDep,
    client: ClientDep,
) -> None:
    """Send an OSM file; without one of its own a map is compared with those that its drives were scored with."""
    check_path(name)
    if not is_map(name):
        raise Problem(NOT_A_MAP, f"{name} is not an OSM file: .osm, .osm.gz, .osm.bz2 or .osm.pbf.")
    await receive_file(request, name, context.settings.max_file_bytes, partial(_keep_osm, context, map_id, client))


def _keep_osm(context: Context, map_id: str, client: str, arrival: Arrival) -> None:
    """Let a file that was received be the OSM file of a map, in the place of the one before."""
    key = f"{map_key(map_id)}/{OSM}"
    with Placement(context.storage, key) as placement, context.database.writing() as session:
        city = find_map(session, map_id, lock=True)
        check_quota(context, session, city.owner, client, arrival.size_bytes - (city.osm_bytes or 0))
        city.osm, city.osm_bytes = arrival.path, arrival.size_bytes
        placement.move([arrival])
    context.maps_changed.set()
    with context.database.writing() as session:  # once the new one is sure: a kill must not lose both
        kept = find_map(session, map_id, lock=True).osm
        for path in context.storage.folder(key).iterdir():
            if path.name != kept:
                path.unlink()


_File = Literal[
    "city.geojson", "drives.geojson", "roads.geojson", "changes.geojson", "city.json", "findings.geojson", "audit.json"
]


@router.get_and_head(
    "/{map_id}/files/{name}",
    response_class=Response,
    responses={200: {"content": {GEOJSON: {}, "application/json": {}}}},
)
@priced("streaming")
def read_map_file(map_id: MapId, name: _File, request: Request, context: ContextDep) -> Response:
    """Give a file of the map as `interloc merge` and `interloc audit` write it; parts of layers are at `/ogc` of it."""
    folder = context.storage.folder(map_key(map_id))
    path = folder / (AUDIT if name in {"findings.geojson", "audit.json"} else CITY) / name
    if not path.is_file():
        with context.database.reading() as session:
            find_map(session, map_id)
        raise Problem(NO_SUCH_MAP, f"The map {map_id} has no {name} yet. GET /api/v1/maps/{map_id} says how far it is.")
    return deliver(request, path, name=f"{map_id}-{name}")
