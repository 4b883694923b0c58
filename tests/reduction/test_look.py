"""A look at a folder by its listing: which drives it holds, what belongs to each, what is wrong and what to send."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interloc.config import KeyframeConfig
from interloc.drives.inspect import inspect_drive
from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions
from interloc.reduction import look as look_module
from interloc.reduction.listing import ListedDrive, find_drives, reason_for_none
from interloc.reduction.look import DriveLook, look_into
from interloc.reduction.reduce import prepare_reduction, reduce_drive
from tests.pcd_files import write_pcd
from tests.small_drives import lidar_poses, oxts_lines, pose_text, write_kitti_raw, write_semantickitti


def look_at(
    root: Path,
    options: Callable[[Path, str], DriveOptions] | None = None,
    *,
    keyframes: KeyframeConfig | None = KeyframeConfig(),  # noqa: B008 - frozen
    label_counts: dict[Any, dict[int, int]] | None = None,
) -> DriveLook:
    """Look as a client does: first at names, then with what is wanted."""
    listing = {path.relative_to(root).as_posix(): path.stat().st_size for path in root.rglob("*") if path.is_file()}
    chosen = options or (lambda _, name: DriveOptions(name=name))
    first = look_into(listing, {}, root.name, options=chosen).drive
    contents = {path: (root / path).read_bytes()[:size] for path, size in first.wanted.items()}
    counts = label_counts or {}
    again = look_into(listing, contents, root.name, options=chosen, keyframes=keyframes, label_counts=counts).drive
    assert again.wanted == {}
    return again


def errors(look: DriveLook) -> list[str]:
    return [f"{each.path} {each.message}" for each in look.problems if each.severity == "error"]


def test_a_look_finds_what_reading_the_drive_finds(drive: Path) -> None:
    look, report = look_at(drive), inspect_drive(drive)
    reduction = prepare_reduction(drive, keyframes=KeyframeConfig())
    plan = reduction.plan
    assert (look.layout, look.pose_frame) == (report.layout, report.pose_frame)
    assert (look.scans.count, look.scans.size_bytes) == (report.scans, report.scan_bytes)
    assert look.scans.runs == [(0, 12)]
    assert look.labels["labels"].size_bytes == report.label_bytes
    assert look.points_per_scan == report.points_per_scan
    assert look.track.length_m == report.length_m
    assert look.keyframes == len(plan.kept)
    assert look.frames_to_look_into == [0, 3, 6, 8, 11]
    assert errors(look) == []
    assert look.plan.manifest == plan.manifest.with_labels([], reduction.manifest.source)
    assert (look.plan.scans, look.plan.kept) == (12, [(0, 1), (3, 1), (6, 1), (9, 1)])
    every = look_at(drive, keyframes=None).plan
    assert (every.kept, every.manifest.keyframes) == ([(0, 12)], None)


def test_counted_label_ids_tell_what_they_mean(drive: Path) -> None:
    counts = {"labels": {9: 100, 11: 60, 15: 40}}
    look = look_at(drive, label_counts=counts)
    labels = look.labels["labels"]
    assert (labels.scheme, labels.road, labels.confusable) == ("learning", [9], [10, 11, 12])
    assert (labels.road_share, labels.ground_share) == (0.5, 0.8)
    assert [problem.severity for problem in labels.problems] == ["note"]
    (written,) = look.plan.manifest.labels
    assert (written.folder, written.scheme, written.counts) == ("labels", "learning", counts["labels"])
    bare = look_at(drive, label_counts={"labels": {70: 5}}).labels["labels"]
    assert bare.road_share == 0
    assert "no point of the scans looked at is road" in bare.problems[0].message
    declared = look_at(
        drive, lambda _, name: DriveOptions(name=name, label_scheme="semantickitti"), label_counts=counts
    )
    assert [problem.severity for problem in declared.labels["labels"].problems] == ["error"]
    assert look_at(drive, label_counts={"labels": {}}).labels["labels"].scheme is None


def test_a_part_of_a_drive_is_planned(drive: Path) -> None:
    def plan_for(part: str) -> DriveLook:
        return look_at(drive, lambda _, name: DriveOptions(name=name, frames=part))

    plan = plan_for("3:9").plan
    assert (plan.scans, plan.kept, plan.manifest.scans) == (6, [(3, 1), (6, 1)], [(3, 6)])
    (problem,) = errors(plan_for("12:"))
    assert "has no scan in the part 12:" in problem


def test_a_georeference_from_elsewhere_is_part_of_the_plan(tmp_path: Path) -> None:
    root = write_semantickitti(tmp_path / "files")
    (root / "georeference").mkdir()
    rows = oxts_lines(lidar_poses(), T_lidar_imu=np.eye(4))
    (root / "georeference/gnss.txt").write_text("\n".join(rows) + "\n")
    look = look_at(root, lambda place, _: DriveOptions(oxts=place / "georeference/gnss.txt", name="08"))
    assert (look.plan.manifest.name, look.plan.manifest.files.oxts) == ("08", "georeference/gnss.txt")
    assert look.georeference == "georeference/gnss.txt, lever arm as published by KITTI"
    raw = write_kitti_raw(root / "georeference/2011_09_26_drive_0001_sync", poses=lidar_poses())
    for folder in ("velodyne_points", "labels"):
        shutil.rmtree(raw / folder)
    by_raw = look_at(root, lambda place, _: DriveOptions(oxts=place / "georeference" / raw.name)).plan
    oxts = by_raw.manifest.files.oxts
    assert by_raw.files[f"{oxts}/0000000011.txt"] == f"georeference/{raw.name}/oxts/data/0000000011.txt"
    (root / "geo.csv").write_text("frame\n")
    bad = look_at(root)
    assert "no column lat_deg" in (bad.georeference_reason or "")
    assert bad.plan is not None  # the rest of it stands


def test_the_track_is_that_of_the_georeference(tmp_path: Path) -> None:
    root = write_kitti_raw(tmp_path / "2011_09_26_drive_0001_sync", poses=lidar_poses())
    by_oxts = look_at(root)
    assert by_oxts.layout == "kitti_raw"
    assert by_oxts.track.local is False
    fixes = open_drive(root).georeference
    np.testing.assert_allclose(by_oxts.track.positions, np.stack([fixes.lon_deg, fixes.lat_deg], axis=1), atol=1e-8)


def test_what_is_missing_or_does_not_fit_is_listed_by_name(tmp_path: Path) -> None:
    root = write_semantickitti(tmp_path / "07")
    size = (root / "velodyne/000001.bin").stat().st_size
    (root / "labels/000002.label").unlink()
    (root / "labels/000001.label").write_bytes(bytes(8))
    (root / "velodyne/000003.bin").write_bytes(bytes(50))
    (root / "poses.txt").unlink()
    look = look_at(root)
    (first,) = errors(look)
    assert first.startswith("velodyne/000003.bin 50 bytes, which is no multiple of 16")
    assert look.has_poses is False
    assert "they are computed from the points" in next(
        each.message for each in look.problems if each.path == "poses" and each.severity == "warning"
    )
    missing, wrong = (f"{each.path} {each.message}" for each in look.labels["labels"].problems)
    assert missing.startswith("labels/000002.label is missing: 1 of 12 scans have no labels (2).")
    assert wrong.startswith(f"labels/000001.label 2 labels for {size // 16:,} points in velodyne/000001.bin.")
    assert (look.track, look.plan) == (None, None)


def test_pcd_files_without_a_field_for_the_label_are_named(tmp_path: Path) -> None:
    points = np.ones((5, 4), np.float32)
    for frame in (9, 10):
        write_pcd(tmp_path / f"{frame}.pcd", points)
    (tmp_path / "poses.txt").write_text(pose_text(lidar_poses(2)))
    look = look_at(tmp_path)
    assert (look.layout, look.carries_labels, look.pose_files) == ("pcd", False, ["poses.txt"])
    (only,) = look.unlabelled
    assert only.path == "9.pcd"
    assert only.message.startswith("has no label: its fields are x, y, z, intensity. Expected one of semantic,")
    assert list(look.whole) == ["9.pcd", "10.pcd"] or set(look.whole) == {"9.pcd", "10.pcd"}
    write_pcd(tmp_path / "9.pcd", points, np.full(5, 40, np.uint32))
    labelled = look_at(tmp_path)
    assert labelled.carries_labels
    assert labelled.unlabelled == []
    assert labelled.track is not None


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"a.mcap": 9}, []),
        ({"a_0.mcap": 9, "a_1.mcap": 9}, []),
        ({"a.bag": 0}, ["a.bag is empty"]),
        ({"a.mcap": 9, "b.mcap": 9}, ["picked holds several bags (a.mcap, b.mcap)"]),
        ({"a.laz": 9, "times.txt": 9}, ["trajectory is missing. Expected a file with where the LiDAR was"]),
        ({"a.laz": 9, "poses.txt": 9}, []),
    ],
)
def test_what_is_wrong_with_recordings_is_told_from_their_names(files: dict[str, int], expected: list[str]) -> None:
    contents = {name: b"x y z\n123" for name in files if name.endswith(".txt")}
    look = look_into(files, contents, "picked").drive
    found = errors(look)
    assert len(found) == len(expected)
    assert all(text.startswith(start) for text, start in zip(found, expected, strict=True))
    assert look.whole == {name: name for name in files if not name.endswith(".txt")}


def test_tables_beside_clouds_are_opened_where_their_contents_are_given(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of very many files the others cost nothing."""
    opened: list[str] = []
    is_track = look_module.is_track
    monkeypatch.setattr(look_module, "is_track", lambda path: opened.append(path.name) or is_track(path))
    files = {"a.las": 10**8, **{f"{number}.csv": 19 for number in range(1000)}}
    look = look_into(files, {"7.csv": b"time,x,y,z\n1,2,3,4\n"}, "picked").drive
    assert opened == ["7.csv"]
    assert look.pose_files == ["7.csv"]


