"""PCD files in all three encodings, written plainly."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

TYPES = {"f": "F", "i": "I", "u": "U"}


def compress_lzf(raw: bytes) -> bytes:
    """Pack greedily: the last place where the same three bytes began, or a byte as it is."""
    out, pending = bytearray(), bytearray()
    seen: dict[bytes, int] = {}

    def flush() -> None:
        for at in range(0, len(pending), 32):
            piece = pending[at : at + 32]
            out.append(len(piece) - 1)
            out.extend(piece)
        pending.clear()

    at = 0
    while at < len(raw):
        key = raw[at : at + 3]
        before = seen.get(key, -1) if len(key) == 3 else -1
        seen[key] = at
        distance = at - before - 1
        if before < 0 or distance >= 8192:
            pending.append(raw[at])
            at += 1
            continue
        length = 3
        while length < 264 and at + length < len(raw) and raw[before + length] == raw[at + length]:
            length += 1
        flush()
        count = length - 2
        if count < 7:
            out.append((count << 5) | (distance >> 8))
        else:
            out.extend([(7 << 5) | (distance >> 8), count - 7])
        out.append(distance & 255)
        at += length
    flush()
    return bytes(out)


def pcd_bytes(points: NDArray[Any], encoding: str, *, header: Sequence[tuple[str, str]] = ()) -> bytes:
    """Write structured points; `header` replaces lines of the header."""
    kinds = [points.dtype[name] for name in points.dtype.names or ()]
    names = points.dtype.names or ()
    lines = {
        "VERSION": "0.7",
        "FIELDS": " ".join(names),
        "SIZE": " ".join(str(kind.base.itemsize) for kind in kinds),
        "TYPE": " ".join(TYPES[kind.base.kind] for kind in kinds),
        "COUNT": " ".join(str(int(np.prod(kind.shape)) or 1) for kind in kinds),
        "WIDTH": str(len(points)),
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": str(len(points)),
        "DATA": encoding,
    }
    lines |= dict(header)
    text = "# .PCD v0.7 - Point Cloud Data file format\n" + "".join(
        f"{name} {value}\n" for name, value in lines.items()
    )
    if encoding == "ascii":
        rows = [
            " ".join(repr(value) for value in np.hstack([np.ravel(row[name]) for name in names]).tolist())
            for row in points
        ]
        return text.encode() + ("\n".join(rows) + "\n").encode()
    if encoding == "binary":
        return text.encode() + points.tobytes()
    raw = b"".join(np.ascontiguousarray(points[name]).tobytes() for name in names)
    packed = compress_lzf(raw)
    return text.encode() + np.array([len(packed), len(raw)], "<u4").tobytes() + packed


def labelled_points(values: NDArray[Any], labels: NDArray[Any] | None = None) -> NDArray[Any]:
    """Return (N, 4) values as structured points x y z intensity, with their labels where given."""
    kinds: list[tuple[str, str]] = [(name, "<f4") for name in ("x", "y", "z", "intensity")]
    if labels is not None:
        kinds.append(("label", "<u4"))
    points = np.zeros(len(values), kinds)
    for column, (name, _) in enumerate(kinds[:4]):
        points[name] = values[:, column]
    if labels is not None:
        points["label"] = labels
    return points


def write_pcd(path: Path, values: NDArray[Any], labels: NDArray[Any] | None = None, encoding: str = "binary") -> None:
    """Write (N, 4) values x y z intensity, with their labels where given."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pcd_bytes(labelled_points(values, labels), encoding))
