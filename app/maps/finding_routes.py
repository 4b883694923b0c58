"""Endpoints: the queue of what OpenStreetMap has wrong by a map of many drives, and its deliveries."""

from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path as FilePath
from typing import Annotated, Literal, get_args
from urllib.parse import urlencode

from fastapi import Path, Query, Request, Response
from sqlalchemy import select

from app.context import Context, ContextDep
from app.http.delivery import answer_tagged, deliver
from app.http.fields import TEXT
from app.http.gate import ClientDep
from app.http.parameters import answer_page
from app.http.prices import priced
from app.http.problem_types import NO_SUCH_FINDING
from app.http.problems import Problem
from app.http.routing import API, ApiRouter
from app.maps import records
from app.maps.work import AUDIT
from app.ogc.documents import GEOJSON
from app.ogc.routes import MapId
from app.store.models import MapVerdict
from interloc.city.maproulette import MAX_TASKS, maproulette
from interloc.city.models import Judgement, Precision, judgement_of, latest
from interloc.errors import OutputError
from interloc.osm.policies import FindingKind
from interloc.output.geojson import Feature, FeatureCollection, encode, read_as

router = ApiRouter(f"{API}/maps/{{map_id}}", tags=["Maps"])

_FindingId = Annotated[str, Path(description="Id of the finding.", max_length=64, pattern=TEXT)]

_Delivery = Annotated[
    Literal["maproulette.geojson", "findings.geojson"],
    Path(description="maproulette.geojson holds tasks for MapRoulette, line by line; at most 1,000."),
]


@router.get_and_head("/deliveries/{name}", response_class=Response, responses={200: {"content": {GEOJSON: {}}}})
@priced("heavy", bound="the findings of one map")
def read_delivery(map_id: MapId, name: _Delivery, request: Request, context: ContextDep) -> Response:
    """Give the findings but those marked wrong or fixed. The same finding has the same identity in each upload."""
    collection, last = _findings(context, map_id), latest(_judgements(context, map_id))
    done = {"wrong", "fixed"}
    features = [
        each for each in collection["features"] if each["id"] not in last or last[each["id"]].verdict not in done
    ]
    if name == "maproulette.geojson":
        text = maproulette(features[:MAX_TASKS])
    else:
        text = encode({**collection, "features": features})
    return answer_tagged(request, text.encode(), GEOJSON)


