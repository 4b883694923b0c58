"""The features of the chunks that come into question for a query: each property that is asked for as one array."""

from __future__ import annotations

import math
import re
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import bindparam, select
from sqlalchemy.orm import Session

from app.ogc.columns import Texts, unpack_blobs, unpack_numbers, unpack_texts
from app.ogc.work import BOXES, CONTENT, IDS, RESULT, SHAPES
from app.store.models import FeatureColumn
from interloc.arrays import FloatArray
from interloc.output.geojson import encode

_OSM_ID = re.compile(r'("osm_\w*":)(-?\d+)(?=[,}])')  # quotes within texts have a backslash before them
_OF_RESULT = [each.name for each in RESULT]


class Key(NamedTuple):
    """The place of a feature in the order of pages."""

    chunk: int
    row: int

    def __str__(self) -> str:
        """Return it as it stands in addresses."""
        return f"{self.chunk}.{self.row}"


@dataclass
class Candidates:
    """All features of some chunks, one after the other; a place is the number of a feature among them."""

    session: Session
    chunks: Sequence[Any]
    """``id`` (in whose order they are), ``count``, and what is the same for all features of the chunk: ``drive``,
    ``job``, ``preset``, ``labels``."""
    is_point: bool
    """Whether features are points."""
    of_results: bool = True
    """Whether the latter are properties of the features."""
    _numbers: dict[str, FloatArray] = field(default_factory=dict)
    _texts: dict[str, Texts] = field(default_factory=dict)

    @cached_property
    def _starts(self) -> NDArray[np.int64]:
        """Where each chunk begins, and where the last one ends."""
        return np.cumsum([0, *(each.count for each in self.chunks)], dtype=np.int64)

    def __len__(self) -> int:
        return int(self._starts[-1])

    def _located(self, places: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the number of the chunk of each candidate, and its row there."""
        numbers = np.searchsorted(self._starts, places, side="right") - 1
        return numbers, places - self._starts[numbers]

    def place_after(self, key: Key) -> int:
        """Return the place of the first candidate after a key."""
        number = int(np.searchsorted([each.id for each in self.chunks], key.chunk))
        if number == len(self.chunks) or self.chunks[number].id != key.chunk:
            return int(self._starts[number])
        return int(self._starts[number] + min(key.row + 1, self.chunks[number].count))

    def key_of(self, place: int) -> Key:
        """Return the key of a candidate."""
        (number,), (row,) = (each.tolist() for each in self._located(np.array([place])))
        return Key(self.chunks[number].id, row)

    def numbers(self, name: str) -> FloatArray:
        """Return a property that is a number, a flag or a time (seconds since 1970), NaN for null."""
        return self.packed_numbers(name, 1)[:, 0]

    def boxes(self) -> FloatArray:
        """Return west, south, east, north of each, (N, 4); NaN without geometry."""
        return self.packed_numbers(BOXES, 4)

    def packed_numbers(self, name: str, width: int) -> FloatArray:
        """Return a column of numbers, (N, width); NaN in chunks that have none."""
        if name not in self._numbers:
            found, none = self._contents(name), struct.pack("<d", math.nan) * width
            contents = (found.get(each.id) or none * each.count for each in self.chunks)
            self._numbers[name] = unpack_numbers(contents).reshape(-1, width)
        return self._numbers[name]

    def texts(self, name: str) -> Texts:
        """Return a property that is a text."""
        if name not in self._texts:
            is_of_chunk = self.of_results and name in _OF_RESULT
            self._texts[name] = self._of_chunks(name) if is_of_chunk else unpack_texts(self._contents(name).values())
        return self._texts[name]

    def _of_chunks(self, name: str) -> Texts:
        values = [getattr(each, name) for each in self.chunks]
        numbers = {value: number for number, value in enumerate(dict.fromkeys(values))}  # null is one of them, too
        codes = np.array([-1 if value is None else numbers[value] for value in values], dtype=np.int32)
        return Texts([value or "" for value in numbers], np.repeat(codes, np.diff(self._starts)))

    def shapes(self, places: NDArray[np.int64]) -> NDArray[np.object_]:
        """Return the geometries of some candidates."""
        import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

        if self.is_point:
            return np.asarray(shapely.points(self.boxes()[places, :2]), dtype=object)
        numbers, rows = (each.tolist() for each in self._located(places))
        blobs = {
            number: unpack_blobs(content, self.chunks[number].count)
            for number, content in self._contents_of(SHAPES, numbers).items()
        }
        wkb = [blobs[number][row] or None for number, row in zip(numbers, rows, strict=True)]
        return np.asarray(shapely.from_wkb(wkb), dtype=object)

    def features(self, places: NDArray[np.int64], id_of: Callable[[str, str], str]) -> Iterator[str]:
        """Yield candidates as GeoJSON; `id_of` returns the id of a feature of a job, by the one in its layer."""
        numbers, rows = (each.tolist() for each in self._located(places))
        contents = self._contents_of(CONTENT, numbers)
        lines = {number: zlib.decompress(content).decode().split("\n") for number, content in contents.items()}
        ids = {number: unpack_texts([content]) for number, content in self._contents_of(IDS, numbers).items()}
        tails = dict.fromkeys(lines, "}")
        if self.of_results:
            told = {number: {name: getattr(self.chunks[number], name) for name in _OF_RESULT} for number in lines}
            tails = {number: f",{encode(properties)[1:]}" for number, properties in told.items()}
        for number, row in zip(numbers, rows, strict=True):
            id_ = id_of(self.chunks[number].job, ids[number].values[ids[number].codes[row]])
            line = _OSM_ID.sub(r'\1"\2"', lines[number][row])
            yield f'{{"type":"Feature","id":{encode(id_)},{line[:-1]}{tails[number]}}}'

    def _contents_of(self, name: str, numbers: Sequence[int]) -> dict[int, bytes]:
        """Return a column of some chunks, by their numbers."""
        used = sorted(set(numbers))
        contents = self._contents(name, [self.chunks[number].id for number in used])
        return dict(zip(used, contents.values(), strict=True))

    def _contents(self, name: str, ids: list[int] | None = None) -> dict[int, bytes]:
        """Return a column of these chunks, by default of all, by their ids and in their order."""
        if ids is None:
            ids = [each.id for each in self.chunks]
        if not ids:
            return {}
        # Written into the query: databases take only some thousand parameters.
        among = FeatureColumn.chunk_id.in_(bindparam("ids", ids, expanding=True, literal_execute=True))
        query = select(FeatureColumn.chunk_id, FeatureColumn.content).where(FeatureColumn.name == name, among)
        return dict(self.session.execute(query.order_by(FeatureColumn.chunk_id)).all())
