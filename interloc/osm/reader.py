"""Reading the highways of an OSM file, in streaming passes: nodes, ways, nodes beyond the bounds, then buildings.

Of a map that is larger than the drive, only what lies around the drive is kept; the rest passes by.
"""

from __future__ import annotations

import logging
import os
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import chain, islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.errors import MapError
from interloc.osm.container import MAX_UNPACKED_BYTES, read_prolog
from interloc.osm.graph import NO_BUILDINGS, Bounds, Buildings, RoadGraph, Ways, within
from interloc.osm.multipolygons import Multipolygon, holes_of, rings_of

logger = logging.getLogger(__name__)

MAX_NODES, MAX_WAYS = 10_000_000, 500_000
"""Of a map within bounds: several times a large city with all of its houses."""

MAX_NODES_WITH_BUILDINGS = 2_000_000
"""Buildings are read of extracts up to a large city: of a country they would take longer than all the rest."""

MAX_NODES_OF_RELATIONS = 2_000_000
"""Of all buildings that are relations, each node as often as it is used; what is more is not drawn."""

_Holes = tuple[FloatArray, ...]
_T = TypeVar("_T")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_BATCH = 50_000


def read_osm(
    path: str | os.PathLike[str], bounds: Bounds | None = None, *, max_unpacked_bytes: int = MAX_UNPACKED_BYTES
) -> RoadGraph:
    """Read the highways of an OSM file.

    Parameters
    ----------
    path
        `.osm`, `.osm.gz`, `.osm.bz2` or `.osm.pbf`; the content decides, not the name.
    bounds
        West, south, east, north, degrees. Only ways with a node in them are kept; give them to cut the surroundings of
        a drive out of the map of a country. Without, all.
    max_unpacked_bytes
        Largest size that a compressed file may unpack to.

    Returns
    -------
    RoadGraph
        A way that refers to nodes which the file does not hold is cut into the pieces that exist. Its bounds are those
        that the file declares; where ways were left out, what of them lies within `bounds`.

    Raises
    ------
    MapError
        The file is missing, damaged, not OSM, declares a DOCTYPE, holds no highway (within the bounds), or more within
        the bounds than any place on Earth.

    Notes
    -----
    Memory grows with the highways kept, and with the nodes within the bounds, not with the file. Nodes may stand before
    or after the ways. Of ways with the same id the first counts, of nodes the last.
    """
    path = Path(path)
    prolog = read_prolog(path, max_unpacked_bytes=max_unpacked_bytes)
    stream = _OsmStream(path, prolog.container)
    nodes = stream.nodes(None if bounds is None else lambda _, lonlat: within(bounds, lonlat))
    found, left_out = _collect_ways(stream, None if bounds is None else nodes.id)
    if not found:
        raise MapError(_no_highways(path, bounds, nodes))
    refs = np.fromiter(chain.from_iterable(way.refs for way in found), np.int64)
    wanted = np.unique(refs)
    if nodes.beyond:
        missing = wanted[~_is_in(wanted, nodes.id)]
        nodes = nodes.with_others(stream.nodes(lambda ids, _: _is_in(ids, missing)))
    used = _is_in(nodes.id, wanted)
    node_id, lonlat = nodes.id[used], nodes.lonlat[used]
    few = bounds is not None and len(nodes.id) + nodes.beyond <= MAX_NODES_WITH_BUILDINGS
    buildings = _buildings(stream, nodes) if few else NO_BUILDINGS
    edges, edge_way, clipped = _edges([len(way.refs) for way in found], refs, node_id)
    if len(edges) == 0:
        raise MapError(
            f"{path}: holds {len(found)} highways but none of their nodes. Usual cause: a query without the nodes "
            "of the ways; in Overpass QL add (._;>;); before out."
        )
    if clipped:
        logger.info("%s: %d highways refer to nodes outside the extract and were cut", path.name, clipped)
    return RoadGraph(
        node_id=node_id,
        lonlat=lonlat,
        edges=edges,
        edge_way=edge_way,
        ways=Ways(
            id=np.array([way.id for way in found], dtype=np.int64),
            highway=tuple(way.highway for way in found),
            name=tuple(way.name for way in found),
            is_area=np.array([way.is_area for way in found], dtype=np.bool_),
        ),
        source=path.name,
        date=prolog.date or _latest_edit(found),
        bounds=_common(prolog.bounds, bounds) if left_out else prolog.bounds,
        clipped_ways=clipped,
        is_made_up=prolog.is_made_up,
        buildings=buildings,
    )


