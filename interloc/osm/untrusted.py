"""Which kind of OSM file this is, from its first bytes and its XML prolog, before it is given to a parser.

A map may be an upload of anybody: this module refuses what is not a map, names the usual mistakes, and limits what a
small compressed file may unpack to.
"""

import bz2
import gzip
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, BinaryIO, Literal, cast
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np

from interloc.arrays import IntArray
from interloc.errors import MapError
from interloc.osm.graph import Bounds

# What a map that cannot be used, or hardly, usually is: errors and warnings in words.

_SEPARATE_STREETS = 5
"""So many streets and no common node among them is no chance."""

_OBJECTIONS = {
    "version attribute": "<osm> declares no version. Expected version 0.6; usual cause: a file that a program wrote",
    "with version": "the file is of an old version of the format. Expected version 0.6",
    "coordinate": "a coordinate is not in decimal degrees. Usual cause: commas for points, or a map in metres",
    "illegal id": "an id is not a whole number. Usual cause: a file that a program wrote",
    "element in <way>: center": "Overpass wrote it by `out center`. Expected `out body` or `out geom`",
    "nested too deep": "this is not the plain form of OSM XML. Usual cause: an augmented diff",
}
"""What libosmium says -> what it means."""


def not_read(path: Path, objection: str) -> MapError:
    """Return the error about a file at which libosmium stopped."""
    for words, meaning in _OBJECTIONS.items():
        if words in objection:
            return MapError(f"{path}: {meaning} ({objection}).")
    return MapError(
        f"{path}: is damaged ({objection}). Usual cause: a download or copy that was cut off; fetch it again."
    )


def history_file(path: Path) -> MapError:
    """Return the error about a file that holds every version of each object."""
    return MapError(
        f"{path}: is a full history file, with every version of each object. Expected a map of one day; make one of it "
        f"by: osmium time-filter {path.name} -o map.osm.pbf"
    )


def lanelet_map(path: Path) -> MapError:
    """Return the error about a map for automated driving, which is handed over for one of OpenStreetMap."""
    return MapError(
        f"{path}: is a Lanelet2 map, which has the form of OpenStreetMap and holds lanes, no streets. Expected an "
        "extract of OpenStreetMap of the same place, with highway=*."
    )


def no_nodes(path: Path, highways: int) -> MapError:
    """Return the error about a file of ways without places."""
    return MapError(
        f"{path}: holds {highways} highways but none of their nodes. Usual cause: a query without the nodes of the "
        "ways; in Overpass QL add (._;>;); before out."
    )


def no_highways(path: Path, bounds: Bounds | None, extent: Bounds | None) -> MapError:
    """Return the error about a map without highways within bounds; `extent`: of all its nodes."""
    text = f"{path}: holds no highways"
    if bounds is not None:
        text += f" within {_area(bounds)}"
        if extent is not None:
            text += f"; it covers {_area(extent)}"
    return MapError(
        f"{text}. Expected ways with a tag highway=*. Usual cause: an extract of another area, or of buildings or "
        "points only, longitude and latitude swapped in geo.csv, or a query with out skel, ids or tags (take out body)."
    )


def too_many(path: Path, what: str, maximum: int) -> MapError:
    """Return the error about a file that holds more than any place on Earth."""
    return MapError(
        f"{path}: holds more than {maximum:,} {what} around the drive, which no place on Earth has. "
        "Usual cause: several maps in one file, or a file that was made by a program."
    )


def odd_bounds(name: str, count: int) -> tuple[str, ...]:
    """Say that declared boxes were left out, which hold nothing of the map or are inverted."""
    if not count:
        return ()
    text = (
        f"{name} declares bounds that hold none of its nodes, or are inverted: they were left out, and what it covers "
        "was told from its highways. Usual cause: a program that wrote 0 0 0 0, or the corners in another order."
    )
    return (text,)


