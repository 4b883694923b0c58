"""The page reduces scans in the browser: what it writes must be what the library would have picked."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from interloc.arrays import Float32Array, FloatArray, UInt32Array
from interloc.drives.labels import named_scheme
from interloc.drives.scans.reduced_format import decode_ground
from interloc.kernels.ground import select_points

NODE = shutil.which("node")
JS = Path(__file__).with_name("js")
pytestmark = pytest.mark.skipif(NODE is None, reason="node is not installed")


def run_node(*arguments: str | Path) -> str:
    assert NODE is not None
    done = subprocess.run(
        [NODE, *map(str, arguments)], cwd=JS, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def reduce_scans(folder: Path, scheme: str) -> None:
    meaning = named_scheme(scheme)
    assert meaning is not None
    ids = {"road": sorted(meaning.road), "confusable": sorted(meaning.confusable)}
    run_node("reduce_scans.mjs", folder, json.dumps(ids))


def write_scan(folder: Path, number: int, points: Float32Array, labels: UInt32Array) -> None:
    points.astype("<f4").tofile(folder / f"{number:06d}.bin")
    labels.astype("<u4").tofile(folder / f"{number:06d}.label")


def check_folder(folder: Path, scheme: str) -> int:
    """Compare every .ground file with what the library picks from the scan; returns the number of points compared."""
    meaning = named_scheme(scheme)
    assert meaning is not None
    compared = 0
    for scan in sorted(folder.glob("*.bin")):
        points = np.fromfile(scan, "<f4").reshape(-1, 4)
        labels = np.fromfile(scan.with_suffix(".label"), "<u4")
        xyz, road_count, _ = select_points(points, labels, meaning.groups())
        ground = scan.with_suffix(".ground")
        found = decode_ground(ground.read_bytes(), ground.name)
        assert found.road_count == road_count
        assert found.xyz.tobytes() == xyz.tobytes()
        compared += len(xyz)
    return compared


def test_any_finite_coordinates_come_through_bit_by_bit(tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    edges = np.array(
        [0.0, -0.0, 1e-45, -1e-45, 3.4028235e38, -3.4028235e38, 1.17549435e-38, 0.1, -1.0, 80.0], np.float32
    )
    for number, count in enumerate((1, 2, 3, 17, 1000, 4096, 50_000)):
        bits = random.integers(0, 2**32, (count, 4), dtype=np.uint32)
        points = bits.view(np.float32).copy()
        points[~np.isfinite(points)] = 1.5
        points[random.random(points.shape) < 0.3] = random.choice(edges)
        labels = random.choice(np.array([40, 60, 44, 48, 49, 70, 50, 0, 252], np.uint32), count)
        labels |= random.integers(0, 2**16, count, dtype=np.uint32) << np.uint32(16)  # instances, to be ignored
        write_scan(tmp_path, number, points, labels)
    write_scan(tmp_path, 90, np.ones((5, 4), np.float32), np.full(5, 70, np.uint32))  # no ground at all
    write_scan(tmp_path, 91, np.ones((5, 4), np.float32), np.full(5, 48, np.uint32))  # no road
    nan = np.full((5, 4), np.nan, np.float32)
    write_scan(tmp_path, 92, nan, np.full(5, 70, np.uint32))  # what is left out may be anything
    reduce_scans(tmp_path, "semantickitti")
    assert not list(tmp_path.glob("*.error"))
    assert check_folder(tmp_path, "semantickitti") > 30_000


def test_ids_of_road_may_be_named(tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    points = random.normal(0, 20, (3000, 4)).astype(np.float32)
    write_scan(tmp_path, 0, points, random.integers(0, 12, 3000).astype(np.uint32))
    reduce_scans(tmp_path, "3, 11")
    assert check_folder(tmp_path, "3, 11") > 300


@pytest.mark.parametrize(
    ("points", "labels", "words"),
    [
        (np.full((4, 4), np.inf), [40, 40, 40, 40], ["velodyne/000000.bin", "point 0 of 4", "not finite"]),
        (np.ones((4, 4)), [40, 40, 40], ["labels/000000.label", "12 bytes", "64 bytes", "velodyne/000000.bin"]),
        (np.ones((3, 3)), [40, 40, 40], ["12 bytes", "36 bytes", "velodyne/000000.bin", "4 bytes for each 16"]),
        (np.ones((0, 4)), [], ["0 bytes of labels", "velodyne/000000.bin"]),
    ],
)
def test_damaged_scans_are_refused_in_words(
    tmp_path: Path, points: FloatArray, labels: list[int], words: list[str]
) -> None:
    write_scan(tmp_path, 0, points.astype(np.float32), np.array(labels, np.uint32))
    reduce_scans(tmp_path, "semantickitti")
    assert not (tmp_path / "000000.ground").exists()
    message = (tmp_path / "000000.error").read_text()
    assert all(word in message for word in words), message


def test_units() -> None:
    """The tests of the modules themselves, `js/*.test.mjs`."""
    tests = "".join(f'import "./{path.name}";' for path in sorted(JS.glob("*.test.mjs")))
    report = run_node("--input-type=module", "--eval", tests)  # all in one process: `node --test` has one for each
    assert "# fail 0" in report
    assert "# pass 0\n" not in report
