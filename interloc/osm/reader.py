"""Reading the highways of an OSM file, in streaming passes: nodes, ways, nodes beyond the bounds, then buildings.

Of a map that is larger than the drive, only what lies around the drive is kept; the rest passes by.
"""

from __future__ import annotations

import logging
import os
import re
import tempfile
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.osm import untrusted
from interloc.osm.graph import (
    KEPT_TAGS,
    NO_BUILDINGS,
    NO_LOOSE_ENDS,
    Bounds,
    Buildings,
    RoadGraph,
    Ways,
    layer_of,
    within,
)
from interloc.wording import printable

logger = logging.getLogger(__name__)

MAX_NODES, MAX_WAYS = 10_000_000, 500_000
"""Of a map within bounds: several times a large city with all of its houses."""

MAX_NODES_WITH_BUILDINGS = 2_000_000
"""Buildings are read of extracts up to a large city: of a country they would take longer than all the rest."""

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_BATCH = 50_000
_ONE_PLACE_DEG = 1e-6


def read_osm(
    path: str | os.PathLike[str],
    bounds: Bounds | None = None,
    *,
    max_unpacked_bytes: int = untrusted.MAX_UNPACKED_BYTES,
) -> RoadGraph:
    """Read the highways of an OSM file.

    Parameters
    ----------
    path
        `.osm`, `.osm.gz`, `.osm.bz2` or `.osm.pbf`; the content decides, not the name.
    bounds
        West, south, east, north, degrees. Only ways with a node in them are kept; give them to cut the surroundings of
        a drive out of the map of a country. Without, all, but no buildings.
    max_unpacked_bytes
        Largest size that a compressed file may unpack to.

    Returns
    -------
    RoadGraph
        A way that refers to nodes which the file does not hold is cut into the pieces that exist; `loose_ends` keeps
        where it goes on. Its areas are those that the file declares; where ways were left out, what of them lies
        within `bounds`.

    Raises
    ------
    MapError
        The file is missing, damaged, not OSM, declares a DOCTYPE, holds no highway (within the bounds), or more within
        the bounds than any place on Earth.

    Notes
    -----
    Memory grows with the highways kept, and with the nodes within the bounds, not with the file. Nodes may stand before
    or after the ways, or their places in the ways. Of elements with the same id the highest version counts, also where
    it is no highway any more. Ways of the same version with other nodes are pieces of one road.
    """
    path = Path(path)
    prolog = untrusted.read_prolog(path, max_unpacked_bytes=max_unpacked_bytes)
    if not prolog.has_deleted:
        try:
            return _read(_OsmStream(path, path, prolog), bounds)
        except _OddValueError as odd:
            logger.info("%s: %s; read without it", path.name, odd)
    with tempfile.TemporaryDirectory(prefix="interloc-map-") as folder:
        plain = Path(folder) / "map.osm"
        untrusted.write_plain(path, prolog.container, plain)
        return _read(_OsmStream(path, plain, replace(prolog, container="osm")), bounds)


def _read(stream: _OsmStream, bounds: Bounds | None) -> RoadGraph:
    path, prolog = stream.path, stream.prolog
    nodes = stream.nodes(None if bounds is None else lambda _, lonlat: within(bounds, lonlat))
    found, left_out = _collect_ways(stream, bounds, nodes.id)
    if not found:
        if prolog.is_lanelet:
            raise untrusted.lanelet_map(path)
        if left_out and nodes.extent is None:
            raise untrusted.no_nodes(path, left_out)
        raise untrusted.no_highways(path, bounds, nodes.extent)
    nodes = nodes.with_others(_places_of(found))
    refs = np.fromiter(chain.from_iterable(way.refs for way in found), np.int64)
    wanted = np.unique(refs)
    if nodes.beyond:
        missing = wanted[~_is_in(wanted, nodes.id)]
        nodes = nodes.with_others(stream.nodes(lambda ids, _: _is_in(ids, missing)))
    used = _is_in(nodes.id, wanted)
    node_id, lonlat = nodes.id[used], nodes.lonlat[used]
    few = bounds is not None and len(nodes.id) + nodes.beyond <= MAX_NODES_WITH_BUILDINGS
    buildings = _buildings(stream, nodes) if few else NO_BUILDINGS
    edges, edge_way, loose_ends, clipped = _edges([len(way.refs) for way in found], refs, node_id)
    if len(edges) == 0:
        raise untrusted.no_nodes(path, len(found))
    if clipped:
        logger.info("%s: %d highways refer to nodes outside the extract and were cut", path.name, clipped)
    areas = _sensible(prolog.areas, nodes.extent or (*lonlat.min(axis=0).tolist(), *lonlat.max(axis=0).tolist()))
    latest = max(way.edited for way in found)
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
            layer=np.array([way.layer for way in found], dtype=np.int64),
            tags=tuple(way.tags for way in found),
        ),
        source=os.fsencode(path.name).decode(errors="replace"),
        date=prolog.date or (latest.strftime("%Y-%m-%dT%H:%M:%SZ") if latest > _EPOCH else None),
        areas=_common(areas, bounds) if bounds and left_out else areas,
        clipped_ways=clipped,
        loose_ends=loose_ends,
        is_made_up=prolog.is_made_up,
        buildings=buildings,
        warnings=untrusted.odd_bounds(path.name, len(prolog.areas) - len(areas))
        + untrusted.oddities(path.name, [way.id for way in found], edges, edge_way, nodes.elsewhere),
    )


