"""Features found: of the result that stands for every drive, of one job, or of a map of many drives.

A query first takes the layers that come into question by their boxes and times, some thousand rows for a million
features, then the features of these.
"""

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from json.encoder import encode_basestring
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

from sqlalchemy import (
    ColumnElement,
    Row,
    Select,
    Table,
    and_,
    bindparam,
    case,
    delete,
    func,
    insert,
    literal,
    or_,
    select,
    text,
    true,
    tuple_,
)
from sqlalchemy.exc import OperationalError, SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context
from app.http.parameters import Box
from app.http.problem_types import RESULT_IS_GONE
from app.http.problems import Problem
from app.jobs.view import chosen_results
from app.ogc.collections import GEOMETRY, OF_ALL, OF_JOB, OF_MAP, Collection
from app.ogc.filters import Translator, bad_filter, conjuncts, equalities
from app.ogc.work import LayerRows, rows_of, time_names, time_text
from app.states import JobKind, JobState
from app.store.database import moment
from app.store.models import OF_MAPS, OF_RESULTS, SOUGHT, Drive, FeatureLayer, Job
from interloc.arrays import JsonObject
from interloc.errors import InterLocError
from interloc.output.geojson import encode

Interval = tuple[float, float]
"""First and last second since 1970; infinite where it is open."""

_PATIENCE_S = 3.0
_FEW = 5_000
_OF_RESULT = ("drive", "job", "preset", "labels")


class Key(NamedTuple):
    """The place of a feature in the order of pages."""

    layer: int
    number: int

    def __str__(self) -> str:
        """Return it as it stands in addresses."""
        return f"{self.layer}.{self.number}"


@dataclass(frozen=True)
class Query:
    """What is asked for."""

    area: Box | None = None
    interval: Interval | None = None
    filter: Any = None
    """CQL2 JSON."""
    after: Key | None = None
    """Where the page begins: with the feature after this one."""
    limit: int = 100


@dataclass(frozen=True)
class Page:
    """Some of the features that a query finds."""

    features: list[str]
    """GeoJSON."""
    matched: int
    """Number of all."""
    next: Key | None
    """`Query.after` of the next page."""


@dataclass(frozen=True)
class Extent:
    """What a collection holds."""

    count: int
    box: tuple[float, ...] | None
    """West, south, east, north."""
    times: Interval | None
    attribution: str
    license: str | None


@dataclass(frozen=True)
class Source:
    """Whose features are given."""

    job: str | None = None
    """Of this job; None: of the one that stands for each drive."""
    map: str | None = None

    @property
    def collections(self) -> Mapping[str, Collection]:
        """The collections that there may be."""
        return OF_MAP if self.map is not None else OF_ALL if self.job is None else OF_JOB

    @property
    def is_of_all(self) -> bool:
        """Whether its features are of all drives, and their ids begin with the job."""
        return self.job is None and self.map is None

    def layers(self, *columns: Any) -> Select[Any]:  # noqa: ANN401 - of the tables below
        """Return the query for layers, joined with their drives."""
        if self.map is not None:
            return select(*columns).select_from(FeatureLayer).where(FeatureLayer.map_id == self.map)
        found = select(Job).where(Job.id == self.job) if self.job is not None else chosen_results()
        jobs = found.with_only_columns(Job.id, Job.drive_id).subquery()
        return (
            select(*columns)
            .select_from(jobs)
            .join(FeatureLayer, FeatureLayer.job_id == jobs.c.id)
            .join(Drive, Drive.id == jobs.c.drive_id)
        )


def extents(session: Session, source: Source) -> dict[str, Extent]:
    """Return what the collections of a source hold, by their ids; those of a job only as far as its result has them."""
    of = FeatureLayer
    found = {}
    rows = session.execute(
        source.layers(
            of.layer,
            func.sum(of.count),
            func.min(of.west),
            func.min(of.south),
            func.max(of.east),
            func.max(of.north),
            func.min(of.first_time),
            func.max(of.last_time),
            func.min(of.attribution),
            func.max(of.attribution),
            func.max(of.license),
        ).group_by(of.layer)
    )
    for layer, count, west, south, east, north, first, last, one, other, license_ in rows:
        box = None if west is None else (-180.0, south, 180.0, north) if east > 180.0 else (west, south, east, north)
        times = None if first is None else (first, last)
        attribution = one if one == other else max(one, other, key=len)
        found[layer] = Extent(count, box, times, attribution, license_)
    nothing = Extent(0, None, None, "", None)
    return {
        name: found.get(each.layer.name, nothing)
        for name, each in source.collections.items()
        if source.is_of_all or not found or each.layer.name in found
    }