def test_a_reduced_drive_is_checked_by_its_manifest(drive: Path, tmp_path: Path) -> None:
    reduced = tmp_path / "reduced"
    reduce_drive(drive, reduced, keyframes=KeyframeConfig())
    look = look_at(reduced)
    assert (look.layout, len(look.whole), errors(look)) == ("reduced", 4, [])
    assert look.track is not None
    (reduced / "ground/labels/000003.ground").unlink()
    (error,) = errors(look_at(reduced))
    assert error.startswith("ground/labels/000003.ground is missing: 1 of 4 scans that were kept")
    (reduced / "reduced.json").write_text("{}")
    assert errors(look_at(reduced))


def test_messages_do_not_tell_where_the_drive_was_laid_out(drive: Path) -> None:
    look = look_at(drive, lambda place, name: DriveOptions(name=name, oxts=place / "georeference/07.txt"))
    (error,) = errors(look)
    assert error.startswith("georeference/07.txt does not exist")
    assert "interloc-look" not in look.model_dump_json()


def test_a_drive_of_too_many_files_is_not_laid_out(drive: Path) -> None:
    files = {f"velodyne/{frame:06d}.bin": 16 for frame in range(20)}
    look = look_into(files, {}, drive.name, max_files=19).drive
    assert errors(look) == ["files 20 are too many; expected at most 19. Cut the drive."]


