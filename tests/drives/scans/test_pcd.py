"""PCD files: three encodings, any fields, numbering by names, and everything that can be wrong with them."""

import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from interloc.drives.files import SourceFile
from interloc.drives.findings import Findings
from interloc.drives.inspect import inspect_drive
from interloc.drives.layouts import DriveParts
from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions
from interloc.drives.scans.bin_files import read_points
from interloc.drives.scans.deskewed import point_times
from interloc.drives.scans.pcd import number_scans, open_pcd_files, read_pcd
from interloc.drives.scans.raw import read_labels
from interloc.errors import DriveError
from tests import small_drives
from tests.pcd_files import labelled_points, pcd_bytes, write_pcd

ENCODINGS = ("ascii", "binary", "binary_compressed")


def as_pcd(source: Path, target: Path, folder: str = "pcd", encoding: str = "binary", labels: str = "labels") -> Path:
    """Rewrite a SemanticKITTI drive as PCD files with labels, and its other files beside them."""
    for scan in sorted((source / "velodyne").glob("*.bin")):
        values = read_points(SourceFile(scan, source))
        ids = read_labels(SourceFile(source / labels / f"{scan.stem}.label", source))
        write_pcd(target / folder / f"{scan.stem}.pcd", values, ids, encoding)
    for name in ("poses.txt", "times.txt", "calib.txt", "geo.csv"):
        if (source / name).exists():
            (target / name).write_bytes((source / name).read_bytes())
    return target


def as_pcd_with_gaps(source: Path, target: Path) -> Path:
    """Rewrite a drive as PCD files that are numbered 0, 10, 20, ..., with poses of the LiDAR."""
    root = as_pcd(source, target, ".")
    (root / "calib.txt").unlink()
    (root / "times.txt").unlink()
    for scan in root.glob("*.pcd"):
        scan.rename(root / f"street_{10 * int(scan.stem):04d}.pcd")
    (root / "poses.txt").write_text(small_drives.pose_text(small_drives.lidar_poses()))
    return root


@pytest.mark.parametrize(
    ("folder", "encoding"), [("pcd", "ascii"), ("clouds", "binary"), ("velodyne", "binary"), (".", "binary_compressed")]
)
def test_the_same_drive_in_pcd_files(sequence: Path, tmp_path: Path, folder: str, encoding: str) -> None:
    before, after = open_drive(sequence), open_drive(as_pcd(sequence, tmp_path / "pcd-drive", folder, encoding))
    assert after.layout == "pcd"
    np.testing.assert_array_equal(after.frames, before.frames)
    np.testing.assert_array_equal(after.T_world_lidar, before.T_world_lidar)
    for index in (0, 7):
        ours, theirs = after.ground_points(index), before.ground_points(index)
        np.testing.assert_array_equal(ours.xyz, theirs.xyz)
        assert ours.road_count == theirs.road_count


def test_real_frames_of_a_street(data: Callable[[str], Path]) -> None:
    points = read_pcd(SourceFile(data("formats/street_0000000010.pcd"), data("formats"))).values
    assert points.shape == (116_007, 4)
    assert np.isfinite(points).all()
    assert 0 <= points[:, 3].min() <= points[:, 3].max() <= 1
    assert np.percentile(np.hypot(points[:, 0], points[:, 1]), 99) < 120