def find_page(session: Session, source: Source, collection: Collection, query: Query) -> Page:
    """Return a page of the features that a query finds; a 400 where its filter cannot be used or takes too long."""
    search = _Search(session, source, collection, query)
    with _patience(session):
        return search.page()


def find_feature(session: Session, source: Source, collection: Collection, feature: str) -> str | None:
    """Return a feature by its id, which is the same as long as there is the job; None where there is none."""
    job, _, own = feature.partition(".") if source.is_of_all else (source.job, "", feature)
    conditions = [] if job is None else [FeatureLayer.job_id == job]
    layers = _layers(session, source, collection, *conditions)
    table = collection.table
    asked = select(table).where(table.c.layer_id.in_(layers), table.c.feature_id == own).limit(1)
    return next(_features(source, collection, layers, session.execute(asked).all()), None)


def _layers(
    session: Session, source: Source, collection: Collection, *conditions: ColumnElement[bool]
) -> dict[int, Row[Any]]:
    """Return the layers of a collection that have features, by their ids and in their order."""
    of = FeatureLayer
    drive = literal(None) if source.map is not None else Drive.name
    columns = (of.id, of.count.label("features"), of.west, of.east, of.width)
    query = source.layers(*columns, drive.label("drive"), of.job_id.label("job"), of.preset, of.labels)
    query = query.where(of.layer == collection.layer.name, of.count > 0, *conditions).order_by(of.id)
    return {row.id: row for row in session.execute(query)}