def _no_highways(path: Path, bounds: Bounds | None, nodes: _Nodes) -> str:
    text = f"{path}: holds no highways"
    if bounds is not None:
        text += f" within {_area(bounds)}"
        if nodes.extent is not None:
            text += f"; it covers {_area(nodes.extent)}"
    return (
        f"{text}. Expected ways with a tag highway=*. Usual cause: an extract of another area, or of buildings or "
        "points only, or longitude and latitude swapped in geo.csv."
    )


def _area(bounds: Bounds) -> str:
    west, south, east, north = bounds
    return f"lon {west:.5f}..{east:.5f}, lat {south:.5f}..{north:.5f}"


def _common(declared: Bounds | None, bounds: Bounds | None) -> Bounds | None:
    """Return what lies in both of two bounds."""
    if declared is None or bounds is None:
        return declared or bounds
    west, south = max(declared[0], bounds[0]), max(declared[1], bounds[1])
    east, north = min(declared[2], bounds[2]), min(declared[3], bounds[3])
    return (west, south, east, north) if west < east and south < north else declared


@dataclass(frozen=True)
class _Nodes:
    """Nodes of a file.

    Attributes
    ----------
    id : (N,) int64
        Ascending.
    lonlat : (N, 2) float64
    beyond : int
        How many others the file holds.
    extent : Bounds or None
        Of all nodes of the file.
    """

    id: IntArray
    lonlat: FloatArray
    beyond: int
    extent: Bounds | None

    @classmethod
    def of(cls, ids: IntArray, lonlat: FloatArray, beyond: int, extent: Bounds | None) -> _Nodes:
        """Sort nodes; the last of those with the same id counts."""
        unique, last = np.unique(ids[::-1], return_index=True)
        return cls(unique, lonlat[::-1][last], beyond, extent)

    def places(self, ids: Sequence[int]) -> FloatArray:
        """Return (n, 2) longitudes and latitudes of nodes, all of which are among these."""
        return self.lonlat[np.searchsorted(self.id, np.array(ids, dtype=np.int64))]

    def with_others(self, others: _Nodes) -> _Nodes:
        """Return these and others."""
        ids = np.concatenate([self.id, others.id])
        return _Nodes.of(ids, np.concatenate([self.lonlat, others.lonlat]), self.beyond, self.extent)


@dataclass(frozen=True)
class _Way:
    id: int
    highway: str
    name: str
    is_area: bool
    refs: array[int]
    edited: datetime


