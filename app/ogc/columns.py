"""The values of one property of many features as bytes: how the index of features keeps them.

Numbers, flags and times (seconds since 1970) are float64, NaN for null. A text is the number of one of the different
texts, which stand before the numbers; -1 for null. All of it is little-endian, the same in every database.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from interloc.arrays import FloatArray

_LENGTH = struct.Struct("<I")


@dataclass(frozen=True)
class Texts:
    """A column of texts."""

    values: list[str]
    """The texts that occur; one may stand here several times."""
    codes: NDArray[np.int32]
    """(N,): index of the text of each feature in `values`; -1 for null."""


def pack_numbers(values: Iterable[float | None]) -> bytes:
    """Return numbers, flags or times as bytes."""
    return np.array([np.nan if value is None else value for value in values], dtype="<f8").tobytes()


def unpack_numbers(packed: Iterable[bytes]) -> FloatArray:
    """Return what `pack_numbers` packed, of several chunks one after the other: (N,) float64."""
    return np.frombuffer(b"".join(packed), dtype="<f8").astype(np.float64, copy=False)


def pack_texts(values: Sequence[str | None]) -> bytes:
    """Return texts as bytes."""
    codes = {value: number for number, value in enumerate(dict.fromkeys(v for v in values if v is not None))}
    known = json.dumps(list(codes), ensure_ascii=False).encode()
    numbers = np.array([-1 if value is None else codes[value] for value in values], dtype="<i4")
    return _LENGTH.pack(len(known)) + known + numbers.tobytes()


def unpack_texts(packed: Iterable[bytes]) -> Texts:
    """Return what `pack_texts` packed, of several chunks one after the other."""
    values: list[str] = []
    codes = [np.empty(0, dtype=np.int32)]
    for content in packed:
        (length,) = _LENGTH.unpack_from(content)
        start = _LENGTH.size + length
        own = np.frombuffer(content, dtype="<i4", offset=start)
        codes.append(np.where(own < 0, -1, own + len(values)).astype(np.int32))
        values += json.loads(content[_LENGTH.size : start])
    return Texts(values, np.concatenate(codes))


def pack_blobs(blobs: Sequence[bytes]) -> bytes:
    """Return byte strings, for example geometries as WKB, as one."""
    lengths = np.array([len(blob) for blob in blobs], dtype="<u4")
    return lengths.tobytes() + b"".join(blobs)


def unpack_blobs(packed: bytes, count: int) -> list[bytes]:
    """Return what `pack_blobs` packed, of one chunk."""
    ends = 4 * count + np.cumsum(np.frombuffer(packed, dtype="<u4", count=count), dtype=np.int64)
    starts = np.concatenate([[4 * count], ends[:-1]])
    return [packed[start:end] for start, end in zip(starts.tolist(), ends.tolist(), strict=True)]
