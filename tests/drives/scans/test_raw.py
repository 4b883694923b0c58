"""Reading of scans, and drives on their way to other processes."""

import pickle
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from interloc.drive import scans_of
from interloc.drives.open import open_drive
from interloc.drives.scans.bin_files import layout_of
from interloc.errors import DriveError


def test_ground_points_are_road_first(sequence: Path, make: ModuleType) -> None:
    drive = open_drive(sequence)
    points = drive.ground_points(0)
    bin_points, labels = make.scan_at(np.eye(4), make.IDS["semantickitti"])
    ids = labels & 0xFFFF
    np.testing.assert_array_equal(points.road, bin_points[ids == 40, :3])
    np.testing.assert_array_equal(points.confusable, bin_points[ids == 48, :3])
    assert points.is_road.sum() == len(points.road)
    assert points.xyz.dtype == np.float32
    assert points.xyz.flags.c_contiguous


def test_a_drive_travels_light_and_its_errors_too(sequence: Path) -> None:
    drive = open_drive(sequence)
    drive.ground_points(0)
    data = pickle.dumps(drive)
    assert len(data) < 20_000
    np.testing.assert_array_equal(pickle.loads(data).ground_points(3).xyz, drive.ground_points(3).xyz)  # noqa: S301
    (sequence / "velodyne" / "000003.bin").write_bytes(b"12345")
    with pytest.raises(DriveError) as caught:
        drive.ground_points(3)
    again = pickle.loads(pickle.dumps(caught.value))  # noqa: S301
    assert type(again) is type(caught.value)
    assert str(again) == str(caught.value)


def test_scans_are_read_when_asked_for(sequence: Path) -> None:
    scans = list(scans_of(open_drive(sequence)))
    (sequence / "velodyne" / "000003.bin").unlink()
    assert len(scans[2].road_points) > 0
    with pytest.raises(DriveError, match=r"velodyne/000003\.bin: cannot be read: no such file"):
        _ = scans[3].road_points


def test_scan_that_changed_after_opening(sequence: Path) -> None:
    drive = open_drive(sequence)
    path = sequence / "velodyne" / "000003.bin"
    whole = path.read_bytes()
    points = np.frombuffer(whole, np.float32).reshape(-1, 4).copy()
    points[505, 1] = np.inf
    for data, words in (
        (whole[:17], "17 bytes, which is no multiple of 16"),
        (b"", "is empty"),
        (whole[:160], "labels for 10 points"),
        (points.tobytes(), r"velodyne/000003\.bin: point 505 of 1,725 is not finite"),
    ):
        path.write_bytes(data)
        with pytest.raises(DriveError, match=words):
            drive.ground_points(3)


RNG = np.random.default_rng(2)
POINTS = np.column_stack(
    [RNG.uniform(-40, 40, (3000, 2)), RNG.normal(-1.7, 0.2, 3000), RNG.uniform(0, 1, 3000)]
).astype(np.float32)
RING, TIME = np.arange(3000) % 64, np.linspace(-0.05, 0.05, 3000)
NONE = np.array([np.nan])


def layout(points: np.ndarray, labels: np.ndarray = NONE) -> tuple[int, str]:
    values = np.ascontiguousarray(points).view("<f4").ravel()
    return layout_of(values, np.full(len(labels), values.nbytes), labels)


@pytest.mark.parametrize("more", [[], [RING], [RING, TIME], [TIME, RING, 3 * RING], [0 * RING], [POINTS[:, 3], TIME]])
def test_columns_tell_the_values_per_point_and_no_order_is_needed(more: list[np.ndarray]) -> None:
    points = np.column_stack([POINTS, *more]).astype(np.float32)
    assert layout(points) == (4 + len(more), "")
    assert layout(RNG.permutation(points)) == (4 + len(more), "")
    assert "row by row" in layout(points.T)[1]


def test_labels_and_sizes_tell_where_values_do_not() -> None:
    alike = RNG.normal(size=(2400, 1)).astype(np.float32)
    assert layout(alike) == (4, "")
    assert "big-endian float32" in layout(alike.byteswap())[1]
    assert layout(alike, np.array([400.0])) == (6, "")
    assert layout(alike[:2395]) == (5, "")  # a multiple of 20 bytes, not of 16
    assert layout(np.zeros((3000, 6), np.float32)) == (4, "")


def test_what_is_not_float32_is_named() -> None:
    assert "Usual cause: float64" in layout(POINTS.astype(np.float64) + 1e-9)[1]
    records = np.zeros((3000, 4), np.uint16)
    records[:, :3] = np.rint((POINTS[:, :3] + 100) / 0.005)
    records[:, 3] = RING << 8 | 30
    assert "as NCLT has them" in layout(records)[1]
