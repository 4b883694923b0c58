"""OSM XML as editors and old programs write it, in the form that libosmium reads.

JOSM keeps what its user deleted in the file until it is uploaded (`action="delete"`), which libosmium does not pass on.
Dates with an offset and user numbers of 64 bits make libosmium refuse a file, though no road depends on them.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import IO
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from interloc.errors import MapError
from interloc.osm.container import Container, open_unpacked

_OBJECTS = {"node", "way", "relation"}
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

    Raises
    ------
    MapError
        The file is not well-formed XML.
    """
    with open_unpacked(path, container) as source, target.open("w", encoding="utf-8") as file:
        writer = _Writer(file)
        try:
            writer.parser.ParseFile(source)
        except expat.ExpatError as error:
            raise MapError(f"{path}: is damaged ({error}). Usual cause: a download that was cut off.") from error


class _Writer:
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