@pytest.mark.parametrize(
    ("names", "frames", "times"),
    [
        (["000002.pcd", "000000.pcd", "000001.pcd"], [0, 1, 2], None),
        (["street_0000000010.pcd", "street_0000000000.pcd"], [0, 10], None),
        (["9.pcd", "10.pcd"], [9, 10], None),
        (["b.pcd", "a.pcd"], [0, 1], None),
        (["1305031102.675.pcd", "1305031102.175.pcd"], [0, 1], [1305031102.175, 1305031102.675]),
        (["1533151603547590.pcd", "1533151604047590.pcd"], [0, 1], [1533151603.54759, 1533151604.04759]),
        (["1533151603547590000.pcd", "1533151604047590000.pcd"], [0, 1], [1533151603.54759, 1533151604.04759]),
        (["c_1583836592_082590976.pcd", "c_1583836591_182590976.pcd"], [0, 1], [1583836591.1826, 1583836592.0826]),
        (["c_1583836592_82590976.pcd", "c_1583836591_182590976.pcd"], [0, 1], [1583836591.1826, 1583836592.0826]),
        (["1583836592-082590.pcd", "1583836591-182590.pcd"], [0, 1], [1583836591.18259, 1583836592.08259]),
        (["n8__LIDAR_TOP__1533151603547590.pcd.bin"], [0], [1533151603.54759]),
        (["a_1.pcd", "b_1.pcd"], [0, 1], None),
        (["20210315123420.pcd", "20210315123421.pcd"], [20210315123420, 20210315123421], None),
        (["5.pcd", "99999999999999999999.pcd"], [0, 1], None),
    ],
)
def test_scans_are_numbered_by_their_names(names: list[str], frames: list[int], times: Sequence[float] | None) -> None:
    order, numbers, times_s, _ = number_scans(names)
    assert sorted(order.tolist()) == list(range(len(names)))
    assert numbers.tolist() == frames
    if times is None:
        assert times_s is None
    else:
        assert times_s is not None
        np.testing.assert_allclose(times_s, times, rtol=0, atol=1e-4)


def test_names_with_several_numbers_are_taken_in_their_order() -> None:
    names = ["20230501_123000_900.pcd", "20230501_123001_100.pcd", "20230501_122959_950.pcd"]
    order, numbers, times_s, how = number_scans(names)
    assert (order.tolist(), numbers.tolist(), times_s) == ([2, 0, 1], [0, 1, 2], None)
    assert "in the order of all of them" in how


def test_numbers_with_gaps_have_one_pose_each(sequence: Path, tmp_path: Path) -> None:
    drive = open_drive(as_pcd_with_gaps(sequence, tmp_path / "pcd-drive"))
    assert drive.frames.tolist() == list(range(0, 120, 10))
    np.testing.assert_allclose(drive.T_world_lidar, small_drives.lidar_poses(), atol=1e-6)


def test_tum_poses_at_the_times_in_the_names(sequence: Path, tmp_path: Path) -> None:
    root = as_pcd(sequence, tmp_path / "pcd-drive", ".")
    for name in ("calib.txt", "times.txt", "poses.txt"):
        (root / name).unlink()
    for index, scan in enumerate(sorted(root.glob("*.pcd"))):
        scan.rename(root / f"{1000 + 0.1 * index:.3f}.pcd")
    poses = small_drives.lidar_poses(24, step_m=1.0, turn_rad=0.015)  # twice as many as scans
    half, times_s = np.arctan2(poses[:, 1, 0], poses[:, 0, 0]) / 2, 1000 + 0.05 * np.arange(24)
    rows = np.column_stack([times_s, poses[:, :3, 3], np.zeros((24, 2)), np.sin(half), np.cos(half)])
    np.savetxt(root / "poses.tum", rows, fmt="%.9f")
    drive = open_drive(root)
    np.testing.assert_allclose(drive.T_world_lidar, poses[::2], atol=1e-5)
    np.testing.assert_allclose(drive.times_s, 1000 + 0.1 * np.arange(12), atol=1e-6)
    (root / "poses.tum").rename(tmp_path / "elsewhere.tum")
    again = open_drive(root, poses=str(tmp_path / "elsewhere.tum"))
    np.testing.assert_array_equal(again.T_world_lidar, drive.T_world_lidar)


def test_times_of_points_count_from_the_name_of_their_file(tmp_path: Path) -> None:
    points = np.zeros(3, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("timestamp", "<f8")])
    for end_s in (1_600_000_000.1, 1_600_000_000.2):  # the scanner writes a file when its turn has ended
        points["timestamp"] = end_s - 0.1 + np.array([0.0, 0.05, 0.1])
        (tmp_path / f"{end_s:.3f}.pcd").write_bytes(pcd_bytes(points, "binary"))
    scans = open_pcd_files(DriveParts.inside("pcd", tmp_path, tmp_path, None), DriveOptions(), Findings(True)).points
    np.testing.assert_allclose(scans.read(1).times_s, [-0.1, -0.05, 0.0], atol=1e-5)