def _sensible(areas: Sequence[Bounds], extent: Bounds) -> tuple[Bounds, ...]:
    """Return those of the declared boxes that reach into that of all nodes; others, and inverted ones, are mistakes."""

    def is_one(west: float, south: float, east: float, north: float) -> bool:
        across = west - east > 180.0  # the 180th meridian
        reaches = west <= min(east, extent[2]) and east >= extent[0]
        return (across or reaches) and south <= min(north, extent[3]) and north >= extent[1]

    return tuple(area for area in areas if is_one(*area))


def _common(declared: tuple[Bounds, ...], bounds: Bounds) -> tuple[Bounds, ...]:
    """Return what of the declared boxes lies within bounds; all of that where none is declared."""
    if not declared:
        return (bounds,)
    if bounds[0] > bounds[2] or any(west > east for west, _, east, _ in declared):
        return declared  # across the 180th meridian
    common = (
        (max(west, bounds[0]), max(south, bounds[1]), min(east, bounds[2]), min(north, bounds[3]))
        for west, south, east, north in declared
    )
    return tuple(area for area in common if area[0] < area[2] and area[1] < area[3]) or declared


@dataclass(frozen=True)
class _Nodes:
    """Nodes of a file."""

    id: IntArray
    """(N,) int64: ascending."""
    version: IntArray
    """(N,) int64."""
    lonlat: FloatArray
    """(N, 2) float64."""
    beyond: int
    """How many others the file holds."""
    extent: Bounds | None
    """Of all nodes of the file."""
    elsewhere: int
    """How many were left out that lie elsewhere under the same id and version."""

    @classmethod
    def of(cls, ids: IntArray, version: IntArray, lonlat: FloatArray, beyond: int, extent: Bounds | None) -> _Nodes:
        """Sort nodes; of those with the same id the highest version counts, of the same version the last."""
        order = np.lexsort((version, ids))
        ids = ids[order]
        is_again = (ids[1:] == ids[:-1]) & (version[order[1:]] == version[order[:-1]])
        has_moved = is_again & (np.abs(np.diff(lonlat[order], axis=0)).max(axis=1, initial=0.0) > _ONE_PLACE_DEG)
        last = order[np.flatnonzero(np.append(ids[1:] != ids[:-1], [True] * bool(len(ids))))]
        return cls(np.unique(ids), version[last], lonlat[last], beyond, extent, int(has_moved.sum()))

    def places(self, ids: Sequence[int]) -> FloatArray:
        """Return (n, 2) longitudes and latitudes of nodes, all of which are among these."""
        return self.lonlat[np.searchsorted(self.id, np.array(ids, dtype=np.int64))]

    def with_others(self, others: _Nodes) -> _Nodes:
        """Return these and others."""
        ids, version = np.concatenate([self.id, others.id]), np.concatenate([self.version, others.version])
        both = _Nodes.of(ids, version, np.concatenate([self.lonlat, others.lonlat]), self.beyond, self.extent)
        return replace(both, elsewhere=self.elsewhere)


@dataclass(frozen=True)
class _Way:
    id: int
    version: int
    highway: str
    name: str
    is_area: bool
    layer: int
    tags: dict[str, str]
    refs: array[int]
    places: FloatArray | None  # (n, 2) longitudes and latitudes, where the file holds them in the way
    edited: datetime


class _OddValueError(Exception):
    """libosmium stops at a value that no road depends on."""