def oddities(name: str, way_id: Sequence[int], edges: IntArray, edge_way: IntArray, elsewhere: int) -> tuple[str, ...]:
    """Say what is odd about the highways of a map, by (W,) ids of ways, and (E, 2) nodes and (E,) ways of edges.

    `elsewhere` counts nodes that lie elsewhere under the id and version of another.
    """
    warnings = []
    if elsewhere:
        warnings.append(
            f"{name} has {elsewhere} nodes at two places under one id and version: the last was taken, and roads may "
            "lie wrong. Usual cause: files joined whose new objects begin at -1 each (`osmium renumber` them), or "
            "maps of two days without versions."
        )
    ids, row = np.unique(way_id, return_inverse=True)
    if len(ids) < len(way_id):
        warnings.append(
            f"{name} holds {len(way_id) - len(ids)} highways under ids that others of the same version have, too: all "
            "were taken, as pieces of one road. Usual cause: an export by osmnx 0.x, or maps of two days joined "
            "without versions."
        )
    visits = np.unique(np.column_stack([edges.ravel(), np.repeat(row[edge_way], 2)]), axis=0)
    if len(ids) >= _SEPARATE_STREETS and len(np.unique(visits[:, 0])) == len(visits):
        warnings.append(
            f"None of the {len(ids)} highways of {name} has a node in common with another: it holds no junction, and "
            "nothing can be right. Usual cause: a map made from shapefiles or by ogr2osm, which gives each street "
            "nodes of its own; take an extract of OpenStreetMap."
        )
    return tuple(warnings)


def _area(bounds: Bounds) -> str:
    west, south, east, north = bounds
    return f"lon {west:.5f}..{east:.5f}, lat {south:.5f}..{north:.5f}"


Container = Literal["osm", "osm.gz", "osm.bz2", "pbf"]

MAP_ENDINGS = (".osm", ".osm.gz", ".osm.bz2", ".osm.pbf")
"""Endings of OpenStreetMap files; upper and lower case are the same."""

MAX_UNPACKED_BYTES = 16 * 1024**3
"""Larger maps are for .osm.pbf, whose blocks are bounded by the format."""

SIMULATOR = "interloc simulate"
"""Name of the program in the head of maps that the simulator made up."""

_PACKED = {
    b"\xff\xe0\x04o5m2": ("an .o5m file", "convert it: osmium cat MAP.o5m -o MAP.osm.pbf"),
    b"\xfd7zXZ\x00": ("compressed by xz", "unpack it first: unxz MAP.osm.xz"),
    b"\x28\xb5\x2f\xfd": ("compressed by zstd", "unpack it first: unzstd MAP.osm.zst"),
    b"7z\xbc\xaf\x27\x1c": ("a 7z archive", "unpack the archive first"),
    b"PK\x03\x04": ("a ZIP archive", "unpack the archive first"),
    b"SQLite format 3\x00": ("a GeoPackage or another database", "take the extract that it was made of"),
    b"PMTiles": ("tiles to be drawn (PMTiles)", "take an extract: tiles hold no nodes"),
    b"PAR1": ("a table (Parquet)", "take an extract: tables hold lines without common nodes"),
    b"fgb\x03": ("a FlatGeobuf", "take an extract: it holds lines without common nodes"),
}
_OTHER_ROOTS = {
    "graphml": "a graph (GraphML), as osmnx.save_graphml writes it: use save_graph_xml, or take an extract",
    "kml": "KML, which holds lines without common nodes: take an extract of OpenStreetMap",
    "gpx": "a track (GPX): take an extract of OpenStreetMap around it",
    "OpenDRIVE": "OpenDRIVE, a map of lanes: take an extract of OpenStreetMap of the same place",
    "net": "a network of SUMO: take the extract of OpenStreetMap that it was made of",
}
_CHECKSUM = re.compile(rb"[0-9a-fA-F]{32,128}\s")
_REMARK = re.compile(rb"<remark>\s*(runtime error[^<]*?)\s*</remark>")
_TAIL_BYTES = 4096
_BLOCK_BYTES = 1 << 20
_OBJECTS = {"node", "way", "relation"}


def is_map(path: str) -> bool:
    """Return whether a file is an OpenStreetMap file by its name."""
    return path.lower().endswith(MAP_ENDINGS)