@pytest.mark.parametrize("in_world", [False, True])
def test_a_viewpoint_that_changes_holds_the_poses(sequence: Path, tmp_path: Path, in_world: bool) -> None:
    root, poses = as_pcd(sequence, tmp_path / "pcd-drive"), 10.0 * np.arange(12.0) + 4e5 * in_world
    for name in ("poses.txt", "calib.txt"):
        (root / name).unlink()
    for x, path in zip(poses, sorted((root / "pcd").iterdir()), strict=True):
        points = read_pcd(SourceFile(path, root))
        data = labelled_points(points.values, points.labels)
        data = data.astype([(name, "<f8" if name == "x" else data.dtype[name]) for name in data.dtype.names or ()])
        data["x"] += x * in_world
        path.write_bytes(pcd_bytes(data, "binary", header=[("VIEWPOINT", f"{x} 0 0 1 0 0 0")]))
    drive = open_drive(root, check=False)
    np.testing.assert_allclose(drive.T_world_lidar[:, 0, 3], poses - poses[0])
    np.testing.assert_allclose(drive.ground_points(9).xyz, open_drive(sequence).ground_points(9).xyz, atol=1e-4)


def test_a_viewpoint_that_stays_is_named(sequence: Path, tmp_path: Path) -> None:
    root = as_pcd(sequence, tmp_path / "pcd-drive")
    for path in (root / "pcd").iterdir():
        path.write_bytes(path.read_bytes().replace(b"VIEWPOINT 0 0 0", b"VIEWPOINT 1 0 2"))
    assert any("VIEWPOINT is 1 0 2 1 0 0 0 in all files" in each.message for each in inspect_drive(root).problems)


def test_late_times_are_left_out_and_the_others_used() -> None:
    times = np.linspace(0.0, 0.1, 1000)
    late = times * 1e9
    late[::20] += 0.4e9
    found = point_times(late)
    assert np.flatnonzero(np.isnan(found)).tolist() == list(range(0, 1000, 20))
    np.testing.assert_allclose(found[~np.isnan(found)], np.delete(times, np.s_[::20]) - times[1], atol=1e-3)


def test_fields_of_any_type_and_order(tmp_path: Path) -> None:
    points = np.zeros(
        3,
        [
            ("ring", "<u2"),
            ("z", "<f8"),
            ("_", "<u1"),
            ("normal", "<f4", (3,)),
            ("x", "<f4"),
            ("y", "<f4"),
            ("Intensity", "<u1"),
        ],
    )
    points["x"], points["y"], points["z"] = [1, 2, np.nan], [3, 4, 5], [-1.5, -1.25, 0]
    points["Intensity"] = [0, 128, 255]
    expected = np.array([[1, 3, -1.5, 0], [2, 4, -1.25, 128], [np.nan, 5, 0, 255]], np.float32)
    for encoding in ENCODINGS:
        path = tmp_path / "a.pcd"
        path.write_bytes(pcd_bytes(points, encoding))
        np.testing.assert_array_equal(read_pcd(SourceFile(path, tmp_path)).values, expected)


def test_points_without_a_return_are_no_ground(sequence: Path, tmp_path: Path) -> None:
    root = as_pcd(sequence, tmp_path / "pcd-drive")
    values = read_pcd(SourceFile(root / "pcd" / "000003.pcd", root))
    first = int(np.argmax((values.labels & 0xFFFF) == 40))
    values.values[first, :3] = np.nan
    write_pcd(root / "pcd" / "000003.pcd", values.values, values.labels)
    assert len(open_drive(root).ground_points(3).road) == len(open_drive(sequence).ground_points(3).road) - 1


def test_label_files_beside_pcd_files(sequence: Path, tmp_path: Path) -> None:
    root = as_pcd(sequence, tmp_path / "pcd-drive")
    for path in sorted((root / "pcd").iterdir()):
        write_pcd(path, read_pcd(SourceFile(path, root)).values)
    with pytest.raises(DriveError, match=r"labels: is missing\..*interloc label"):
        open_drive(root, labels="labels")
    assert open_drive(root).scans.label_source == "geometry"
    shutil.copytree(sequence / "labels", root / "labels")
    drive = open_drive(root)
    np.testing.assert_array_equal(drive.ground_points(5).xyz, open_drive(sequence).ground_points(5).xyz)
    (root / "labels" / "000005.label").write_bytes(b"1234")
    with pytest.raises(DriveError, match=r"labels/000005\.label: 1 labels for 1,725 points in pcd/000005\.pcd"):
        drive.ground_points(5)