@dataclass(frozen=True)
class _OsmStream:
    """Passes over one file; whatever libosmium objects to becomes a `MapError`."""

    path: Path
    container: str

    def objects(self, kind: str, *filters: object) -> Iterator[Any]:
        import osmium  # noqa: PLC0415 - slow to import, needed by few commands

        try:
            file = osmium.io.File(str(self.path), self.container)
            processor: Any = osmium.FileProcessor(file, getattr(osmium.osm, kind))
            for each in filters:
                processor = processor.with_filter(each)
            yield from processor
        except (RuntimeError, ValueError, osmium.InvalidLocationError) as error:
            raise MapError(
                f"{self.path}: is damaged ({error}). Usual cause: a download or copy that was cut off; fetch it again."
            ) from error

    def highways(self) -> Iterator[_Way]:
        import osmium  # noqa: PLC0415

        for way in self.objects("WAY", osmium.filter.KeyFilter("highway")):
            refs = array("q", [node.ref for node in way.nodes])
            if len(refs) >= 2 and not way.deleted:
                tags = way.tags
                name = tags.get("name") or tags.get("ref") or ""
                yield _Way(way.id, tags["highway"], name, tags.get("area") == "yes", refs, way.timestamp)

    def outlines(self) -> Iterator[tuple[int, array[int]]]:
        """Yield id and nodes of the ways that outline buildings."""
        import osmium  # noqa: PLC0415

        for way in self.objects("WAY", osmium.filter.KeyFilter("building")):
            refs = array("q", [node.ref for node in way.nodes])
            if len(refs) >= 4 and refs[0] == refs[-1] and not way.deleted and way.tags["building"] != "no":
                yield way.id, refs

    def multipolygons(self) -> Iterator[Multipolygon]:
        """Yield the relations that are buildings."""
        import osmium  # noqa: PLC0415

        for relation in self.objects("RELATION", osmium.filter.KeyFilter("building")):
            tags = relation.tags
            if relation.deleted or tags["building"] == "no" or tags.get("type") != "multipolygon":
                continue
            members = ((each.ref, each.role) for each in relation.members if each.type == "w")
            found = Multipolygon.of(relation.id, members)
            if found is not None:
                yield found

    def ways(self, wanted: set[int]) -> Iterator[tuple[int, array[int]]]:
        """Yield id and nodes of some ways."""
        for way in self.objects("WAY"):
            if way.id in wanted and len(way.nodes) >= 2 and not way.deleted:
                yield way.id, array("q", [node.ref for node in way.nodes])

    def nodes(self, keep: Callable[[IntArray, FloatArray], BoolArray] | None) -> _Nodes:
        """Return the nodes that are to be kept, judged by ids, longitudes and latitudes."""
        # Not by osmium's filter of ids: it takes 1.5 GB where ids are as high as today, however few they are.
        kept: list[tuple[IntArray, FloatArray]] = [(np.empty(0, dtype=np.int64), np.empty((0, 2)))]
        count, total = 0, 0
        corners: list[FloatArray] = []
        places = ((node.id, node.location) for node in self.objects("NODE"))
        for batch in _batches((id_, place) for id_, place in places if place.valid()):
            ids = np.fromiter((id_ for id_, _ in batch), np.int64, len(batch))
            lonlat = np.array([(place.lon, place.lat) for _, place in batch])
            corners += [lonlat.min(axis=0), lonlat.max(axis=0)]
            total += len(ids)
            if keep is not None:
                mask = keep(ids, lonlat)
                ids, lonlat = ids[mask], lonlat[mask]
            kept.append((ids, lonlat))
            count += len(ids)
            if keep is not None and count > MAX_NODES:
                raise MapError(_too_many(self.path, "nodes", MAX_NODES))
        extent = None
        if corners:
            (west, south), (east, north) = np.min(corners, axis=0).tolist(), np.max(corners, axis=0).tolist()
            extent = (west, south, east, north)
        ids, lonlat = (np.concatenate(each) for each in zip(*kept, strict=True))
        return _Nodes.of(ids, lonlat, total - count, extent)


def _too_many(path: Path, what: str, most: int) -> str:
    return (
        f"{path}: holds more than {most:,} {what} around the drive, which no place on Earth has. "
        "Usual cause: several maps in one file, or a file that was made by a program."
    )


def _batches(objects: Iterable[Any]) -> Iterator[list[Any]]:
    iterator = iter(objects)
    while batch := list(islice(iterator, _BATCH)):
        yield batch


def _collect_ways(stream: _OsmStream, inside: IntArray | None) -> tuple[list[_Way], int]:
    """Return the highways with a node among the ids inside, and how many others there are."""
    found: dict[int, _Way] = {}
    left_out = 0
    for batch in _batches(stream.highways()):
        near = batch
        if inside is not None:
            refs = np.fromiter(chain.from_iterable(way.refs for way in batch), np.int64)
            first = np.cumsum([0, *(len(way.refs) for way in batch[:-1])])
            is_near = np.logical_or.reduceat(_is_in(refs, inside), first)
            near = [way for way, keep in zip(batch, is_near.tolist(), strict=True) if keep]
        left_out += len(batch) - len(near)
        for way in near:
            found.setdefault(way.id, way)
        if inside is not None and len(found) > MAX_WAYS:
            raise MapError(_too_many(stream.path, "highways", MAX_WAYS))
    return list(found.values()), left_out


