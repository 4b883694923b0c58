"""Drives that must be refused, each with words that name the file and the usual mistake."""

import dataclasses
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from interloc.drives.checks import check_flat_road
from interloc.drives.findings import Findings
from interloc.drives.georeference.geodetic import check_georeference
from interloc.drives.inspect import inspect_drive
from interloc.drives.open import open_drive
from interloc.errors import DriveError, GeoreferenceError
from interloc.geometry import invert_transform
from tests.small_drives import refusal_of

refusal = partial(refusal_of, open_drive)


def rewrite_labels(sequence: Path, ids: dict[int, int]) -> None:
    for path in (sequence / "labels").iterdir():
        labels = np.fromfile(path, np.uint32) & 0xFFFF
        np.array([ids.get(int(label), int(label)) for label in labels], np.uint32).tofile(path)


def cut(name: str, count: int) -> Callable[[Path], object]:
    """Return what takes bytes from the end of a file."""
    return lambda root: (root / name).write_bytes((root / name).read_bytes()[:-count])


def write(name: str, content: bytes) -> Callable[[Path], object]:
    return lambda root: (root / name).write_bytes(content)


POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 1999904\n"


def remove(*names: str) -> Callable[[Path], object]:
    return lambda root: [(root / name).unlink() for name in names]


def with_nan(root: Path) -> None:
    path = root / "velodyne" / "000000.bin"
    points = np.fromfile(path, np.float32).reshape(-1, 4)
    points[505, 2] = np.nan
    points.tofile(path)


def without_a_number(root: Path) -> None:
    lines = (root / "poses.txt").read_text().splitlines()
    lines[7] = lines[7].rsplit(" ", 1)[0]
    (root / "poses.txt").write_text("\n".join(lines))


def without_the_last_pose(root: Path) -> None:
    (root / "poses.txt").write_text("\n".join((root / "poses.txt").read_text().splitlines()[:-1]) + "\n")


def with_a_folder_of_poses(root: Path) -> None:
    (root / "poses.txt").unlink()
    (root / "poses.txt").mkdir()


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (cut("velodyne/000004.bin", 7), "^velodyne/000004.bin: 27,593 bytes, which is no multiple of 16."),
        (cut("velodyne/000004.bin", 160), "1,725 labels for 1,715 points in velodyne/000004.bin"),
        (
            write("labels/000004.label", bytes(4 * 1735)),
            "^labels/000004.label: 1,735 labels for 1,725 points in velodyne/000004.bin.*labels of another sequence",
        ),
        (cut("labels/000004.label", 1), "no multiple of 4"),
        (with_nan, "^velodyne/000000.bin: point 505 of 1,725 is not finite"),
        (without_a_number, "^poses.txt: line 8: 11 numbers; expected 12"),
        (
            remove("velodyne/000003.bin", "velodyne/000007.bin"),
            r"^velodyne: 2 scans missing between 0 and 11 \(3, 7\).*contiguous or explicitly mapped",
        ),
        (remove("labels/000003.label"), r"^labels/000003.label: is missing: 1 of 12 scans have no labels \(3\)"),
        (without_the_last_pose, r"^poses.txt: 11 poses for the scans 0 to 11 \(12 scans\)"),
        (remove(*(f"velodyne/{number:06d}.bin" for number in range(12))), "^velodyne: holds no .bin file"),
        (write("velodyne/000002.bin", b""), "^velodyne/000002.bin: is empty"),
        (with_a_folder_of_poses, "^poses.txt: is a folder"),
        (write("poses.txt", bytes(range(256))), "not a text file"),
        (write("poses.txt", b"<!DOCTYPE html>\n<title>Not found</title>"), "^poses.txt: is a web page"),
        (write("poses.txt", POINTER), "^poses.txt: is a pointer of Git LFS.*git lfs pull"),
        (write("labels/000004.label", POINTER), "^labels/000004.label: is a pointer of Git LFS"),
        (
            lambda root: [file.write_bytes(POINTER) for file in (root / "velodyne").iterdir()],
            "^velodyne: each scan is a pointer of Git LFS",
        ),
    ],
)
def test_damage_is_refused_in_words(sequence: Path, damage: Callable[[Path], object], words: str) -> None:
    damage(sequence)
    assert re.search(words, refusal(sequence), re.DOTALL)


def test_poses_that_contradict_what_is_declared(sequence: Path, tmp_path: Path, make: ModuleType) -> None:
    assert "they are those of the camera" in refusal(sequence, pose_frame="lidar")
    root = make.write_semantickitti(tmp_path / "own", pose_frame="lidar", calib=True)
    assert "they are those of the LiDAR" in refusal(root, pose_frame="camera")
    assert "there is no calib.txt" in refusal(make.write_semantickitti(tmp_path / "none", calib=False))


