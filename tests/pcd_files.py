"""PCD files in all three encodings, written plainly."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lzf
import numpy as np
from numpy.typing import NDArray

TYPES = {"f": "F", "i": "I", "u": "U"}


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
    text = "# .PCD v0.7 - Point Cloud Data file format\n"
    text += "".join(f"{name} {value}\n" for name, value in lines.items())
    if encoding == "ascii":
        rows = (np.hstack([np.ravel(row[name]) for name in names]).tolist() for row in points)
        return (text + "".join(" ".join(map(repr, row)) + "\n" for row in rows)).encode()
    if encoding == "binary":
        return text.encode() + points.tobytes()
    raw = b"".join(np.ascontiguousarray(points[name]).tobytes() for name in names)
    packed = lzf.compress(raw, 2 * len(raw) + 16) or b""
    return text.encode() + np.array([len(packed), len(raw)], "<u4").tobytes() + packed


def labelled_points(values: NDArray[Any], labels: NDArray[Any] | None = None) -> NDArray[Any]:
    """Return (N, 4) values as structured points x y z intensity, with their labels where given."""
    fields = dict(zip(("x", "y", "z", "intensity"), np.asarray(values, "<f4").T, strict=True))
    if labels is not None:
        fields["label"] = np.asarray(labels, "<u4")
    return np.rec.fromarrays([*fields.values()], names=[*fields])


def write_pcd(path: Path, values: NDArray[Any], labels: NDArray[Any] | None = None, encoding: str = "binary") -> None:
    """Write (N, 4) values x y z intensity, with their labels where given."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pcd_bytes(labelled_points(values, labels), encoding))