class _Search:
    """A query on the table of a collection."""

    def __init__(self, session: Session, source: Source, collection: Collection, query: Query) -> None:
        self._session, self._source, self._collection, self._query = session, source, collection, query
        self._table = table = collection.table
        self._key = tuple_(table.c.layer_id, table.c.number)
        self._layers = _layers(session, source, collection, *self._conditions_on_layers())
        self._joined: Any = table
        self._place = [] if query.area is None else [self._near(query.area)]
        self._rest = list(self._other_conditions())

    def _conditions_on_layers(self) -> Iterator[ColumnElement[bool]]:
        """Yield conditions that hold where one feature of a layer matches."""
        of = FeatureLayer
        if (area := self._query.area) is not None:
            yield or_(*(_touches((of.west, of.south, of.east, of.north), part) for part in area.parts))
        if (interval := self._query.interval) is not None:
            yield or_(of.first_time.is_(None), and_(of.first_time <= interval[1], of.last_time >= interval[0]))
        if self._source.map is None:
            names: JsonObject = {"drive": Drive.name, "job": of.job_id}
            same = equalities(self._query.filter)  # with numbers only for all features: 7 is no text of its own
            yield from (names[name] == value for name, value in same if name in names and isinstance(value, str))

    def _other_conditions(self) -> Iterator[ColumnElement[bool]]:
        table = self._table.c
        if (interval := self._query.interval) is not None:
            first, last = time_names(table.keys())
            if first in table:  # else all features have the times of their layer
                begin, end = (_time_text(each) for each in interval)
                yield or_(table[first].is_(None), and_(table[first] <= end, table[last] >= begin))
        if self._query.filter is not None:
            yield from self._filtered()

    def _filtered(self) -> Iterator[ColumnElement[bool]]:
        of_result = self._source.layers(
            FeatureLayer.id, Drive.name.label("drive"), FeatureLayer.job_id.label("job"), FeatureLayer.preset,
            FeatureLayer.labels,
        ).subquery() if self._source.map is None else None  # fmt: skip
        columns: dict[str, ColumnElement[Any]] = {GEOMETRY: self._table.c.west, **self._table.c}
        if of_result is not None and self._collection.of_results:
            columns |= {name: of_result.c[name] for name in _OF_RESULT}
        is_sqlite = self._session.get_bind().dialect.name == "sqlite"
        translator = Translator(self._collection, columns, self._near, is_sqlite=is_sqlite)
        yield from [translator.condition(each) for each in conjuncts(self._query.filter)]
        if of_result is not None and not translator.used.isdisjoint(_OF_RESULT):
            self._joined = self._table.join(of_result, of_result.c.id == self._table.c.layer_id)

    def _near(self, area: Box) -> ColumnElement[bool]:
        """Return the condition that the box of a feature touches another one: a range of the index."""
        spans = [(each.west, each.east) for each in self._layers.values() if each.west is not None]
        near = [part for part in area.parts if any(west <= part[2] and east >= part[0] for west, east in spans)]
        widest = max((layer.width or 0.0 for layer in self._layers.values()), default=0.0)
        of = self._table.c
        box = of.west, of.south, of.get("east", of.west), of.get("north", of.south)
        return or_(*(and_(of.west >= part[0] - widest - 1e-9, _touches(box, part)) for part in near or area.parts[:1]))

    def _asked(self, *columns: Any, where: Sequence[ColumnElement[bool]]) -> Select[Any]:  # noqa: ANN401
        # Written into the query: databases take only some thousand parameters.
        among: Any = bindparam("layers", list(self._layers), expanding=True, literal_execute=True)
        return select(*columns).select_from(self._joined).where(self._table.c.layer_id.in_(among), *where)

    def page(self) -> Page:
        """Return the page that is asked for."""
        table, query = self._table.c, self._query
        # What singles out few features is counted first. SQLite would go through all features of the first layers for
        # the order of pages where few are found sooner, and sort what is found where many are.
        is_sought = any(name in SOUGHT for name, _ in equalities(query.filter))
        conditions = [*self._place, *self._rest]
        near = sum(layer.features for layer in self._layers.values())
        if self._place or is_sought:
            near = self._count(conditions if is_sought else self._place)
        after = (-1, -1) if query.after is None else tuple(query.after)
        if self._source.map is not None and query.after is not None and query.after.layer not in self._layers:
            raise Problem(RESULT_IS_GONE, "after: the map has changed since that page. Begin with the first one again.")
        if near < _FEW and (is_sought or self._place):
            found = self._session.execute(self._asked(table.layer_id, table.number, where=conditions))
            keys = sorted(map(tuple, found))  # several times as fast as ORDER BY
            left = [key for key in keys if key > after]
            return self._page(self._rows_of(left[: query.limit + 1]), len(keys))
        asked = self._asked(self._table, where=[case((and_(true(), *self._place), 1), else_=0) == 1, *self._rest])
        asked = asked.where(true() if query.after is None else self._key > tuple_(*query.after))
        rows = self._session.execute(asked.order_by(table.layer_id, table.number).limit(query.limit + 1)).all()
        if is_sought or not self._rest:
            return self._page(rows, near)
        is_whole = query.after is None and len(rows) <= query.limit
        return self._page(rows, len(rows) if is_whole else self._count(conditions))

    def _page(self, rows: Sequence[Row[Any]], matched: int) -> Page:
        limit = self._query.limit
        features = _features(self._source, self._collection, self._layers, rows[:limit])
        last = rows[limit - 1] if len(rows) > limit else None
        return Page(list(features), matched, None if last is None else Key(last.layer_id, last.number))

    def _count(self, conditions: Sequence[ColumnElement[bool]]) -> int:
        return self._session.scalar(self._asked(func.count(), where=conditions)) or 0

    def _rows_of(self, keys: Sequence[Sequence[int]]) -> Sequence[Row[Any]]:
        table, rows = self._table.c, list[Row[Any]]()
        for layer, own in groupby(keys, key=itemgetter(0)):
            asked = select(self._table).where(table.layer_id == layer, table.number.in_([number for _, number in own]))
            rows += self._session.execute(asked.order_by(table.number)).all()
        return rows


def _touches(box: Sequence[Any], part: Sequence[float]) -> ColumnElement[bool]:
    west, south, east, north = box
    return and_(west <= part[2], east >= part[0], south <= part[3], north >= part[1])


def _time_text(seconds: float) -> str:
    try:
        return time_text(moment(seconds))
    except (OverflowError, ValueError):
        return "" if seconds < 0 else "~"


@contextmanager
def _patience(session: Session) -> Iterator[None]:
    """Stop what takes too long with a 400, so that nobody keeps the database busy."""
    connection = session.connection()
    is_sqlite = connection.dialect.name == "sqlite"
    driver: Any = connection.connection.dbapi_connection
    if is_sqlite:
        end = time.thread_time() + _PATIENCE_S
        driver.set_progress_handler(lambda: time.thread_time() > end, 100_000)
    else:
        session.execute(text(f"SET LOCAL statement_timeout = {round(1000 * _PATIENCE_S)}"))
    try:
        yield
    except OperationalError as error:
        if not any(sign in str(error.orig) for sign in ("interrupted", "statement timeout")):
            raise
        raise bad_filter("It takes too long. Ask for less of it at a time, or for a smaller bbox.") from None
    finally:
        if is_sqlite:
            driver.set_progress_handler(None, 0)


