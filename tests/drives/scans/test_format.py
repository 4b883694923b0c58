"""What the description of the format tells writers in other languages is true."""

from __future__ import annotations

import shutil
import subprocess
import textwrap
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import interloc.drives.scans.reduced_format as described
from interloc.drive import GroundPoints
from interloc.drives.open import open_drive
from interloc.drives.scans.reduced_format import decode_ground, encode_ground

WRITER = """
const fs = require("fs"), zlib = require("zlib");
const raw = fs.readFileSync(process.argv[2]);
const xyz = new Uint32Array(raw.buffer.slice(raw.byteOffset, raw.byteOffset + raw.length));
const n = xyz.length / 3, planes = new Uint8Array(12 * n), head = Buffer.alloc(16);
for (let c = 0; c < 3; c++) {
  const bits = Uint32Array.from({ length: n }, (_, i) => xyz[3 * i + c]);
SNIPPET
}
head.write("ILGP"); [1, n, +process.argv[4]].forEach((value, i) => head.writeUInt32LE(value, 4 + 4 * i));
fs.writeFileSync(process.argv[3], Buffer.concat([head, zlib.deflateSync(planes)]));
"""


def javascript_of_the_description() -> str:
    lines = (described.__doc__ or "").splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("In JavaScript"))
    block = [line for line in lines[start + 1 :] if line.startswith("    ") or not line]
    stop = next(i for i, line in enumerate(block) if line.strip() == "}" and i)
    return textwrap.dedent("\n".join(block[: stop + 1]))


def written_by_node(points: GroundPoints, folder: Path) -> bytes:
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    script, raw, out = folder / "write.cjs", folder / "points.bin", folder / "scan.ground"
    script.write_text(WRITER.replace("SNIPPET", javascript_of_the_description()))
    points.xyz.tofile(raw)
    subprocess.run([node, script, raw, out, str(points.road_count)], check=True)
    return out.read_bytes()


def test_the_javascript_of_the_description(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 1 << 32, (500, 3), dtype=np.uint32)
    xyz = bits.view(np.float32)[np.isfinite(bits.view(np.float32)).all(axis=1)]
    again = decode_ground(written_by_node(GroundPoints(xyz, 9), tmp_path), "scan.ground")
    assert again.xyz.tobytes() == xyz.tobytes()
    assert again.road_count == 9


def test_a_real_scan_from_javascript(tmp_path: Path, data: Callable[[str], Path]) -> None:
    points = open_drive(data("semantickitti_mini/sequences/07")).ground_points(5)
    written = written_by_node(points, tmp_path)
    assert decode_ground(written, "scan.ground").xyz.tobytes() == points.xyz.tobytes()
    assert len(encode_ground(points)) < 7.2 * len(points.xyz)  # of 12 bytes a point
