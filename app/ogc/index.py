"""Features found in the index: of the newest result of every drive, or of one job.

A query first takes the chunks that come into question by their boxes and times, some thousand rows for a million
features, then reads the columns that it needs of those, and decides for all their features at once. Only the features
of the page that is answered are read themselves.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from threading import BoundedSemaphore
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Select, and_, bindparam, func, or_, select
from sqlalchemy.orm import Session

from app.http.parameters import Box
from app.ogc.collections import OF_ALL, OF_JOB, Collection
from app.ogc.columns import Texts, unpack_blobs, unpack_numbers, unpack_texts
from app.ogc.evaluation import matching
from app.ogc.filters import Filter
from app.ogc.work import BOXES, CONTENT, IDS, RESULT, SHAPES, TIMES
from app.results.newest import newest_results
from app.store.models import Drive, FeatureChunk, FeatureColumn, Job
from interloc.arrays import FloatArray
from interloc.output.geojson import encode

_OF_RESULT = [each.name for each in RESULT]
_AT_ONCE = BoundedSemaphore(2)  # a query over a million features takes a hundred megabytes while it runs

Interval = tuple[float, float]
"""First and last second since 1970; infinite where it is open."""


class Area(Box):
    """A box, and what longitudes it has."""

    @property
    def parts(self) -> list[tuple[float, float]]:
        """Its longitudes, as ranges among -180 to 540: what crosses the meridian lies beyond 180 degrees."""
        if self.west > self.east:
            return [(self.west, self.east + 360.0), (-180.0, self.east)]
        return [(self.west, self.east), (self.west + 360.0, self.east + 360.0)]


class Key(NamedTuple):
    """The place of a feature in the order of pages."""

    chunk: int
    row: int

    def __str__(self) -> str:
        """Return it as it stands in addresses."""
        return f"{self.chunk}.{self.row}"


@dataclass(frozen=True)
class Query:
    """What is asked for.

    Attributes
    ----------
    area : Area or None
    interval : tuple of float or None
    filter : Filter or None
    after : Key or None
        Where the page begins: with the feature after this one.
    limit : int
    """

    area: Area | None = None
    interval: Interval | None = None
    filter: Filter | None = None
    after: Key | None = None
    limit: int = 100


@dataclass(frozen=True)
class Page:
    """Some of the features that a query finds.

    Attributes
    ----------
    features : list of str
        GeoJSON.
    matched : int
        Number of all.
    next, previous : Key or None
        `Query.after` of the next page, and of the previous one.
    is_first : bool
    """

    features: list[str]
    matched: int
    next: Key | None
    previous: Key | None
    is_first: bool


@dataclass(frozen=True)
class Extent:
    """What a collection holds.

    Attributes
    ----------
    count : int
    box : tuple of float or None
        West, south, east, north.
    times : tuple of float or None
    attribution : str
    license : str or None
    """

    count: int
    box: tuple[float, ...] | None
    times: Interval | None
    attribution: str
    license: str | None


@dataclass(frozen=True)
class Source:
    """Whose features are given.

    Attributes
    ----------
    job : str or None
        Of this job; None: of the newest successful one of every drive.
    """

    job: str | None = None

    @property
    def collections(self) -> Mapping[str, Collection]:
        """The collections that there may be."""
        return OF_ALL if self.job is None else OF_JOB

    def feature_id(self, job: str, own: str) -> str:
        """Return the id of a feature: it is the same as long as there is the job."""
        return f"{job}.{own}" if self.job is None else own

    def split_id(self, feature: str) -> tuple[str, str]:
        """Return the job of a feature, and the id within its layer."""
        if self.job is not None:
            return self.job, feature
        job, _, own = feature.partition(".")
        return job, own

    def _jobs(self) -> Any:  # noqa: ANN401 - a subquery
        """Return the jobs and the names of their drives."""
        if self.job is not None:
            found = select(Job.id, Job.drive_id).where(Job.id == self.job)
        else:
            found = newest_results().with_only_columns(Job.id, Job.drive_id)
        return found.subquery()

    def chunks(self, *columns: Any) -> Select[Any]:  # noqa: ANN401 - of the tables below
        """Return the query for chunks, joined with their drives."""
        jobs = self._jobs()
        return (
            select(*columns)
            .select_from(jobs)
            .join(FeatureChunk, FeatureChunk.job_id == jobs.c.id)
            .join(Drive, Drive.id == jobs.c.drive_id)
        )


def extents(session: Session, source: Source) -> dict[str, Extent]:
    """Return what the collections of a source hold, by their ids; those of a job only as far as its result has them."""
    chunk = FeatureChunk
    found = {}
    rows = session.execute(
        source.chunks(
            chunk.layer,
            func.sum(chunk.count),
            func.min(chunk.west),
            func.min(chunk.south),
            func.max(chunk.east),
            func.max(chunk.north),
            func.min(chunk.first_time),
            func.max(chunk.last_time),
            func.min(chunk.attribution),
            func.max(chunk.attribution),
            func.max(chunk.license),
        ).group_by(chunk.layer)
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
        if source.job is None or each.layer.name in found
    }


def find_page(session: Session, source: Source, collection: Collection, query: Query) -> Page:
    """Return a page of the features that a query finds.

    Raises
    ------
    Problem
        400: the filter takes too long.
    """
    conditions = [FeatureChunk.layer == collection.layer.name, *_conditions(query)]
    candidates = _Candidates(session, source, collection, conditions)
    with _AT_ONCE:
        matched = candidates.matching(query)
    start = 0 if query.after is None else int(np.searchsorted(matched, candidates.place_after(query.after)))
    stop = min(start + query.limit, len(matched))
    page = matched[start:stop]
    previous = start - query.limit - 1
    return Page(
        features=list(candidates.features(page)),
        matched=len(matched),
        next=candidates.key_of(int(page[-1])) if stop < len(matched) and len(page) else None,
        previous=candidates.key_of(int(matched[previous])) if previous >= 0 else None,
        is_first=start == 0,
    )


def find_feature(session: Session, source: Source, collection: Collection, feature: str) -> str | None:
    """Return a feature by its id; None where there is none."""
    job, own = source.split_id(feature)
    conditions = [FeatureChunk.layer == collection.layer.name, FeatureChunk.job_id == job]
    candidates = _Candidates(session, source, collection, conditions)
    ids = candidates.texts(IDS)
    if own not in ids.values:
        return None
    (row,) = np.flatnonzero(ids.codes == ids.values.index(own))[:1].tolist()
    return next(candidates.features(np.array([row])))


def _conditions(query: Query) -> Iterator[ColumnElement[bool]]:
    """Yield conditions on chunks that hold where one of their features matches."""
    chunk = FeatureChunk
    areas = [] if query.area is None else [query.area]
    if query.filter is not None and query.filter.area is not None:
        areas.append(Area(*query.filter.area))
    for area in areas:
        yield and_(chunk.south <= area.north, chunk.north >= area.south)
        yield or_(*(and_(chunk.west <= east, chunk.east >= west) for west, east in area.parts))
    if query.interval is not None:
        yield and_(chunk.first_time <= query.interval[1], chunk.last_time >= query.interval[0])
    if query.filter is not None:
        names = {"drive": Drive.name, "job": FeatureChunk.job_id}
        yield from (names[name] == value for name, value in query.filter.equal.items() if name in names)


@dataclass
class _Candidates:
    """All features of the chunks that come into question, one after the other."""

    session: Session
    source: Source
    collection: Collection
    conditions: Sequence[ColumnElement[bool]]
    _known: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def chunks(self) -> list[Any]:
        """The chunks in their order, with the name of their drive."""
        chunk = FeatureChunk
        of_result = (Drive.name.label("drive"), chunk.job_id.label("job"), chunk.preset, chunk.labels)
        query = self.source.chunks(chunk.id, chunk.count, *of_result)
        query = query.where(*self.conditions, chunk.count > 0).order_by(chunk.id)
        return list(self.session.execute(query).all())

    @cached_property
    def ends(self) -> NDArray[np.int64]:
        """Where each chunk ends among the candidates."""
        return np.cumsum([each.count for each in self.chunks], dtype=np.int64)

    def __len__(self) -> int:
        return int(self.ends[-1]) if self.chunks else 0

    def place_after(self, key: Key) -> int:
        """Return the place of the first candidate after a key."""
        ids = np.array([each.id for each in self.chunks], dtype=np.int64)
        number = int(np.searchsorted(ids, key.chunk))
        if number == len(ids):
            return len(self)
        start = self.ends[number] - self.chunks[number].count
        return int(start + min(key.row + 1, self.chunks[number].count) if ids[number] == key.chunk else start)

    def key_of(self, place: int) -> Key:
        """Return the key of a candidate."""
        number = int(np.searchsorted(self.ends, place, side="right"))
        each = self.chunks[number]
        return Key(each.id, place - int(self.ends[number] - each.count))

    def matching(self, query: Query) -> NDArray[np.int64]:
        """Return the places of the candidates that match."""
        matches: NDArray[np.bool_] | None = None
        for mask in self._masks(query):
            matches = mask if matches is None else matches & mask
        return np.arange(len(self), dtype=np.int64) if matches is None else np.flatnonzero(matches)

    def _masks(self, query: Query) -> Iterator[NDArray[np.bool_]]:
        if query.area is not None:
            yield self._inside(query.area)
        if query.interval is not None:
            times = self.packed_numbers(TIMES, 2)
            yield (times[:, 0] <= query.interval[1]) & (times[:, 1] >= query.interval[0])
        if query.filter is not None:
            yield matching(query.filter, self)

    def _inside(self, area: Area) -> NDArray[np.bool_]:
        """Return which candidates an area touches."""
        boxes = self.boxes()
        touches = np.zeros(len(boxes), dtype=np.bool_)
        surely = np.zeros(len(boxes), dtype=np.bool_)
        for west, east in area.parts:
            touches |= (boxes[:, 0] <= east) & (boxes[:, 2] >= west)
            surely |= (boxes[:, 0] >= west) & (boxes[:, 2] <= east)
        touches &= (boxes[:, 1] <= area.north) & (boxes[:, 3] >= area.south)
        surely &= (boxes[:, 1] >= area.south) & (boxes[:, 3] <= area.north)
        doubtful = np.flatnonzero(touches & ~surely)
        if self.collection.is_point or not len(doubtful):
            return touches
        import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

        shapes = self.shapes(doubtful)
        meets = np.zeros(len(doubtful), dtype=np.bool_)
        for west, east in area.parts:
            meets |= shapely.intersects(shapes, shapely.box(west, area.south, east, area.north))
        touches[doubtful] = meets
        return touches

    # What filters ask for: `app.ogc.evaluation.Features`.

    def numbers(self, name: str) -> FloatArray:
        """Return a property that is a number, a flag or a time, NaN for null."""
        return self.packed_numbers(name, 1)[:, 0]

    def texts(self, name: str) -> Texts:
        """Return a property that is a text."""
        if name not in self._known:
            if name in _OF_RESULT:
                self._known[name] = self._repeated([getattr(each, name) for each in self.chunks])
            else:
                self._known[name] = unpack_texts(self._contents(name))
        texts: Texts = self._known[name]
        return texts

    def boxes(self) -> FloatArray:
        """Return west, south, east, north of each, (N, 4); NaN without geometry."""
        return self.packed_numbers(BOXES, 4)

    def shapes(self, places: NDArray[np.int64]) -> NDArray[np.object_]:
        """Return the geometries of some candidates."""
        import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

        if self.collection.is_point:
            return np.asarray(shapely.points(self.boxes()[places, :2]), dtype=object)
        numbers = np.searchsorted(self.ends, places, side="right")
        found = np.empty(len(places), dtype=object)
        used = np.unique(numbers)
        contents = self._contents(SHAPES, [self.chunks[number].id for number in used.tolist()])
        for number, content in zip(used.tolist(), contents, strict=True):
            count = self.chunks[number].count
            blobs = unpack_blobs(content, count)
            of_chunk = np.flatnonzero(numbers == number)
            rows = places[of_chunk] - (self.ends[number] - count)
            found[of_chunk] = shapely.from_wkb([blobs[row] or None for row in rows.tolist()])
        return found

    def packed_numbers(self, name: str, width: int) -> FloatArray:
        """Return a column of numbers, (N, width); NaN in chunks that have none."""
        if name not in self._known:
            contents = self._contents(name)
            if len(contents) < len(self.chunks):  # of times only
                known = dict(zip(self._ids_with(name), contents, strict=True))
                contents = [
                    known.get(each.id) or np.full((each.count, width), np.nan).tobytes() for each in self.chunks
                ]
            self._known[name] = unpack_numbers(contents).reshape(-1, width)
        numbers: FloatArray = self._known[name]
        return numbers

    def _repeated(self, values: list[str | None]) -> Texts:
        """Return a text that is the same for all features of a chunk."""
        known = {value: number for number, value in enumerate(dict.fromkeys(v for v in values if v is not None))}
        codes = np.array([-1 if value is None else known[value] for value in values], dtype=np.int32)
        return Texts(list(known), np.repeat(codes, np.array([each.count for each in self.chunks], dtype=np.int64)))

    def _contents(self, name: str, ids: list[int] | None = None) -> list[bytes]:
        column = FeatureColumn
        query = select(column.content).where(column.name == name, self._is_one_of(ids)).order_by(column.chunk_id)
        return list(self.session.scalars(query))

    def _ids_with(self, name: str) -> list[int]:
        column = FeatureColumn
        query = select(column.chunk_id).where(column.name == name, self._is_one_of(None)).order_by(column.chunk_id)
        return list(self.session.scalars(query))

    def _is_one_of(self, ids: list[int] | None) -> ColumnElement[bool]:
        """Return the condition that a column is of one of these chunks, by default of all candidates."""
        if ids is None:
            ids = [each.id for each in self.chunks]
        # Written into the query: databases take only some thousand parameters.
        return FeatureColumn.chunk_id.in_(bindparam("ids", ids, expanding=True, literal_execute=True))

    def features(self, places: NDArray[np.int64]) -> Iterator[str]:
        """Yield candidates as GeoJSON."""
        numbers = np.searchsorted(self.ends, places, side="right").tolist()
        used = sorted(set(numbers))
        ids = [self.chunks[number].id for number in used]
        lines = dict(
            zip(
                used,
                (zlib.decompress(each).decode().split("\n") for each in self._contents(CONTENT, ids)),
                strict=True,
            )
        )
        names = dict(zip(used, (unpack_texts([each]) for each in self._contents(IDS, ids)), strict=True))
        tails = {number: self._tail(number) for number in used}
        for number, place in zip(numbers, places.tolist(), strict=True):
            chunk = self.chunks[number]
            row = place - int(self.ends[number] - chunk.count)
            own = names[number].values[names[number].codes[row]]
            id_ = encode(self.source.feature_id(chunk.job, own))
            yield f'{{"type":"Feature","id":{id_},{lines[number][row][:-1]}{tails[number]}'

    def _tail(self, number: int) -> str:
        """Return the end of features of a chunk: what the index does not store with each."""
        each = self.chunks[number]
        properties = {name: getattr(each, name) for name in _OF_RESULT}
        return f",{encode(properties)[1:]}}}"