def _features(
    source: Source, collection: Collection, layers: Mapping[int, Row[Any]], rows: Sequence[Row[Any]]
) -> Iterator[str]:
    """Yield rows as GeoJSON."""
    table = collection.table.c
    printed = [(name, f"{encode(name)}:", _PRINTED[kind]) for name, kind in collection.kinds.items() if name in table]
    for row in rows:
        values, layer = row._mapping, layers[row.layer_id]  # noqa: SLF001 - its public name
        members = [
            f"{key}null" if (value := values[name]) is None else f"{key}{print_(value)}"
            for name, key, print_ in printed
        ]
        if collection.of_results:
            members += [f"{encode(name)}:{encode(getattr(layer, name))}" for name in _OF_RESULT]
        if not collection.is_point:
            geometry = values[GEOMETRY] or "null"
        elif values["west"] is None:
            geometry = "null"
        else:
            geometry = f'{{"type":"Point","coordinates":[{values["west"]!r},{values["south"]!r}]}}'
        own = f"{layer.job}.{row.feature_id}" if source.is_of_all else row.feature_id
        head = f'{{"type":"Feature","id":{encode(own)},"geometry":{geometry},"properties"'
        yield f"{head}:{{{','.join(members)}}}}}"


_PRINTED: dict[str, Callable[[Any], str]] = {
    "int": str,
    "float": repr,
    "text": encode_basestring,
    "list": str,
    "time": lambda value: f'"{value}"',
    "bool": lambda value: "true" if value else "false",
}
"""A value of a table -> JSON."""


# The rows of features follow the results: written when a job ends or a map is merged, and for older jobs later.
#
# The features of jobs whose drive is in the trash stay, and are not shown; they go with its row.

_AT_ONCE = 10_000  # rows
_log = logging.getLogger(__name__)


def write_job_rows(session: Session, job: Job, layers: Iterable[LayerRows]) -> None:
    """Write the features of a job, in the place of those that it had."""
    session.execute(delete(FeatureLayer).where(FeatureLayer.job_id == job.id))
    preset, labels = job.request.get("preset"), job.request.get("labels")
    for each in layers:
        facts = {**each.facts, "preset": preset, "labels": each.facts["labels"] or labels}
        _write(session, OF_RESULTS[each.layer], FeatureLayer(job_id=job.id, layer=each.layer, **facts), each.rows)


def write_map_rows(session: Session, map_id: str, layers: Sequence[LayerRows]) -> None:
    """Write layers of a map of many drives, in the place of those that it had."""
    names = [each.layer for each in layers]
    session.execute(delete(FeatureLayer).where(FeatureLayer.map_id == map_id, FeatureLayer.layer.in_(names)))
    for each in layers:
        _write(session, OF_MAPS[each.layer], FeatureLayer(map_id=map_id, layer=each.layer, **each.facts), each.rows)


def _write(session: Session, table: Table, layer: FeatureLayer, rows: Sequence[JsonObject]) -> None:
    session.add(layer)
    session.flush()
    for start in range(0, len(rows), _AT_ONCE):
        some = [{**values, "layer_id": layer.id} for values in rows[start : start + _AT_ONCE]]
        session.connection().execute(insert(table), some)


def index_result(result: Path) -> Callable[[Session, Job], None]:
    """Read the features of a new result; what is returned writes them."""
    layers = list(rows_of(result))
    return lambda session, job: write_job_rows(session, job, layers)


def index_missing(context: Context) -> int:
    """Write the features of jobs that have no rows, as of older versions; return of how many."""
    indexed = select(FeatureLayer.job_id).where(FeatureLayer.job_id.is_not(None)).distinct()
    is_result = (Job.kind == JobKind.INTERSECTIONS, Job.state == JobState.SUCCESSFUL)
    with context.database.reading() as session:
        missing = session.scalars(
            select(Job.id).where(*is_result, Job.id.not_in(indexed)).order_by(Job.created_at.desc())
        ).all()
    count = 0
    for job_id in missing:
        if context.stopping.is_set():
            break
        try:
            layers = list(rows_of(context.storage.folder(f"jobs/{job_id}/result")))
            if not layers:  # it has no longitude and latitude
                continue
            with context.database.writing(patient=True) as session:
                job = session.get(Job, job_id, with_for_update=True)
                if job is not None:  # not purged meanwhile
                    write_job_rows(session, job, layers)
                    count += 1
        except (InterLocError, OSError, SQLAlchemyError) as error:
            _log.warning("job %s: its features could not be indexed: %s", job_id, error, extra={"job": job_id})
    if count:
        _log.info("the features of %d jobs were indexed", count)
    return count