@pytest.mark.parametrize("options", [{}, {"label_scheme": "semantickitti"}])
def test_learning_ids_instead_of_raw_ids(tmp_path: Path, make: ModuleType, options: dict[str, str]) -> None:
    root = make.write_semantickitti(tmp_path / "07", scheme="learning")
    if not options:
        assert open_drive(root).scheme.name == "learning"
        return
    text = refusal(root, **options)
    assert text.startswith("labels: all ids are 19 or less (9, 11, 15), which looks like the learning scheme")
    assert "--label-scheme learning" in text


def test_no_road_at_all(sequence: Path) -> None:
    assert "road would be 3 (scheme custom)" in refusal(sequence, label_scheme={3})
    assert len(open_drive(sequence, label_scheme="40").ground_points(0).road) > 0
    rewrite_labels(sequence, {40: 50})
    assert "no point of the scans looked at is road: the ids are 48, 50, 70" in refusal(sequence)


def test_without_labels_the_predictions_are_used_and_named(tmp_path: Path, make: ModuleType) -> None:
    report = inspect_drive(make.write_semantickitti(tmp_path / "07", labels="predictions"))
    assert report.label_folder == "predictions"
    assert [str(each.path) for each in report.problems if "there is no labels/" in each.message] == ["predictions"]


def test_poses_of_another_drive(tmp_path: Path, make: ModuleType, caplog: pytest.LogCaptureFixture) -> None:
    """The scans go straight on, the poses turn."""
    root = make.write_semantickitti(tmp_path / "07", poses=make.lidar_poses(24, turn_rad=0.0))
    assert open_drive(root)
    turning = make.camera_poses(make.lidar_poses(30, turn_rad=0.2))
    (root / "poses.txt").write_text(make.pose_text(turning[:24]))
    (tmp_path / "07" / "times.txt").rename(tmp_path / "times.txt")
    text = refusal(root)
    assert text.startswith("poses.txt: the scans do not move as the poses do: from scan ")
    assert "Usual cause: poses of another sequence" in text
    (tmp_path / "times.txt").rename(root / "times.txt")
    (root / "poses.txt").write_text(make.pose_text(turning))
    refusal(root)
    assert "30 poses, but times.txt has 24 lines" in caplog.text


def test_poses_that_are_not_in_metres(tmp_path: Path, make: ModuleType, caplog: pytest.LogCaptureFixture) -> None:
    open_drive(make.write_semantickitti(tmp_path / "07", poses=make.lidar_poses(step_m=20.0)))
    assert "with the times of the scans it moves at 200 m/s" in caplog.text


def test_faults_of_many_scans_are_one_message(sequence: Path) -> None:
    for path in (sequence / "labels").iterdir():
        path.write_bytes(path.read_bytes() + b"\0" * 4)
    (problem,) = inspect_drive(sequence).problems
    assert problem.path == "labels/000000.label"
    assert problem.message.endswith("12 of 12 scans are like this (0, 1, 2, 3, 4 and 7 more).")
    for number, path in enumerate(sorted((sequence / "velodyne").iterdir())):
        points = np.fromfile(path, np.float32).reshape(-1, 4)[: 1600 + number, :3]  # by chance a multiple of 16, some
        np.ascontiguousarray(points).tofile(path)
    problem = inspect_drive(sequence).problems[0]
    assert problem.path == "velodyne"
    assert "all 12 scans have 12 bytes per point: x y z without remission" in problem.message


def test_sweeps_whose_sizes_fit_four_and_five_values(sequence: Path) -> None:
    """A 32-beam sensor: every size is a multiple of 16 and of 20 bytes, and the fifth value is the ring."""
    for scan in (sequence / "velodyne").iterdir():
        points = np.fromfile(scan, np.float32).reshape(-1, 4)[:1600]
        ring = np.arange(len(points)) % 32
        np.column_stack([points, ring]).astype(np.float32).tofile(scan)
        labels = sequence / "labels" / f"{scan.stem}.label"
        np.fromfile(labels, np.uint32)[:1600].tofile(labels)
    report = inspect_drive(sequence)
    assert report.ok
    assert report.points_per_scan == 1600


def test_scans_that_are_named_by_times(sequence: Path) -> None:
    for folder, suffix in (("velodyne", ".bin"), ("labels", ".label")):
        for file in sorted((sequence / folder).iterdir()):
            file.rename(file.with_name(f"{1_700_000_000_390_857_630 + int(file.stem)}{suffix}"))
    assert "is named by a time, in nanoseconds" in refusal(sequence)