@dataclass(frozen=True)
class _OsmStream:
    """Passes over one file; whatever libosmium objects to becomes a `MapError`."""

    path: Path
    """The map as its user knows it."""
    source: Path
    """What is read: the map, or a copy of it in a plainer form."""
    prolog: untrusted.Prolog

    def objects(self, kind: str, *filters: object) -> Iterator[Any]:
        import osmium  # noqa: PLC0415 - the server does without

        try:
            file = osmium.io.File(str(self.source), self.prolog.container)
            processor: Any = osmium.FileProcessor(file, getattr(osmium.osm, kind))
            for each in filters:
                processor = processor.with_filter(each)
            yield from processor
        except (RuntimeError, ValueError, osmium.InvalidLocationError) as error:
            raise self._error(str(error)) from error

    def _error(self, objection: str) -> Exception:
        """Return what an objection of libosmium means."""
        if self.source == self.path and self.prolog.container != "pbf" and re.search("timestamp|user id", objection):
            return _OddValueError(objection)
        return untrusted.lanelet_map(self.path) if self.prolog.is_lanelet else untrusted.not_read(self.path, objection)

    def highways(self) -> Iterator[_Way]:
        import osmium  # noqa: PLC0415

        for way in self.objects("WAY", osmium.filter.KeyFilter("highway")):
            refs = array("q", [node.ref for node in way.nodes])
            if len(refs) >= 2 and not way.deleted:
                tags = way.tags
                yield _Way(
                    id=way.id,
                    version=way.version,
                    highway=tags["highway"],
                    name=printable(tags.get("name") or tags.get("ref") or ""),
                    is_area=tags.get("area") == "yes",
                    layer=layer_of(tags),
                    tags={key: tags[key] for key in KEPT_TAGS if key in tags},
                    refs=refs,
                    places=_places(way) if any(node.location.valid() for node in way.nodes) else None,
                    edited=way.timestamp,
                )

    def replaced(self, version: Mapping[int, int]) -> set[int]:
        """Return those ids of highways of which the file holds a higher version, which is no highway any more."""
        found = set()
        for way in self.objects("WAY"):
            if way.id in version and way.version > version[way.id]:
                if way.deleted:
                    raise untrusted.history_file(self.path)
                found.add(way.id)
        return found

    def outlines(self) -> Iterator[tuple[int, array[int]]]:
        """Yield id and nodes of the ways that outline buildings."""
        import osmium  # noqa: PLC0415

        for way in self.objects("WAY", osmium.filter.KeyFilter("building")):
            refs = array("q", [node.ref for node in way.nodes])
            if len(refs) >= 4 and refs[0] == refs[-1] and not way.deleted and way.tags["building"] != "no":
                yield way.id, refs

    def nodes(self, keep: Callable[[IntArray, FloatArray], BoolArray] | None) -> _Nodes:
        """Return the nodes that are to be kept, judged by ids, longitudes and latitudes."""
        # Not by osmium's filter of ids: it takes 1.5 GB where ids are as high as today, however few they are.
        none = np.empty(0, dtype=np.int64)
        kept: list[tuple[IntArray, IntArray, FloatArray]] = [(none, none, np.empty((0, 2)))]
        count, total = 0, 0
        corners: list[FloatArray] = []
        places = ((node.id, node.version, node.location) for node in self.objects("NODE"))
        for batch in _batches(each for each in places if each[2].valid()):
            ids = np.fromiter((id_ for id_, _, _ in batch), np.int64, len(batch))
            version = np.fromiter((each for _, each, _ in batch), np.int64, len(batch))
            lonlat = np.array([(place.lon, place.lat) for _, _, place in batch])
            corners += [lonlat.min(axis=0), lonlat.max(axis=0)]
            total += len(ids)
            if keep is not None:
                mask = keep(ids, lonlat)
                ids, version, lonlat = ids[mask], version[mask], lonlat[mask]
            kept.append((ids, version, lonlat))
            count += len(ids)
            if keep is not None and count > MAX_NODES:
                raise untrusted.too_many(self.path, "nodes", MAX_NODES)
        extent = None
        if corners:
            (west, south), (east, north) = np.min(corners, axis=0).tolist(), np.max(corners, axis=0).tolist()
            extent = (west, south, east, north)
        ids, version, lonlat = (np.concatenate(each) for each in zip(*kept, strict=True))
        return _Nodes.of(ids, version, lonlat, total - count, extent)


def _batches(objects: Iterable[Any]) -> Iterator[list[Any]]:
    iterator = iter(objects)
    while batch := list(islice(iterator, _BATCH)):
        yield batch


def _places(way: Any) -> FloatArray:  # noqa: ANN401 - osmium has no types
    """Return (n, 2) longitudes and latitudes that a file holds in a way; NaN where one is missing."""
    places = (node.location for node in way.nodes)
    return np.array([(place.lon, place.lat) if place.valid() else (np.nan, np.nan) for place in places])