@dataclass(frozen=True)
class Prolog:
    """What stands before the first object of an OSM file."""

    container: Container
    date: str | None
    """Declared state of the data, ISO 8601."""
    areas: tuple[Bounds, ...]
    """Declared boxes; several where a file was put together."""
    is_made_up: bool = False
    """Whether the map says that the simulator made it up."""
    has_deleted: bool = False
    """Whether an editor has marked objects as deleted that are still in the file."""
    is_lanelet: bool = False
    """Whether the file looks like a map of lanes (Lanelet2), which has the form of OSM and other content."""


def read_prolog(path: Path, *, max_unpacked_bytes: int = MAX_UNPACKED_BYTES) -> Prolog:
    """Return which kind of OSM file this is, and check that it can be given to a parser; a MapError says why not.

    It may be missing, empty, damaged, no OSM, a file of the whole history, an answer that Overpass gave up on, declare
    a DOCTYPE or entities, or unpack to too much.
    """
    if ".osh" in path.name.lower():
        raise history_file(path)
    container = _container_of(path)
    if container == "pbf":
        return _pbf_prolog(path)
    try:
        with open_unpacked(path, container) as stream:
            prolog = _scan_xml(path, stream, container, max_unpacked_bytes)
    except EOFError as error:
        raise MapError(
            f"{path}: the compressed data ends early. Usual cause: a download or copy that was cut off; fetch it again."
        ) from error
    except (zlib.error, OSError) as error:
        raise MapError(f"{path}: cannot be read ({error}).") from error
    return prolog


def _container_of(path: Path) -> Container:
    """Return the container, judged by the content: names are often wrong after a download."""
    if path.is_dir():
        raise MapError(f"{path}: is a folder. Expected an OSM file: .osm, .osm.gz, .osm.bz2 or .osm.pbf.")
    try:
        with path.open("rb") as file:
            head = file.read(64)
    except FileNotFoundError as error:
        raise MapError(f"{path}: no such file. Expected an OSM file: .osm, .osm.gz, .osm.bz2 or .osm.pbf.") from error
    except OSError as error:
        raise MapError(f"{path}: cannot be read ({error.strerror}).") from error
    if not head:
        raise MapError(f"{path}: is empty. Usual cause: a download that failed; fetch it again.")
    if head.startswith(b"\x1f\x8b"):
        return "osm.gz"
    if head.startswith(b"BZh"):
        return "osm.bz2"
    if b"OSMHeader" in head[:32]:
        return "pbf"
    for start, (what, way_out) in _PACKED.items():
        if head.startswith(start):
            raise MapError(f"{path}: is {what}. Expected .osm, .osm.gz, .osm.bz2 or .osm.pbf: {way_out}.")
    return "osm"


def open_unpacked(path: Path, container: Container) -> BinaryIO:
    """Open the XML of an OSM file."""
    if container == "osm.gz":
        return cast("BinaryIO", gzip.open(path, "rb"))
    if container == "osm.bz2":
        return cast("BinaryIO", bz2.open(path, "rb"))
    return path.open("rb")


def _pbf_prolog(path: Path) -> Prolog:
    import osmium  # noqa: PLC0415 - the server does without

    try:
        header = osmium.io.Reader(osmium.io.File(str(path), "pbf")).header()
    except RuntimeError as error:
        raise MapError(f"{path}: is a damaged .osm.pbf file ({error}).") from error
    if header.has_multiple_object_versions:
        raise history_file(path)
    box = header.box()
    areas: tuple[Bounds, ...] = ()
    if box.valid():
        areas = ((box.bottom_left.lon, box.bottom_left.lat, box.top_right.lon, box.top_right.lat),)
    date = header.get("osmosis_replication_timestamp") or header.get("timestamp")
    return Prolog("pbf", date or None, areas, header.get("generator") == SIMULATOR)


