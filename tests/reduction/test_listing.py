"""Which drives a folder holds, told from paths and sizes."""

from typing import Any

import pytest

from interloc.reduction.listing import ListedDrive, find_drives, reason_for_none


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
        ([], "is empty"),
        (["a.txt"], "is not a drive"),
    ],
)
def test_a_folder_that_is_not_a_drive_is_explained(paths: list[str], words: str) -> None:
    files = listing(*paths)
    assert find_drives(files, "picked") == []
    assert words in reason_for_none(files, "picked")


def test_what_only_its_capitals_keep_from_being_read_is_named() -> None:
    files = {"velodyne/000000.bin": 1600, "POSES.TXT": 10, "Geo.csv": 10, "README.TXT": 3, "LABELS/000000.LABEL": 4}
    (drive,) = find_drives(files, "x")
    expected = {"POSES.TXT": "poses.txt", "Geo.csv": "geo.csv", "LABELS/000000.LABEL": "labels/000000.label"}
    assert (drive.misnamed, drive.small) == (expected, {})
    (cloud,) = find_drives({"000000.pcd": 1600, "Trajectory.TUM": 10}, "x")
    assert cloud.misnamed == {"Trajectory.TUM": "trajectory.tum"}
    assert "under names in capitals" in reason_for_none({"VELODYNE/000000.BIN": 1600}, "x")