def test_a_name_that_is_file_and_folder_is_a_problem() -> None:
    files = {"velodyne/000000.bin": 16, "oxts/1.txt": 4, "oxts/1.txt/2.txt": 4}
    look = look_into(files, {}, "odd").drive
    assert errors(look)


def listing(*paths: str, size: int = 9) -> dict[str, int]:
    return dict.fromkeys(paths, size)


def the_one(files: dict[str, int], name: str = "picked") -> ListedDrive:
    (drive,) = find_drives(files, name)
    return drive


def test_a_semantickitti_sequence_is_found_with_all_its_parts() -> None:
    small = ("poses.txt", "calib.txt", "times.txt", "geo.csv")
    drive = the_one(
        listing("velodyne/000000.bin", "labels/000000.label", *small, "map.osm.gz", "image_2/000000.png"), "07"
    )
    assert (drive.root, drive.name, drive.kind) == ("", "07", "bin")
    assert list(drive.scans) == ["velodyne/000000.bin"]
    assert list(drive.labels) == ["labels/000000.label"]
    assert set(drive.small) == set(small)


def test_recordings_are_found_with_what_lies_beside_them() -> None:
    def found(*paths: str) -> tuple[Any, ...]:
        drive = the_one(listing(*paths))
        return drive.kind, drive.root, list(drive.scans), list(drive.small)

    bag = found("a/drive_0.db3", "a/drive_1.db3", "a/metadata.yaml", "a/notes.md")
    assert bag == ("rosbag", "a", ["drive_0.db3", "drive_1.db3"], ["metadata.yaml"])
    assert found("las/1.laz", "las/2.LAZ", "track.out", "map.osm") == (
        "las", "", ["las/1.laz", "las/2.LAZ"], ["track.out"],
    )  # fmt: skip
    for place in ("", "pcd/", "clouds/", "velodyne/", "velodyne_points/data/"):
        scans = [f"{place}a_1.pcd", f"{place}a_2.pcd.bin"]
        paths = [f"07/{path}" for path in (*scans, "poses.tum", "oxts/1.txt")]
        assert found(*paths) == ("pcd", "07", scans, ["poses.tum", "oxts/1.txt"])


def test_what_lies_in_or_around_a_drive_belongs_to_it() -> None:
    assert the_one({"drive.bag": 90, "map.pcd": 20}).kind == "rosbag"  # the larger of two kinds
    assert the_one({"07/velodyne/000000.bin": 48, "map.pcd": 20, "07/drive.bag": 90}).kind == "bin"
    around = find_drives({"07/velodyne/000000.bin": 48, "map.pcd": 20, "drive.bag": 90}, "x")
    assert [(each.root, each.kind) for each in around] == [("", "rosbag"), ("07", "bin")]