def _scan_xml(path: Path, stream: BinaryIO, container: Container, max_unpacked_bytes: int) -> Prolog:
    scanner = _PrologScanner(path)
    unpacked = 0
    has_deleted = is_lanelet = False
    tail = b""
    while block := stream.read(_BLOCK_BYTES):
        unpacked += len(block)
        if unpacked > max_unpacked_bytes:
            raise MapError(
                f"{path}: unpacks to more than {max_unpacked_bytes / 1e9:.1f} GB. "
                "Cut the map to the area of the drive (osmium extract), or give it as .osm.pbf."
            )
        # A parser holds a whole tag in memory, so a tag without end is the one thing that streaming does not bound.
        if len(block) == _BLOCK_BYTES and b">" not in block:
            raise MapError(f"{path}: holds a tag longer than {_BLOCK_BYTES:,} bytes; this is not an OSM file.")
        if not scanner.finished:
            scanner.feed(block)
        text = tail + block
        has_deleted = has_deleted or b"action='delete'" in text or b'action="delete"' in text
        is_lanelet = is_lanelet or b'"lanelet"' in text or b"'lanelet'" in text or b"<MetaInfo" in text
        tail = text[-_TAIL_BYTES:]
    if unpacked == 0:
        raise MapError(f"{path}: holds nothing once unpacked. Usual cause: an export that failed.")
    scanner.close()
    if remark := _REMARK.search(tail):
        reason = " ".join(remark[1].decode(errors="replace").split())
        raise MapError(
            f"{path}: Overpass gave up on this query ({reason}), so a part of the roads is missing. Ask for a smaller "
            "area, or for more time: [timeout:180]."
        )
    return Prolog(container, scanner.date, tuple(scanner.areas), scanner.is_made_up, has_deleted, is_lanelet)


