"""Features found in the index: of the result that stands for every drive, or of one job.

A query first takes the chunks that come into question by their boxes and times, some thousand rows for a million
features, then reads the columns that it needs of those, and decides for all their features at once. Only the features
of the page that is answered are read themselves.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Select, and_, func, literal, or_, select
from sqlalchemy.orm import Session

from app.http.parameters import Box
from app.jobs.chosen import chosen_results
from app.ogc.candidates import Candidates, Key
from app.ogc.collections import OF_ALL, OF_JOB, OF_MAP, Collection
from app.ogc.evaluation import Filter, matching
from app.ogc.work import IDS, TIMES
from app.store.models import Drive, FeatureChunk, Job

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


@dataclass(frozen=True)
class Query:
    """What is asked for."""

    area: Area | None = None
    interval: Interval | None = None
    filter: Filter | None = None
    after: Key | None = None
    """Where the page begins: with the feature after this one."""
    offset: int = 0
    """Or after so many, for clients that count by themselves."""
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
    previous: Key | None
    """The same of the previous one."""
    is_first: bool


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
    until: float | None = None
    """Among those that had ended then, seconds since 1970: so that all pages of a query are of the same jobs."""
    map: str | None = None

    @property
    def collections(self) -> Mapping[str, Collection]:
        """The collections that there may be."""
        return OF_MAP if self.map is not None else OF_ALL if self.job is None else OF_JOB

    @property
    def is_of_all(self) -> bool:
        """Whether its features are of all drives, and their ids begin with the job."""
        return self.job is None and self.map is None

    def feature_id(self, job: str, own: str) -> str:
        """Return the id of a feature: it is the same as long as there is the job."""
        return f"{job}.{own}" if self.is_of_all else own

    def split_id(self, feature: str) -> tuple[str, str]:
        """Return the job of a feature, and the id within its layer."""
        if not self.is_of_all:
            return self.job or "", feature
        job, _, own = feature.partition(".")
        return job, own

    def chunks(self, *columns: Any) -> Select[Any]:  # noqa: ANN401 - of the tables below
        """Return the query for chunks, joined with their drives."""
        if self.map is not None:
            return select(*columns).select_from(FeatureChunk).where(FeatureChunk.map_id == self.map)
        found = select(Job).where(Job.id == self.job) if self.job is not None else self._chosen()
        jobs = found.with_only_columns(Job.id, Job.drive_id).subquery()
        return (
            select(*columns)
            .select_from(jobs)
            .join(FeatureChunk, FeatureChunk.job_id == jobs.c.id)
            .join(Drive, Drive.id == jobs.c.drive_id)
        )

    def _chosen(self) -> Select[Job]:
        return chosen_results() if self.until is None else chosen_results(Job.finished_at <= self.until)

    def pinned(self, session: Session) -> Source:
        """Return the source of these jobs and no later ones."""
        if not self.is_of_all or self.until is not None:
            return self
        ends = chosen_results().with_only_columns(Job.finished_at).subquery()
        return Source(until=session.scalar(select(func.max(ends.c.finished_at))))


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
        if source.is_of_all or each.layer.name in found
    }


def find_page(session: Session, source: Source, collection: Collection, query: Query) -> Page:
    """Return a page of the features that a query finds.

    Raises
    ------
    Problem
        400: the filter takes too long.
    """
    candidates = _candidates(session, source, collection, *_conditions(query, source))
    masks = list(_masks(candidates, query))
    matched = np.flatnonzero(reduce(np.logical_and, masks)) if masks else np.arange(len(candidates))
    start = min(query.offset, len(matched))
    if query.after is not None:
        start = int(np.searchsorted(matched, candidates.place_after(query.after)))
    stop = min(start + query.limit, len(matched))
    page = matched[start:stop]
    previous = start - query.limit - 1
    return Page(
        features=list(candidates.features(page, source.feature_id)),
        matched=len(matched),
        next=candidates.key_of(int(page[-1])) if stop < len(matched) and len(page) else None,
        previous=candidates.key_of(int(matched[previous])) if previous >= 0 else None,
        is_first=start == 0,
    )


def find_feature(session: Session, source: Source, collection: Collection, feature: str) -> str | None:
    """Return a feature by its id; None where there is none."""
    job, own = source.split_id(feature)
    candidates = _candidates(session, source, collection, *([FeatureChunk.job_id == job] if job else []))
    ids = candidates.texts(IDS)
    if own not in ids.values:
        return None
    places = np.flatnonzero(ids.codes == ids.values.index(own))[:1]
    return next(candidates.features(places, source.feature_id))


def _candidates(
    session: Session, source: Source, collection: Collection, *conditions: ColumnElement[bool]
) -> Candidates:
    chunk = FeatureChunk
    drive = literal(None) if source.map is not None else Drive.name
    of_result = (drive.label("drive"), chunk.job_id.label("job"), chunk.preset, chunk.labels)
    query = source.chunks(chunk.id, chunk.count, *of_result).order_by(chunk.id)
    chunks = query.where(chunk.layer == collection.layer.name, chunk.count > 0, *conditions)
    return Candidates(session, session.execute(chunks).all(), collection.is_point, collection.of_results)


def _masks(candidates: Candidates, query: Query) -> Iterator[NDArray[np.bool_]]:
    """Yield for each part of a query which candidates it finds."""
    if query.area is not None:
        yield _inside(candidates, query.area)
    if query.interval is not None:
        times = candidates.packed_numbers(TIMES, 2)
        yield (times[:, 0] <= query.interval[1]) & (times[:, 1] >= query.interval[0])
    if query.filter is not None:
        yield matching(query.filter, candidates)


def _inside(candidates: Candidates, area: Area) -> NDArray[np.bool_]:
    """Return which candidates an area touches."""
    boxes = candidates.boxes()
    touches = np.zeros(len(boxes), dtype=np.bool_)
    surely = np.zeros(len(boxes), dtype=np.bool_)
    for west, east in area.parts:
        touches |= (boxes[:, 0] <= east) & (boxes[:, 2] >= west)
        surely |= (boxes[:, 0] >= west) & (boxes[:, 2] <= east)
    touches &= (boxes[:, 1] <= area.north) & (boxes[:, 3] >= area.south)
    surely &= (boxes[:, 1] >= area.south) & (boxes[:, 3] <= area.north)
    doubtful = np.flatnonzero(touches & ~surely)
    if len(doubtful) and not candidates.is_point:
        import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

        shapes = candidates.shapes(doubtful)
        parts = [shapely.box(west, area.south, east, area.north) for west, east in area.parts]
        touches[doubtful] = reduce(np.logical_or, (shapely.intersects(shapes, part) for part in parts))
    return touches


def _conditions(query: Query, source: Source) -> Iterator[ColumnElement[bool]]:
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
    if query.filter is not None and source.map is None:
        names = {"drive": Drive.name, "job": FeatureChunk.job_id}
        yield from (names[name] == value for name, value in query.filter.equal.items() if name in names)