def _buildings(stream: _OsmStream, nodes: _Nodes) -> Buildings:
    """Return the buildings of which all nodes are known."""
    areas, covered = _areas(stream, nodes)
    ways = {way: ring for way, ring in _outlines(stream, nodes).items() if way not in covered}
    return Buildings(
        np.array([*ways, *(relation for relation, _, _ in areas)], dtype=np.int64),
        np.arange(len(ways) + len(areas)) >= len(ways),
        (*ways.values(), *(outline for _, outline, _ in areas)),
        (*[()] * len(ways), *(holes for _, _, holes in areas)),
    )


def _outlines(stream: _OsmStream, nodes: _Nodes) -> dict[int, FloatArray]:
    """Return the closed ways that are buildings, by id."""
    found: dict[int, FloatArray] = {}
    for batch in _batches(stream.outlines()):
        refs = np.fromiter(chain.from_iterable(refs for _, refs in batch), np.int64)
        first = np.cumsum([0, *(len(refs) for _, refs in batch[:-1])])
        is_whole = np.logical_and.reduceat(_is_in(refs, nodes.id), first)
        for (way, ring), whole in zip(batch, is_whole.tolist(), strict=True):
            if whole:
                found.setdefault(way, nodes.places(ring))
    return found


def _areas(stream: _OsmStream, nodes: _Nodes) -> tuple[list[tuple[int, FloatArray, _Holes]], set[int]]:
    """Return id, outline and holes of the relations that are buildings, and the ways of their outlines."""
    relations = _within_limit(stream.multipolygons(), lambda each: len(each.ways))
    wanted = {way for each in relations for way in each.ways}
    ways = _within_limit(stream.ways(wanted), lambda each: len(each[1])) if wanted else []
    refs = {way: ring for way, ring in ways if _is_in(np.array(ring, dtype=np.int64), nodes.id).all()}
    whole = [each for each in relations if all(way in refs for way in each.ways)]  # else the map is cut within it
    areas: list[tuple[int, FloatArray, _Holes]] = []
    covered: set[int] = set()
    for each in _within_limit(whole, lambda each: sum(len(refs[way]) for way in each.ways)):
        outer, inner = (
            [nodes.places(ring) for ring in rings_of([refs[way] for way in part])] for part in (each.outer, each.inner)
        )
        areas += [(each.id, outline, holes) for outline, holes in zip(outer, holes_of(outer, inner), strict=True)]
        covered.update(each.outer if outer else ())
    return areas, covered


def _within_limit(items: Iterable[_T], size: Callable[[_T], int]) -> list[_T]:
    """Return as many items as hold together `MAX_NODES_OF_RELATIONS`."""
    kept = []
    left = MAX_NODES_OF_RELATIONS
    for item in items:
        left -= size(item)
        if left < 0:
            break
        kept.append(item)
    return kept


def _latest_edit(ways: list[_Way]) -> str | None:
    latest = max(way.edited for way in ways)
    return latest.strftime("%Y-%m-%dT%H:%M:%SZ") if latest > _EPOCH else None


def _is_in(ids: IntArray, ascending: IntArray) -> BoolArray:
    """Return which ids are among others, which ascend."""
    if len(ascending) == 0:
        return np.zeros(len(ids), dtype=np.bool_)
    row = np.minimum(np.searchsorted(ascending, ids), len(ascending) - 1)
    found: BoolArray = ascending[row] == ids
    return found


def _edges(counts: list[int], flat: IntArray, node_id: IntArray) -> tuple[IntArray, IntArray, int]:
    """Link consecutive nodes of each way where both exist; also count the ways that miss some."""
    if len(node_id) == 0:
        return np.empty((0, 2), dtype=np.int64), np.empty(0, dtype=np.int64), len(counts)
    way = np.repeat(np.arange(len(counts)), counts)
    row = np.searchsorted(node_id, flat)
    row[row == len(node_id)] = 0
    exists = node_id[row] == flat
    linked = (way[:-1] == way[1:]) & exists[:-1] & exists[1:]
    edges = np.stack([row[:-1], row[1:]], axis=1)[linked]
    clipped = len(np.unique(way[~exists]))
    return edges.astype(np.int64), way[:-1][linked].astype(np.int64), clipped
