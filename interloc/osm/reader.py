"""Reading the highways of an OSM file, in two streaming passes: ways first, then the nodes that they need."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.errors import MapError
from interloc.osm.container import MAX_UNPACKED_BYTES, read_prolog
from interloc.osm.graph import Bounds, RoadGraph, Ways

logger = logging.getLogger(__name__)

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def read_osm(
    path: str | Path, bounds: Bounds | None = None, *, max_unpacked_bytes: int = MAX_UNPACKED_BYTES
) -> RoadGraph:
    """Read the highways of an OSM file.

    Parameters
    ----------
    path
        `.osm`, `.osm.gz`, `.osm.bz2` or `.osm.pbf`; the content decides, not the name.
    bounds
        West, south, east, north, degrees. Only ways with a node in them are kept, and only junctions in them count;
        give them to cut a drive out of the map of a country. Without, what the file declares.
    max_unpacked_bytes
        Largest size that a compressed file may unpack to.

    Returns
    -------
    RoadGraph
        A way that refers to nodes which the file does not hold is cut into the pieces that exist.

    Raises
    ------
    MapError
        The file is missing, damaged, not OSM, declares a DOCTYPE, or holds no highway (within the bounds).

    Notes
    -----
    Memory grows with the highways kept, not with the file. Nodes may stand before or after the ways.
    """
    path = Path(path)
    prolog = read_prolog(path, max_unpacked_bytes=max_unpacked_bytes)
    stream = _OsmStream(path, prolog.container)
    inside = None if bounds is None else stream.node_ids_within(bounds)
    found = _collect_ways(stream, inside)
    if not found.id:
        where = (
            ""
            if bounds is None
            else f" within lon {bounds[0]:.5f}..{bounds[2]:.5f}, lat {bounds[1]:.5f}..{bounds[3]:.5f}"
        )
        raise MapError(
            f"{path}: holds no highways{where}. Expected ways with a tag highway=*. "
            "Usual cause: an extract of another area, or of buildings or points only."
        )
    refs = np.concatenate(found.refs)
    node_id, lonlat = stream.nodes(np.unique(refs))
    edges, edge_way, clipped = _edges(found.refs, refs, node_id)
    if len(edges) == 0:
        raise MapError(
            f"{path}: holds {len(found.id)} highways but none of their nodes. Usual cause: a query without the nodes "
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
            id=np.array(found.id, dtype=np.int64),
            highway=tuple(found.highway),
            name=tuple(found.name),
            is_area=np.array(found.is_area, dtype=np.bool_),
        ),
        source=path.name,
        date=prolog.date or found.latest_edit,
        bounds=bounds if bounds is not None else prolog.bounds,
        clipped_ways=clipped,
    )


@dataclass
class _FoundWays:
    id: list[int] = field(default_factory=list)
    highway: list[str] = field(default_factory=list)
    name: list[str] = field(default_factory=list)
    is_area: list[bool] = field(default_factory=list)
    refs: list[IntArray] = field(default_factory=list)
    latest_edit: str | None = None


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

    def highways(self) -> Iterator[Any]:
        import osmium  # noqa: PLC0415

        return self.objects("WAY", osmium.filter.KeyFilter("highway"))

    def node_ids_within(self, bounds: Bounds) -> set[int]:
        west, south, east, north = bounds
        return {
            node.id
            for node in self.objects("NODE")
            if node.location.valid() and west <= node.location.lon <= east and south <= node.location.lat <= north
        }

    def nodes(self, wanted: IntArray) -> tuple[IntArray, FloatArray]:
        """Return ids, ascending, and lon/lat of those of the wanted nodes that the file holds."""
        import osmium  # noqa: PLC0415

        # The id filter is fast but knows no negative ids, which editors give to what was never uploaded.
        filters = (osmium.filter.IdFilter(wanted.tolist()),) if wanted[0] >= 0 else ()
        ids = frozenset(wanted.tolist())
        place: dict[int, tuple[float, float]] = {}
        for node in self.objects("NODE", *filters):
            if node.id in ids and node.location.valid():
                place[node.id] = (node.location.lon, node.location.lat)
        node_id = np.array(sorted(place), dtype=np.int64)
        lonlat = np.array([place[i] for i in node_id.tolist()], dtype=np.float64).reshape(-1, 2)
        return node_id, lonlat


def _collect_ways(stream: _OsmStream, inside: set[int] | None) -> _FoundWays:
    found = _FoundWays()
    latest = _EPOCH
    for way in stream.highways():
        refs = [node.ref for node in way.nodes]
        if len(refs) < 2 or way.deleted or (inside is not None and inside.isdisjoint(refs)):
            continue
        found.id.append(way.id)
        found.highway.append(way.tags["highway"])
        found.name.append(way.tags.get("name") or way.tags.get("ref") or "")
        found.is_area.append(way.tags.get("area") == "yes")
        found.refs.append(np.array(refs, dtype=np.int64))
        latest = max(latest, way.timestamp)
    if latest > _EPOCH:
        found.latest_edit = latest.strftime("%Y-%m-%dT%H:%M:%SZ")
    return found


def _edges(refs: list[IntArray], flat: IntArray, node_id: IntArray) -> tuple[IntArray, IntArray, int]:
    """Link consecutive nodes of each way where both exist; also count the ways that miss some."""
    if len(node_id) == 0:
        return np.empty((0, 2), dtype=np.int64), np.empty(0, dtype=np.int64), len(refs)
    way = np.repeat(np.arange(len(refs)), [len(r) for r in refs])
    row = np.searchsorted(node_id, flat)
    row[row == len(node_id)] = 0
    exists = node_id[row] == flat
    linked = (way[:-1] == way[1:]) & exists[:-1] & exists[1:]
    edges = np.stack([row[:-1], row[1:]], axis=1)[linked]
    clipped = len(np.unique(way[~exists]))
    return edges.astype(np.int64), way[:-1][linked].astype(np.int64), clipped