@router.get_and_head("/queue", response_model=records.QueuePage, summary="List findings")
@priced("heavy")
def list_queue(
    map_id: MapId,
    request: Request,
    context: ContextDep,
    state: Annotated[records.State, Query(description="open: nobody has looked at them.")] = "open",
    kind: Annotated[FindingKind | None, Query(description="Only those of this kind.")] = None,
    after: Annotated[str | None, Query(max_length=64, pattern=TEXT, description="`next` of the previous page.")] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> Response:
    """List findings, those judged also where the last audit has them no more, and how many of those judged are right.

    Verdicts are kept with who gave them and when. A place marked wrong never comes back, whatever is merged later.
    """
    features, last = _features(context, map_id), latest(_judgements(context, map_id))
    ids = sorted({*features, *last}) if state != "open" else sorted(features)
    some = [
        each
        for each in ids
        if (state == "all" or (each in last) == (state == "judged"))
        and (kind is None or kind == (features[each]["properties"]["kind"] if each in features else last[each].kind))
    ]
    left, root = [each for each in some if after is None or each > after], context.settings.root_path
    page = records.QueuePage(
        entries=[_entry(root, map_id, each, features.get(each), last.get(each)) for each in left[:limit]],
        open=len(features.keys() - last.keys()),
        judged=len(last),
        precision=Precision.of(each.verdict for each in last.values()),
        by_kind={
            each: Precision.of(j.verdict for j in last.values() if j.kind == each) for each in get_args(FindingKind)
        },
        next=left[limit - 1] if len(left) > limit else None,
    )
    return answer_page(request, page)


@router.get_and_head("/queue/{finding}", response_model=records.WholeEntry, summary="Show a finding")
@priced("heavy", bound="the findings of one map")
def show_finding(map_id: MapId, finding: _FindingId, request: Request, context: ContextDep) -> Response:
    """Show a finding with links to where it can be seen and mended, and the next and previous open ones."""
    return answer_tagged(request, _whole(context, map_id, finding).model_dump_json().encode())


@router.put("/queue/{finding}/verdict", summary="Say what you saw there")
@priced("heavy", bound="the findings of one map")
def judge_finding(
    map_id: MapId, finding: _FindingId, new: records.NewVerdict, context: ContextDep, client: ClientDep
) -> records.WholeEntry:
    """Keep what you saw there, with your name and the time; earlier verdicts stay in its history."""
    features, last = _features(context, map_id), latest(_judgements(context, map_id))
    if finding not in features and finding not in last:
        raise _no_finding(map_id, finding)
    with context.database.writing() as session:
        now = context.database.clock(session)
        at = datetime.fromtimestamp(now, UTC)
        if finding in features:
            judgement = judgement_of(features[finding], new.verdict, client, at, new.note)
        else:
            judgement = last[finding].model_copy(
                update={"verdict": new.verdict, "by": client, "at": at, "note": new.note}
            )
        content = judgement.model_dump(mode="json")
        session.add(MapVerdict(map_id=map_id, finding=finding, at=now, judgement=content))
    context.maps_changed.set()
    return _whole(context, map_id, finding)


@router.delete("/queue/{finding}/verdict", status_code=204, summary="Take a verdict back")
@priced("cheap")
def take_verdict_back(map_id: MapId, finding: _FindingId, context: ContextDep) -> None:
    """Take back what was said last of a finding, as after a slip: the verdict before it counts again."""
    with context.database.writing() as session:
        records.find_map(session, map_id)
        given = select(MapVerdict).where(MapVerdict.map_id == map_id, MapVerdict.finding == finding)
        last = session.scalar(given.order_by(MapVerdict.at.desc(), MapVerdict.id.desc()).limit(1))
        if last is None:
            raise _no_finding(map_id, finding, "judged ")
        session.delete(last)
    context.maps_changed.set()


@router.get_and_head("/queue/{finding}/picture.png", response_class=Response)
@priced("cheap")
def show_picture(map_id: MapId, finding: _FindingId, request: Request, context: ContextDep) -> Response:
    """Show the road (grey) and other ground (green) that the drives saw, their tracks (blue), and the place (cross)."""
    known = finding if finding in _features(context, map_id) else ""
    path = context.storage.folder(records.map_key(map_id)) / AUDIT / "pictures" / f"{known}.png"
    if not path.is_file():
        raise _no_finding(map_id, finding)
    return deliver(request, path)


def _findings(context: Context, map_id: str) -> FeatureCollection:
    with context.database.reading() as session:
        records.find_map(session, map_id)
    path = context.storage.folder(records.map_key(map_id)) / AUDIT / "findings.geojson"
    try:
        return _read(path, path.stat().st_mtime_ns)
    except (OSError, OutputError):
        return {"type": "FeatureCollection", "features": []}


@lru_cache(16)
def _read(path: FilePath, _mtime_ns: int) -> FeatureCollection:
    return read_as(FeatureCollection, path)


def _features(context: Context, map_id: str) -> dict[str, Feature]:
    return {str(each["id"]): each for each in _findings(context, map_id)["features"]}


def _judgements(context: Context, map_id: str) -> list[Judgement]:
    with context.database.reading() as session:
        return records.judgements_of(session, [map_id])[map_id]


def _no_finding(map_id: str, finding: str, kind: str = "") -> Problem:
    listed = f"GET /api/v1/maps/{map_id}/queue?state=all lists them."
    return Problem(NO_SUCH_FINDING, f"The map {map_id} has no {kind}finding {finding!r}. {listed}")


def _entry(root: str, map_id: str, finding: str, feature: Feature | None, last: Judgement | None) -> records.QueueEntry:
    picture = None
    if feature is not None:
        assert feature["geometry"] is not None
        (lon, lat), kind = feature["geometry"]["coordinates"], feature["properties"]["kind"]
        picture = f"{root}{API}/maps/{map_id}/queue/{finding}/picture.png"
    else:
        assert last is not None
        lon, lat, kind = last.lon, last.lat, last.kind
    box = {"left": lon - 0.001, "right": lon + 0.001, "top": lat + 0.0007, "bottom": lat - 0.0007}
    box_text = urlencode({key: f"{value:.7f}" for key, value in box.items()})
    return records.QueueEntry(
        id=finding,
        lon=lon,
        lat=lat,
        kind=kind,
        properties=None if feature is None else feature["properties"],
        verdict=last,
        picture=picture,
        links=records.Links(
            osm=f"https://www.openstreetmap.org/?mlat={lat}&mlon={lon}#map=19/{lat}/{lon}",
            id=f"https://www.openstreetmap.org/edit?editor=id#map=19/{lat}/{lon}",
            josm=f"http://127.0.0.1:8111/load_and_zoom?{box_text}",
            mapillary=f"https://www.mapillary.com/app/?lat={lat}&lng={lon}&z=18",
            panoramax=f"https://api.panoramax.xyz/#focus=map&map=18/{lat}/{lon}",
        ),
    )


def _whole(context: Context, map_id: str, finding: str) -> records.WholeEntry:
    features, judgements = _features(context, map_id), _judgements(context, map_id)
    last = latest(judgements)
    if finding not in features and finding not in last:
        raise _no_finding(map_id, finding)
    open_ = sorted(features.keys() - last.keys())
    behind, before = [each for each in open_ if each > finding], [each for each in open_ if each < finding]
    return records.WholeEntry(
        **_entry(context.settings.root_path, map_id, finding, features.get(finding), last.get(finding)).model_dump(),
        next=behind[0] if behind else before[0] if before else None,
        previous=before[-1] if before else None,
        history=[each for each in judgements if each.finding == finding],
    )