class _PrologScanner:
    """Feeds expat up to the first object of the map and remembers what the head declared."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.finished = False
        self.date: str | None = None
        self.areas: list[Bounds] = []
        self.is_made_up = False
        self._root: str | None = None
        self._start = b""
        self._parser = expat.ParserCreate()
        self._parser.StartDoctypeDeclHandler = self._on_doctype
        self._parser.EntityDeclHandler = self._on_entity
        self._parser.StartElementHandler = self._on_element

    def feed(self, block: bytes) -> None:
        self._start = self._start or block[:512]
        try:
            self._parser.Parse(block, False)
        except expat.ExpatError as error:
            # What follows the first object is the business of the real parser.
            if not self.finished:
                raise self._not_osm(str(error)) from error

    def close(self) -> None:
        if self._root is None:
            raise self._not_osm("no element found")

    def _on_doctype(self, name: str, *_: object) -> None:
        if name.lower() == "html":
            raise self._html()
        raise MapError(
            f"{self.path}: declares a DOCTYPE ({name}). OSM files have none; it is refused because declarations can "
            "make a parser read other files or fill the memory."
        )

    def _on_entity(self, name: str, *_: object) -> None:
        raise MapError(f"{self.path}: declares the entity {name!r}. OSM files declare none; it is refused.")

    def _on_element(self, name: str, attributes: dict[str, str]) -> None:
        if self._root is None:
            self._check_root(name, attributes)
            self._root = name
        elif name == "meta":
            self.date = attributes.get("osm_base", self.date)
        elif name in {"bounds", "bound"} and not self.finished:  # ways of Overpass have their own
            self._add_bounds(attributes)
        elif name in {"action", "create", "modify", "delete"}:
            raise self._changes(f"<{name}> elements")
        elif name in _OBJECTS:
            self.finished = True

    def _check_root(self, name: str, attributes: dict[str, str]) -> None:
        if name == "osm":
            self.date = attributes.get("timestamp")
            self.is_made_up = attributes.get("generator") == SIMULATOR
            return
        if name.lower() == "html":
            raise self._html()
        if name in {"osmChange", "osmAugmentedDiff"}:
            raise self._changes(name)
        if (kind := name.rpartition(":")[2]) in _OTHER_ROOTS:
            raise MapError(f"{self.path}: is {_OTHER_ROOTS[kind]}.")
        raise self._not_osm(f"the first element is <{name}>, not <osm>")

    def _add_bounds(self, attributes: dict[str, str]) -> None:
        try:
            west, south, east, north = (float(attributes[key]) for key in ("minlon", "minlat", "maxlon", "maxlat"))
        except (KeyError, ValueError):
            return  # old writers had other forms of bounds; without bounds every node counts
        self.areas.append((west, south, east, north))

    def _changes(self, what: str) -> MapError:
        return MapError(f"{self.path}: is a change file ({what}). Expected a map: an .osm file with nodes and ways.")

    def _html(self) -> MapError:
        return MapError(
            f"{self.path}: is a web page (HTML), not an OSM file. Usual cause: the page about the map was saved, or "
            "the server answered with an error page; open it in a browser to see."
        )

    def _not_osm(self, reason: str) -> MapError:
        start = self._start.lstrip(b"\xef\xbb\xbf \t\r\n")
        if re.match(rb"\[\w+\s*:|\(?\s*(node|way|rel|nwr)\s*[\[(]", start):
            return MapError(f"{self.path}: is an Overpass query. Expected its answer, saved as .osm.")
        if start[:1] in {b"{", b"["}:
            return MapError(
                f"{self.path}: is JSON, not OSM XML. Usual cause: an Overpass query with [out:json]; ask for [out:xml] "
                "instead. GeoJSON has no common nodes of streets."
            )
        if re.match(rb"[^\r\n]{1,80}\r?\n!?\w+\r?\n\s+-?[\d.]+(E[+-]?\d+)?\s+-?[\d.]+", start):
            return MapError(f"{self.path}: is a border (.poly). Expected the extract that was cut by it.")
        if _CHECKSUM.match(start + b"\n"):
            return MapError(f"{self.path}: is a checksum. Expected the file beside it: the same name without .md5.")
        if start[:5].lower() in {b"<html", b"<!doc"}:
            return self._html()
        return MapError(
            f"{self.path}: is not an OSM file ({reason}). Expected .osm, .osm.gz, .osm.bz2 or .osm.pbf with highways."
        )


# XML that libosmium reads ---------------------------------------------------------------------------------------------

_KEPT = {
    "osm": ("version", "generator", "timestamp"),
    "bounds": ("minlon", "minlat", "maxlon", "maxlat"),
    "node": ("id", "version", "visible", "timestamp", "lat", "lon"),
    "way": ("id", "version", "visible", "timestamp"),
    "relation": ("id", "version", "visible", "timestamp"),
    "nd": ("ref", "lat", "lon"),
    "tag": ("k", "v"),
    "member": ("type", "ref", "role"),
}


def write_plain(path: Path, container: Container, target: Path) -> None:
    """Copy an OSM XML file: without what an editor deleted, with dates in UTC, without users and changesets.

    JOSM keeps what its user deleted in the file until it is uploaded (`action="delete"`), which libosmium does not pass
    on. Dates with an offset and user numbers of 64 bits make libosmium refuse a file, though no road depends on them.
    """
    with open_unpacked(path, container) as source, target.open("w", encoding="utf-8") as file:
        writer = _PlainWriter(file)
        try:
            writer.parser.ParseFile(source)
        except expat.ExpatError as error:
            raise MapError(f"{path}: is damaged ({error}). Usual cause: a download that was cut off.") from error


class _PlainWriter:
    """Hands the elements that are kept on to a file."""

    def __init__(self, file: IO[str]) -> None:
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self._file = file
        self._in_deleted = False

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        if name in _OBJECTS:
            self._in_deleted = attributes.get("action") == "delete"
        if self._in_deleted or name not in _KEPT:
            return
        if "timestamp" in attributes:
            attributes["timestamp"] = _in_utc(attributes["timestamp"])
        kept = (f" {key}={quoteattr(attributes[key])}" for key in _KEPT[name] if attributes.get(key))
        self._file.write(f"<{name}{''.join(kept)}>")

    def _end(self, name: str) -> None:
        if name in _KEPT and not self._in_deleted:
            self._file.write(f"</{name}>\n")
        if name in _OBJECTS:
            self._in_deleted = False


def _in_utc(text: str) -> str:
    """Return a date as OpenStreetMap writes it; "" of one that is none."""
    try:
        date = datetime.fromisoformat(text)
    except ValueError:
        return ""
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