BOMB = np.array([9, 64_000_000], "<u4").tobytes() + bytes(9)  # a few bytes that say they are many
GOOD = labelled_points(np.arange(40, dtype=np.float32).reshape(10, 4))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"\x89PNG\r\n" * 20, "is not a PCD file"),
        (b"x" * 100_000, "is not a PCD file"),
        (pcd_bytes(GOOD, "binary", header=[("FIELDS", "a b c d")]), "has no field x, y, z: its fields are a, b, c, d"),
        (pcd_bytes(GOOD, "binary", header=[("POINTS", "4000000000")]), "promises 4,000,000,000 points"),
        (pcd_bytes(GOOD, "binary", header=[("POINTS", "-1")]), "promises -1 points"),
        (
            pcd_bytes(GOOD, "binary", header=[("POINTS", "11")]),
            "is cut short: 11 points of 16 bytes are 176 bytes, and 160",
        ),
        (pcd_bytes(GOOD, "binary", header=[("SIZE", "4 4 4")]), "damaged PCD header"),
        (pcd_bytes(GOOD, "binary", header=[("SIZE", "4 4 4 3")]), "damaged PCD header"),
        (pcd_bytes(GOOD, "binary", header=[("COUNT", "1 1 1 999999999")]), "damaged PCD header"),
        (pcd_bytes(GOOD, "binary", header=[("DATA", "base64")]), "damaged PCD header"),
        (pcd_bytes(GOOD, "binary", header=[("WIDTH", "ten"), ("POINTS", "")]), "damaged PCD header"),
        (
            pcd_bytes(GOOD, "ascii", header=[("POINTS", "9")]),
            "10 lines of 4 numbers; the header promises 9 points of 4",
        ),
        (pcd_bytes(GOOD, "ascii").replace(b"5.0", b"five"), "could not convert string 'five' to float64"),
        (pcd_bytes(GOOD, "ascii")[:-6], "columns changed from 4 to 3 at row 10"),
        (pcd_bytes(GOOD[:0], "binary_compressed", header=[("POINTS", "4000000")])[:-8] + BOMB, "would unpack from 9"),
        (pcd_bytes(GOOD, "binary_compressed")[:-3], "is damaged: its points would unpack"),
        (pcd_bytes(GOOD, "binary_compressed", header=[("POINTS", "11")]), "is damaged: its points would unpack"),
    ],
)
def test_damaged_and_hostile_files(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "a.pcd"
    path.write_bytes(content)
    with pytest.raises(DriveError, match=re.escape(words)):
        read_pcd(SourceFile(path, tmp_path))


@pytest.mark.parametrize(
    "packed",
    [
        bytes([3, 1, 2]),  # four bytes announced, two there
        bytes([0, 1, 0xE0]),  # a reference without its length
        bytes([0, 1, 0x20, 5]),  # before the beginning
        bytes([31]) + bytes(32) + bytes([0xE0, 255, 0]) * 2,  # more than promised
        bytes([0, 65]),  # less than promised
    ],
)
def test_packed_points_that_are_damaged(tmp_path: Path, packed: bytes) -> None:
    header = pcd_bytes(GOOD[:0], "binary_compressed", header=[("POINTS", "10")])[:-8]
    path = tmp_path / "a.pcd"
    path.write_bytes(header + np.array([len(packed), 160], "<u4").tobytes() + packed)
    with pytest.raises(DriveError, match="its packed points cannot be unpacked"):
        read_pcd(SourceFile(path, tmp_path))


def test_a_damaged_scan_is_listed_with_its_name(sequence: Path, tmp_path: Path) -> None:
    root = as_pcd(sequence, tmp_path / "pcd-drive")
    path = root / "pcd" / "000000.pcd"
    whole = path.read_bytes()
    path.write_bytes(whole[:500])
    report = inspect_drive(root)
    assert not report.ok
    assert any(each.path == "pcd/000000.pcd" and "cut short" in each.message for each in report.problems)
    path.write_bytes(re.sub(rb"POINTS \d+", b"POINTS -1", whole))
    complaints = " ".join(problem.message for problem in inspect_drive(root).problems)
    assert "promises -1 points" in complaints
    assert "label" not in complaints