def test_several_drives_are_told_apart_each_with_its_own_files() -> None:
    first, second = find_drives(
        listing(
            *(
                "sequences/00/velodyne/000000.bin",
                "sequences/07/velodyne/000000.bin",
                "sequences/07/velodyne/000001.bin",
            ),
            *("sequences/00/poses.txt", "sequences/07/calib.txt", "poses/07.txt", "README.md"),
        ),
        "data",
    )
    assert [(each.root, each.name, len(each.scans)) for each in (first, second)] == [
        ("sequences/00", "00", 1),
        ("sequences/07", "07", 2),
    ]
    assert first.small == {"poses.txt": "sequences/00/poses.txt"}
    assert second.small == {"calib.txt": "sequences/07/calib.txt", "poses.txt": "poses/07.txt"}
    assert second.borrowed == ["poses/07.txt is taken as poses.txt."]


def test_a_kitti_raw_drive_takes_the_calibration_of_its_day() -> None:
    root = "2011_09_26_drive_0001_sync"
    own = ("oxts/data/0000000000.txt", "oxts/dataformat.txt", "velodyne_points/timestamps.txt")
    day = ("calib_imu_to_velo.txt", "calib_velo_to_cam.txt")
    paths = [f"{root}/{path}" for path in ("velodyne_points/data/0000000000.bin", *own)]
    drive = the_one(listing(*paths, *day), "2011_09_26")
    assert set(drive.small) == {*own, *day}
    assert drive.borrowed == [f"{path} is taken with it." for path in day]


def test_the_root_of_kitti_360_is_its_drives_each_with_its_poses_oxts_and_calibration() -> None:
    names = ["2013_05_28_drive_0000_sync", "2013_05_28_drive_0002_sync"]
    first, second = find_drives(
        listing(
            *(f"data_3d_raw/{name}/velodyne_points/data/0000000007.bin" for name in names),
            "calibration/calib_cam_to_velo.txt",
            f"data_poses/{names[1]}/poses.txt",
            f"data_poses/{names[1]}/oxts/data/0000000000.txt",
            f"data_poses_oxts/{names[1]}/oxts/timestamps.txt",
            f"data_poses_oxts/{names[1]}/oxts/dataformat.md",
        ),
        "KITTI-360",
    )
    assert [first.name, second.name] == names
    assert set(first.small) == {"calibration/calib_cam_to_velo.txt"}
    assert set(second.small) == {
        "calibration/calib_cam_to_velo.txt",
        f"data_poses/{names[1]}/oxts/data/0000000000.txt",
        f"data_poses/{names[1]}/oxts/timestamps.txt",
        f"data_poses/{names[1]}/poses.txt",
    }
    assert f"data_poses/{names[1]}/ is taken with it: 2 files." in second.borrowed


def test_a_reduced_drive_is_its_ground_points_and_small_files() -> None:
    ground = ("ground/labels/000000.ground", "ground/predictions/000000.ground")
    drive = the_one(listing("reduced.json", *ground, "poses.txt", "oxts/data/0.txt", "map.osm.gz"))
    assert drive.kind == "reduced"
    assert set(drive.scans) == set(ground)
    assert set(drive.small) == {"reduced.json", "poses.txt", "oxts/data/0.txt"}


@pytest.mark.parametrize(
    ("paths", "words"),
    [
        (["000000.bin"], "the scans themselves: give the folder above it"),
        (["x/data.zip"], "holds an archive"),
        (["drive.mcap.zst"], "compressed as a whole: unpack it first"),
        (["labels/000000.label"], "labels but no scans"),
        (["data_poses/a/poses.txt"], "holds poses but no scans: give the root of KITTI-360"),
        (["map.osm.pbf"], "is a map alone"),
        ([], "holds no scans"),
        (["a.txt"], "is not a drive"),
    ],
)
def test_a_folder_that_is_not_a_drive_is_explained(paths: list[str], words: str) -> None:
    files = listing(*paths)
    assert find_drives(files, "picked") == []
    assert words in reason_for_none(files, "picked")
    other = look_into(listing("a/velodyne/000000.bin"), {}, "picked", root="b")
    assert other.reason == "no drive is in 'b'; they are in 'a'."


def test_what_only_its_capitals_keep_from_being_read_is_named() -> None:
    files = {"velodyne/000000.bin": 1600, "POSES.TXT": 10, "Geo.csv": 10, "README.TXT": 3, "LABELS/000000.LABEL": 4}
    (drive,) = find_drives(files, "x")
    expected = {"POSES.TXT": "poses.txt", "Geo.csv": "geo.csv", "LABELS/000000.LABEL": "labels/000000.label"}
    assert (drive.misnamed, drive.small) == (expected, {})
    (cloud,) = find_drives({"000000.pcd": 1600, "Trajectory.TUM": 10}, "x")
    assert cloud.misnamed == {"Trajectory.TUM": "trajectory.tum"}
    assert "under names in capitals" in reason_for_none({"VELODYNE/000000.BIN": 1600}, "x")