def _places_of(ways: Sequence[_Way]) -> _Nodes:
    """Return the nodes whose places stand in ways; a node of its own, of whichever version, comes before them."""
    placed = [way for way in ways if way.places is not None]
    ids = np.fromiter(chain.from_iterable(way.refs for way in placed), np.int64)
    lonlat = np.concatenate([np.empty((0, 2)), *(way.places for way in placed if way.places is not None)])
    known = np.isfinite(lonlat).all(axis=1)
    return _Nodes.of(ids[known], np.full(known.sum(), -1, dtype=np.int64), lonlat[known], 0, None)


def _collect_ways(stream: _OsmStream, bounds: Bounds | None, inside: IntArray) -> tuple[list[_Way], int]:
    """Return the highways with a node within bounds (ascending ids `inside`), and how many others there are."""
    found: dict[int, list[_Way]] = {}
    left_out = 0
    for batch in _batches(stream.highways()):
        near = batch
        if bounds is not None:
            refs = np.fromiter(chain.from_iterable(way.refs for way in batch), np.int64)
            first = np.cumsum([0, *(len(way.refs) for way in batch[:-1])])
            is_near = np.logical_or.reduceat(_is_in(refs, inside), first).tolist()
            near = [
                way
                for way, keep in zip(batch, is_near, strict=True)
                if keep or (way.places is not None and within(bounds, way.places).any())
            ]
        left_out += len(batch) - len(near)
        for way in near:
            known = found.setdefault(way.id, [way])
            if way.version > known[0].version:
                found[way.id] = [way]
            elif way.version == known[0].version and all(way.refs != piece.refs for piece in known):
                known.append(way)
        if bounds is not None and len(found) > MAX_WAYS:
            raise untrusted.too_many(stream.path, "highways", MAX_WAYS)
    replaced = stream.replaced({id_: pieces[0].version for id_, pieces in found.items()}) if found else set()
    return [way for id_, pieces in found.items() if id_ not in replaced for way in pieces], left_out


def _buildings(stream: _OsmStream, nodes: _Nodes) -> Buildings:
    """Return the closed ways that are buildings, of which all nodes are known."""
    found: dict[int, FloatArray] = {}
    for batch in _batches(stream.outlines()):
        refs = np.fromiter(chain.from_iterable(refs for _, refs in batch), np.int64)
        first = np.cumsum([0, *(len(refs) for _, refs in batch[:-1])])
        is_whole = np.logical_and.reduceat(_is_in(refs, nodes.id), first)
        for (way, ring), whole in zip(batch, is_whole.tolist(), strict=True):
            if whole:
                found.setdefault(way, nodes.places(ring))
    return Buildings(np.array([*found], dtype=np.int64), tuple(found.values()))


def _is_in(ids: IntArray, ascending: IntArray) -> BoolArray:
    """Return which ids are among others, which ascend."""
    if len(ascending) == 0:
        return np.zeros(len(ids), dtype=np.bool_)
    row = np.minimum(np.searchsorted(ascending, ids), len(ascending) - 1)
    found: BoolArray = ascending[row] == ids
    return found


def _edges(counts: list[int], flat: IntArray, node_id: IntArray) -> tuple[IntArray, IntArray, IntArray, int]:
    """Link consecutive nodes of each way where both exist, and keep loose ends where one does.

    Returns (E, 2) rows of nodes, (E,) ways, (L, 3) `RoadGraph.loose_ends`, and how many ways miss nodes.
    """
    if len(node_id) == 0:
        return np.empty((0, 2), dtype=np.int64), np.empty(0, dtype=np.int64), NO_LOOSE_ENDS, len(counts)
    way = np.repeat(np.arange(len(counts)), counts)
    row = np.searchsorted(node_id, flat)
    row[row == len(node_id)] = 0
    exists = node_id[row] == flat
    consecutive = way[:-1] == way[1:]
    linked = consecutive & exists[:-1] & exists[1:]
    edges = np.stack([row[:-1], row[1:]], axis=1)[linked]
    last = np.flatnonzero(consecutive & exists[:-1] & ~exists[1:])
    first = np.flatnonzero(consecutive & ~exists[:-1] & exists[1:]) + 1
    ends, beyond = np.concatenate([last, first]), np.concatenate([last + 1, first - 1])
    loose_ends = np.stack([row[ends], flat[beyond], way[ends]], axis=1).astype(np.int64)
    clipped = len(np.unique(way[~exists]))
    return edges.astype(np.int64), way[:-1][linked].astype(np.int64), loose_ends, clipped