def test_one_folder_per_keyframe(sequence: Path) -> None:
    for row, scan in enumerate(sorted((sequence / "velodyne").iterdir())):
        (sequence / "dump" / f"{row:06d}").mkdir(parents=True)
        scan.rename(sequence / "dump" / f"{row:06d}" / "cloud.pcd")
    assert "one .pcd file in each of 12 folders (000000, 000001, ...)" in refusal(sequence / "dump")


def test_a_georeference_that_does_not_fit(sequence: Path, make: ModuleType) -> None:
    head, *rows = [line.split(",") for line in make.geo_csv(make.lidar_poses()).splitlines()]
    swapped = [head, *([frame, lon, lat, *rest] for frame, lat, lon, *rest in rows)]
    radians = [head, *([row[0], *(str(np.radians(float(each))) for each in row[1:3]), *row[3:]] for row in rows)]
    for text, words in (
        ("\n".join(map(",".join, swapped)), "Latitude and longitude are swapped"),
        ("\n".join(map(",".join, radians)), "Latitude and longitude are in radians"),
        (make.geo_csv(make.lidar_poses(turn_rad=-0.06)), r"geo\.csv .*: describes another motion than the poses"),
    ):
        (sequence / "geo.csv").write_text(text)
        with pytest.raises(GeoreferenceError, match=words):
            open_drive(sequence)
    (sequence / "geo.csv").write_text(make.geo_csv(make.lidar_poses()))
    drive = open_drive(sequence)
    assert check_georeference(drive.T_world_lidar[:2], drive.georeference, Findings(stop_at_first=True)) is None


def test_road_that_is_not_flat_names_the_dialect(sequence: Path, make: ModuleType) -> None:
    drive = open_drive(sequence)
    wrong = dataclasses.replace(drive, T_world_lidar=make.camera_poses(drive.T_world_lidar))
    with pytest.raises(DriveError, match=r"the road is not flat.*wrong pose frame \(try 'lidar'\)"):
        check_flat_road(wrong, np.arange(12), "poses.txt", Findings(stop_at_first=True))


def test_a_hill_is_flat_enough(tmp_path: Path, make: ModuleType) -> None:
    hill = np.eye(4)
    hill[:3, :3] = [[np.cos(0.2), 0, np.sin(0.2)], [0, 1, 0], [-np.sin(0.2), 0, np.cos(0.2)]]
    root = make.write_semantickitti(tmp_path / "hill", poses=hill @ make.lidar_poses(), pose_frame="lidar")
    assert open_drive(root).pose_frame == "lidar"


def test_scans_that_start_later(tmp_path: Path, make: ModuleType) -> None:
    """One pose a scan: taken one to one; more poses: by the number of the frame."""
    root = make.write_semantickitti(tmp_path / "part", frames=list(range(100, 112)))
    drive = open_drive(root)
    np.testing.assert_allclose(drive.T_world_lidar, make.lidar_poses(), atol=1e-6)
    every = make.lidar_poses(130)
    (root / "poses.txt").write_text(make.pose_text(make.camera_poses(every)))
    relative = invert_transform(every[100]) @ every[100:112]
    np.testing.assert_allclose(open_drive(root).T_world_lidar, relative, atol=1e-6)


MILLISECONDS = "".join(f"{1000 * row}\n" for row in range(12))


@pytest.mark.parametrize(
    "text",
    ["0.0\n0.1\n", "0.0\n" * 6 + "soon\n" * 6, "".join(f"{-t}\n" for t in range(12)), "1.7e9\n" * 12, MILLISECONDS],
)
def test_times_that_do_not_fit_are_left_out(sequence: Path, text: str) -> None:
    (sequence / "times.txt").write_text(text)
    assert open_drive(sequence).times_s is None


@pytest.mark.parametrize("per_s", [1, 1e3, 1e6, 1e9])
def test_times_since_1970_may_be_in_smaller_units(sequence: Path, per_s: float) -> None:
    times_s = [1.4e9 + 600 * row for row in range(12)]  # however slow it is
    (sequence / "times.txt").write_text("".join(f"{round(each * per_s)}\n" for each in times_s))
    assert open_drive(sequence).times_s.tolist() == times_s


def test_checks_can_be_left_out(sequence: Path) -> None:
    (sequence / "labels" / "000004.label").write_bytes(b"1234")
    drive = open_drive(sequence, check=False)
    with pytest.raises(DriveError, match="1 labels for 1,725 points"):
        drive.ground_points(4)
