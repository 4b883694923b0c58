"""LAS and LAZ files as drives: one file per scan, and mobile mapping cut along its trajectory."""

import builtins
import pickle
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import Transformer
from scipy.spatial import cKDTree

import interloc
from interloc.drives.files import SourceFile
from interloc.drives.findings import Findings
from interloc.drives.folder import FolderDrive
from interloc.drives.georeference.geodetic import ecef_poses
from interloc.drives.options import DriveOptions
from interloc.drives.scans.las import mapping
from interloc.drives.scans.las.clouds import open_cloud
from interloc.drives.scans.las.mapping import cut, open_las
from interloc.errors import DriveError
from interloc.geometry import invert_transform, yaw_of
from tests.las_files import UTM32, straight_cloud, write_las, write_mapping, write_track
from tests.small_drives import level_poses


def street(folder: Path, *, name: str = "strip.laz", header: str = "time,x,y,z", **points: Any) -> Path:
    """Write a straight drive of 60 m: a cloud in which every second point is road, and its trajectory."""
    xyz, times, track = straight_cloud()
    given = {"times_s": times, "labels": np.arange(len(xyz)) % 2 * 10 + 1, "crs": UTM32, "intensity": 7, **points}
    write_las(folder / name, xyz, **given)
    write_track(folder / "trajectory.csv", track, header)
    return folder


def write_track_in_degrees(folder: Path) -> None:
    """Write the trajectory of `street` in longitudes and latitudes."""
    _, _, track = straight_cloud()
    lon, lat = Transformer.from_crs(UTM32, "EPSG:4326", always_xy=True).transform(track[:, 1], track[:, 2])
    write_track(folder / "trajectory.csv", np.column_stack([track[:, 0], lat, lon, track[:, 3]]), "time,lat,lon,alt")


def notes(folder: Path, **arguments: Any) -> list[str]:
    findings = Findings(stop_at_first=True)
    open_las(folder, DriveOptions.of(None, **arguments), findings)
    return [f"{finding.path}: {finding.message}" for finding in findings.found]


def on_grid(drive: FolderDrive, index: int) -> np.ndarray:
    """Return the road points of a scan in UTM zone 32: through its own fix."""
    fixes = drive.georeference
    points = drive.ground_points(index).road.astype(np.float64)
    ecef = ecef_poses(fixes)[index]
    world = points @ ecef[:3, :3].T + ecef[:3, 3]
    return np.stack(Transformer.from_crs("EPSG:4978", "EPSG:25832").transform(*world.T)[:2], axis=1)


# --- mobile mapping ---


def test_a_cloud_is_cut_along_its_trajectory(tmp_path: Path) -> None:
    drive = interloc.open_drive(street(tmp_path))
    assert (drive.layout, drive.scheme.name, drive.pose_frame) == ("las", "las", "lidar")
    steps = np.linalg.norm(np.diff(drive.T_world_lidar[:, :3, 3], axis=0), axis=1)
    assert 2.0 < steps.min() < steps.max() < 3.2
    np.testing.assert_allclose(np.diff(drive.times_s), steps / 10, atol=2e-3)
    points = [drive.ground_points(index) for index in range(len(drive.frames))]
    assert sum(each.road_count for each in points) == 6000  # every road point once
    assert max(np.abs(each.road[:, 0]).max() for each in points) < 1.7  # within its slice, along the drive
    np.testing.assert_allclose(points[3].road[:, 2], -2, atol=0.1)
    # The points lie where they were measured.
    xyz, _, _ = straight_cloud()
    ours = np.concatenate([on_grid(drive, index) for index in range(len(drive.frames))])
    distance, nearest = cKDTree(ours).query(xyz[1::2, :2])
    assert distance.max() < 2e-3  # the format rounds to 1 mm
    assert len(np.unique(nearest)) == 6000
    # The vehicle looks where it drives.
    convergence = -0.43  # of UTM zone 32 at 8.43 degrees east, 49 north: grid north lies to the west of true north
    np.testing.assert_allclose(np.degrees(yaw_of(drive.georeference.R_enu_lidar)), 60 - convergence, atol=0.05)
    np.testing.assert_allclose(drive.T_world_lidar[-1, 1, 3], 0, atol=0.05)


def test_trajectories_in_degrees_are_projected(tmp_path: Path) -> None:
    write_track_in_degrees(street(tmp_path))
    drive = interloc.open_drive(tmp_path)
    assert sum(drive.ground_points(index).road_count for index in range(len(drive.frames))) == 6000


def test_heights_over_the_ellipsoid_are_moved_to_those_of_the_cloud(tmp_path: Path) -> None:
    street(tmp_path)
    _, _, track = straight_cloud()
    write_track(tmp_path / "trajectory.csv", track + np.array([0, 0, 0, 47.0]))
    assert any("the ground lies 49.0 m below the trajectory" in note for note in notes(tmp_path))


def test_tum_poses_in_world_coordinates_are_a_trajectory(tmp_path: Path) -> None:
    street(tmp_path)
    (tmp_path / "trajectory.csv").unlink()
    _, _, track = straight_cloud()
    poses = np.column_stack([track, np.tile([0, 0, 0.5, np.sqrt(0.75)], (len(track), 1))])
    np.savetxt(tmp_path / "poses.txt", poses, fmt="%.9f")
    drive = interloc.open_drive(tmp_path)
    assert "poses.txt" in drive.georeference.source


def test_another_clock_is_refused_with_what_to_add(tmp_path: Path) -> None:
    street(tmp_path)
    xyz, times, track = straight_cloud(300, density=40)
    write_las(tmp_path / "strip.laz", xyz, times_s=times, labels=11, crs=UTM32)
    for seconds, said in ((18.0, r"Add -18 to the times"), (1_315_964_782.0, "take off 1315964782 where .* UNIX time")):
        write_track(tmp_path / "trajectory.csv", track + np.array([seconds, 0, 0, 0]))
        with pytest.raises(DriveError, match=rf"trajectory.csv: .*{said}"):
            interloc.open_drive(tmp_path)


@pytest.mark.parametrize(("moved", "complaint"), [
    ([1e7, 0, 0, 0], r"trajectory.csv: covers .* Expected the clock of the cloud"),
    ([0, 5000, 0, 0], r"was 5,0\d\d m away from the points of strip.laz"),
])  # fmt: skip
def test_a_trajectory_of_another_time_or_place_is_refused(tmp_path: Path, moved: list[float], complaint: str) -> None:
    street(tmp_path)
    write_track(tmp_path / "trajectory.csv", straight_cloud()[2] + moved)
    with pytest.raises(DriveError, match=complaint):
        interloc.open_drive(tmp_path)


def test_points_beyond_the_trajectory_are_left_out_and_counted(tmp_path: Path) -> None:
    street(tmp_path)
    _, _, track = straight_cloud()
    write_track(tmp_path / "trajectory.csv", track[:90])
    assert any("points (" in note and "they are left out" in note for note in notes(tmp_path))
    write_track(tmp_path / "trajectory.csv", track[:70])
    drive = interloc.open_drive(tmp_path)
    assert drive.T_world_lidar[-1, 0, 3] < 36


@pytest.mark.parametrize(
    ("points", "complaint"),
    [
        ({"times_s": None}, "the gps_time of all points looked at is 0"),
        ({"times_s": 5.0}, "the gps_time of all points looked at is 5"),
        ({"times_s": None, "point_format": 2, "version": "1.2"}, "have no gps_time .* A map cloud has no scans"),
        ({"crs": None}, "states no coordinate system, and its coordinates are those of one"),
        ({"crs": "EPSG:4326"}, "which is not projected"),
        (
            {"crs": "EPSG:2225"},
            r"in units of US survey foot. Expected metres. Reproject .* zone of the place: EPSG:326ZZ .* EPSG:327ZZ",
        ),
        ({"crs": "EPSG:25829"}, "lies outside|m away from"),
    ],
)
def test_clouds_that_cannot_be_cut_are_refused_with_the_reason(
    tmp_path: Path, points: dict[str, Any], complaint: str
) -> None:
    street(tmp_path, **points)
    if points.get("crs") == "EPSG:25829":  # the trajectory shows that the zone is another
        write_track_in_degrees(tmp_path)
    with pytest.raises(DriveError, match=complaint):
        interloc.open_drive(tmp_path)


def test_one_trajectory_is_there_or_named(tmp_path: Path) -> None:
    street(tmp_path)
    (tmp_path / "other.csv").write_bytes((tmp_path / "trajectory.csv").read_bytes())
    (tmp_path / "README.txt").write_text("Time of flight, as it was\n")
    with pytest.raises(DriveError, match=r"several trajectories: other.csv, trajectory.csv"):
        interloc.open_drive(tmp_path)
    assert interloc.open_drive(tmp_path, poses="other.csv").georeference is not None
    for name in ("other.csv", "trajectory.csv"):
        (tmp_path / name).unlink()
    with pytest.raises(DriveError, match=r"no trajectory lies beside the cloud. A map cloud has no scans"):
        interloc.open_drive(tmp_path)
    with pytest.raises(DriveError, match=r"trajectory.csv: is missing"):
        interloc.open_drive(tmp_path, poses="trajectory.csv")


@pytest.mark.parametrize(("text", "complaint"), [
    ("1 2 3\n", "starts with 3 numbers, and nothing says what they are"),
    ("time,x,y\n1,2,3\n", "has no column for z among time, x, y"),
    ("time,x,y,z\n1,2,3\n", "line 2: 3 fields; expected 4"),
    ("time,x,y,z\n1,2,3,inf\n", "line 2: holds a value that is not finite"),
    ("time,x,y,z\n", "holds a header only"),
    ("time,x,y,z\n2,0,0,0\n1,0,0,0\n", "line 3: time runs backwards"),
    ("time,lat,lon,alt\n1,95,8,0\n2,95,8,0\n", "no place to drive"),
    ("time,x,y,z\n1,2,3,4\n", "one pose only"),
    ("\0\0", "is not a text file"),
])  # fmt: skip
def test_damaged_trajectories_are_refused_in_words(tmp_path: Path, text: str, complaint: str) -> None:
    street(tmp_path)
    (tmp_path / "trajectory.csv").write_text(text)
    with pytest.raises(DriveError, match=f"trajectory.csv: .*{complaint}"):
        interloc.open_drive(tmp_path, poses="trajectory.csv")


def test_an_sbet_is_refused_with_what_makes_a_table_of_it(tmp_path: Path) -> None:
    _, _, track = straight_cloud()
    lon, lat = Transformer.from_crs(UTM32, "EPSG:4326", always_xy=True).transform(track[:, 1], track[:, 2])
    records = np.zeros((len(track), 17))
    records[:, :4] = np.column_stack([track[:, 0], np.radians(lat), np.radians(lon), np.full(len(track), 117.0)])
    (path := street(tmp_path) / "sbet.out").write_bytes(records.astype("<f8").tobytes())
    (tmp_path / "trajectory.csv").unlink()
    with pytest.raises(DriveError, match="is an SBET") as refused:
        interloc.open_drive(tmp_path)
    cure = str(refused.value).partition("in degrees: ")[2].rstrip(".").replace("FILE", repr(str(path)))
    exec(cure.replace('"track.csv"', repr(str(tmp_path / "track.csv"))), {"np": np})  # noqa: S102 - what is advised
    assert interloc.open_drive(tmp_path, poses="track.csv").georeference is not None


def test_local_coordinates_without_a_system_have_no_georeference(tmp_path: Path) -> None:
    xyz, times, track = straight_cloud()
    corner = np.array([458_000.0, 5_428_000.0, 0])
    write_las(tmp_path / "map.laz", xyz - corner, times_s=times, labels=11)
    write_track(tmp_path / "track.csv", track - np.r_[0, corner])
    write_las(tmp_path / "tile.laz", xyz - corner, times_s=times, labels=2)
    drive = interloc.open_drive(tmp_path)
    assert drive.georeference is None
    np.testing.assert_allclose(drive.T_world_lidar[-1, :3, 3], [59, 0, 0], atol=1.5)


def test_files_of_different_systems_are_refused(tmp_path: Path) -> None:
    street(tmp_path)
    xyz, times, _ = straight_cloud()
    write_las(tmp_path / "other.las", xyz, times_s=times, labels=11, crs="EPSG:25833")
    with pytest.raises(DriveError, match=r"other.las: is in ETRS89 / UTM zone 33N, and another .* UTM zone 32N"):
        interloc.open_drive(tmp_path)


def test_the_system_can_be_named(tmp_path: Path) -> None:
    street(tmp_path, crs=None)
    assert interloc.open_drive(tmp_path, crs=UTM32).georeference is not None
    with pytest.raises(DriveError, match="crs 'EPSG:1': is not known"):
        interloc.open_drive(tmp_path, crs="EPSG:1")


def test_the_number_of_files_does_not_matter(tmp_path: Path) -> None:
    """Two heads on one vehicle, and a strip of each."""
    xyz, times, track = straight_cloud(60, density=2000)
    (tmp_path / "one").mkdir()
    write_las(tmp_path / "one" / "a.las", xyz, times_s=times, labels=11, crs=UTM32)
    (tmp_path / "two" / "laz").mkdir(parents=True)
    for number in range(2):
        file = tmp_path / "two" / "laz" / f"head_{number}.laz"
        write_las(file, xyz[number::2], times_s=times[number::2], labels=11, crs=UTM32)
    for folder in ("one", "two"):
        write_track(tmp_path / folder / "track.csv", track)
    one, two = interloc.open_drive(tmp_path / "one"), interloc.open_drive(tmp_path / "two")
    np.testing.assert_array_equal(one.frames, two.frames)
    for index in (0, 7, len(one.frames) - 1):
        a, b = one.ground_points(index).road, two.ground_points(index).road
        np.testing.assert_allclose(a[np.lexsort(a.T)], b[np.lexsort(b.T)], atol=2e-3)
    assert two.scans.name(0).startswith("laz/head_0.laz and 1 more")


def test_points_in_no_order_are_refused(tmp_path: Path) -> None:
    xyz, times, track = straight_cloud()
    shuffled = np.random.default_rng(1).permutation(len(xyz))
    write_las(tmp_path / "a.las", xyz[shuffled], times_s=times[shuffled], labels=11, crs=UTM32)
    write_track(tmp_path / "track.csv", track)
    with pytest.raises(DriveError, match=r"not in the order of their times, .* Sort them by gps_time"):
        interloc.open_drive(tmp_path)


def test_scans_of_too_many_points_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mapping, "MAX_SCAN_POINTS", 300)
    with pytest.raises(DriveError, match=r"a scan has at most 300\. Thin the cloud"):
        interloc.open_drive(street(tmp_path, labels=11))


def test_withheld_points_are_not_used(tmp_path: Path) -> None:
    drive = interloc.open_drive(street(tmp_path, withheld=np.arange(12_000) < 6000))
    assert sum(drive.ground_points(index).road_count for index in range(len(drive.frames))) == 3000


@pytest.mark.parametrize(("point_format", "version"), [(1, "1.1"), (5, "1.3"), (7, "1.4")])
def test_formats_of_points(tmp_path: Path, point_format: int, version: str) -> None:
    drive = interloc.open_drive(street(tmp_path, name="a.las", point_format=point_format, version=version))
    assert sum(drive.ground_points(index).road_count for index in range(len(drive.frames))) == 6000


def test_a_vehicle_that_stands_is_one_scan(tmp_path: Path) -> None:
    street(tmp_path)
    _, _, track = straight_cloud()
    track[:, 1:] = track[60, 1:]
    write_track(tmp_path / "trajectory.csv", track)
    drive = interloc.open_drive(tmp_path)
    assert len(drive.frames) == 1
    assert 1400 < drive.ground_points(0).road_count < 1600  # within 1.5 s of the pose, which is the first
    assert any("measured while the vehicle stood, and are left out" in each for each in notes(tmp_path))


def test_clouds_without_road_say_so(tmp_path: Path) -> None:
    street(tmp_path, labels=np.arange(12_000) % 3)
    assert any(
        "no point is classified as road surface (11); the classes are 0, 1, 2" in each for each in notes(tmp_path)
    )
    with pytest.raises(DriveError, match="no road was found by geometry"):  # the points are noise
        interloc.open_drive(tmp_path)


def test_a_drive_is_cheap_to_send_and_reads_the_same_there(tmp_path: Path) -> None:
    drive = interloc.open_drive(street(tmp_path))
    data = pickle.dumps(drive)
    assert len(data) < 100_000
    there = pickle.loads(data)  # noqa: S301 - our own
    np.testing.assert_array_equal(there.ground_points(5).xyz, drive.ground_points(5).xyz)


def test_one_file_is_a_drive_too(tmp_path: Path) -> None:
    street(tmp_path)
    assert interloc.open_drive(tmp_path / "strip.laz").name == "strip"


def test_other_folders_are_not_las(tmp_path: Path) -> None:
    assert open_las(tmp_path, DriveOptions(), Findings(stop_at_first=True)) is None
    street(tmp_path)
    assert open_las(tmp_path, DriveOptions(layout="kitti_raw"), Findings(stop_at_first=True)) is None
    (tmp_path / "velodyne").mkdir()
    assert open_las(tmp_path, DriveOptions(), Findings(stop_at_first=True)) is None  # the map beside a drive
    assert open_las(tmp_path, DriveOptions(layout="las"), Findings(stop_at_first=True)) is not None
    assert open_las(tmp_path / "trajectory.csv", DriveOptions(), Findings(stop_at_first=True)) is None


def test_without_laspy_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    street(tmp_path)
    imported = builtins.__import__

    def refuse(name: str, *arguments: Any, **named: Any) -> Any:
        if name == "lazrs":
            raise ModuleNotFoundError(name, name=name)
        return imported(name, *arguments, **named)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(DriveError, match=r'needs the package lazrs .* pip install "laspy'):
        interloc.open_drive(tmp_path)


# --- slices ---


def test_sparse_poses_get_slices_between_and_keep_their_own() -> None:
    slices = cut(np.array([0.0, 1.0, 2.0]), np.array([[0.0, 0, 0], [10, 0, 0], [20, 0, 0]]))
    np.testing.assert_allclose(slices.times_s, [0, 0.25, 0.5, 0.75, 1, 1.25, 1.5, 1.75, 2])
    np.testing.assert_array_equal(slices.of(np.array([-0.2, -0.1, 0.13, 1, 2, 2.2, np.nan])), [-1, 0, 1, 4, 8, -1, -1])


def test_nothing_is_cut_in_a_long_gap() -> None:
    slices = cut(np.array([0.0, 1.0, 50.0, 51.0]), np.array([[0.0, 0, 0], [3, 0, 0], [500, 0, 0], [503, 0, 0]]))
    np.testing.assert_allclose(slices.times_s, [0, 1, 50, 51])
    np.testing.assert_array_equal(slices.of(np.array([1.0, 1.2, 49, 50])), [1, -1, -1, 2])


# --- one file per scan ---


def sensor_files(folder: Path, count: int = 12, **points: Any) -> Path:
    random = np.random.default_rng(0)
    for number in range(count):
        xyz = np.column_stack([random.uniform(-30, 30, (500, 2)), np.full(500, -1.7)])
        write_las(folder / f"scan_{number + 5:03d}.laz", xyz, **{"labels": 11, "intensity": 9, **points})
    np.savetxt(folder / "poses.txt", level_poses(3 * np.arange(count))[:, :3].reshape(-1, 12))
    return folder


def test_files_in_sensor_coordinates_are_scans(tmp_path: Path) -> None:
    drive = interloc.open_drive(sensor_files(tmp_path))
    np.testing.assert_array_equal(drive.frames, np.arange(5, 17))
    np.testing.assert_allclose(drive.T_world_lidar[:, 0, 3], 3 * np.arange(12))
    xyz = np.column_stack([np.random.default_rng(0).uniform(-30, 30, (500, 2)), np.full(500, -1.7)])
    np.testing.assert_allclose(drive.ground_points(0).road, xyz, atol=1e-3)
    assert drive.scans.name(7) == "scan_007.laz"


def test_scans_of_too_many_points_are_maps(tmp_path: Path) -> None:
    sensor_files(tmp_path)
    data = bytearray((tmp_path / "scan_005.laz").read_bytes())
    data[247:255] = struct.pack("<Q", 4_000_001)
    (tmp_path / "scan_005.laz").write_bytes(data + bytes(400_000))
    with pytest.raises(DriveError, match=r"scan_005.laz: (holds 4,000,001 points; a scan has at most|promises)"):
        interloc.open_drive(tmp_path)


# --- files that lie ---


def changed(path: Path, at: int, code: str, value: Any) -> SourceFile:
    data = bytearray(path.read_bytes())
    struct.pack_into(code, data, at, *(value if isinstance(value, tuple) else (value,)))
    path.write_bytes(data)
    return SourceFile(path, path.parent)


@pytest.mark.parametrize(("at", "code", "value", "complaint"), [
    (0, "<4s", b"PCDX", "starts with b'PCDX'"),
    (25, "<B", 7, "LAS version 1.7"),
    (104, "<B", 0x80 | 33, "is damaged .*33"),
    (96, "<I", 2**31, "points, which begin at byte 2,147,483,648"),
    (100, "<I", 2**31, "promises 2,147,483,648 records before its points"),
    (94, "<H", 100, "Incoherent header size"),
    (131, "<d", float("nan"), "with which no coordinates can be made"),
    (131, "<d", 1e300, "with which no coordinates can be made"),
    (179, "<d", float("inf"), "with which no coordinates can be made"),
    (247, "<Q", 4_000_000_000, "No cloud can be compressed that much"),
    (247, "<Q", 2**63, "at most 10,000,000,000 are read"),
    (235, "<QI", (10**9, 1), "should have records at byte 1,000,000,000"),
])  # fmt: skip
def test_headers_that_lie_are_refused(tmp_path: Path, at: int, code: str, value: Any, complaint: str) -> None:
    path = write_las(tmp_path / "a.laz", straight_cloud()[0], times_s=1.0)
    with pytest.raises(DriveError, match=complaint):
        open_cloud(changed(path, at, code, value))


def test_files_cut_short_say_how_much_is_there(tmp_path: Path) -> None:
    path = write_las(tmp_path / "a.laz", straight_cloud(600)[0], times_s=1.0)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(DriveError, match=r"a.laz: is cut short: .* About 60,000 of its 120,000 points are there"):
        open_cloud(SourceFile(path, tmp_path))
    path = write_las(tmp_path / "a.las", straight_cloud()[0], times_s=1.0)
    path.write_bytes(path.read_bytes()[:-3000])
    with pytest.raises(DriveError, match=r"promises 12,000 points of 30 bytes, but holds 11,900 of them"):
        open_cloud(SourceFile(path, tmp_path))


def test_chunks_that_lie_are_refused(tmp_path: Path) -> None:
    """The reader would make room for what the table of the chunks promises, and the sizes within each."""
    path = write_las(tmp_path / "a.laz", straight_cloud()[0], times_s=1.0)
    start = struct.unpack_from("<I", path.read_bytes(), 96)[0]
    table = struct.unpack_from("<q", path.read_bytes(), start)[0]
    with pytest.raises(DriveError, match="lists 4,000,000,000 chunks"):
        open_cloud(changed(path, table + 4, "<I", 4_000_000_000))
    changed(path, table + 4, "<I", 1)
    with pytest.raises(DriveError, match=r"the chunk at byte \d+ of [\d,]+ bytes promises 2,14\d,\d+,\d+ bytes"):
        open_cloud(changed(path, start + 8 + 30 + 4, "<I", 2**31))
    changed(path, table + 4, "<I", 0)  # then no chunk would be looked at, and 2 GB made room for
    with pytest.raises(DriveError, match=r"promises 12,000 points, and the table at byte [\d,]+ lists chunks of 0"):
        open_cloud(SourceFile(path, tmp_path))


def read_all(file: SourceFile) -> None:
    for _ in open_cloud(file).read():
        pass


def is_refused(file: SourceFile) -> bool:
    try:
        read_all(file)
    except DriveError as error:
        return str(error).startswith(file.name) or pytest.fail(f"another file is named: {error}")
    return False


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_damage_anywhere_is_a_drive_error_or_goes_unnoticed(
    tmp_path: Path, suffix: str, capfd: pytest.CaptureFixture[str]
) -> None:
    whole = write_las(tmp_path / f"whole{suffix}", straight_cloud(15)[0], times_s=1.0, crs=UTM32).read_bytes()
    random = np.random.default_rng(2)
    path = tmp_path / f"damaged{suffix}"
    refused = 0
    for attempt in range(150):
        data = bytearray(whole)
        if attempt % 3 == 0:
            data = data[: random.integers(len(data))]
        else:
            region = len(data) if attempt % 3 == 1 else 1200  # the headers
            for at in random.integers(0, region, 3):
                data[at] = random.integers(256)
        path.write_bytes(data)
        refused += is_refused(SourceFile(path, tmp_path))
    assert refused > 50
    capfd.readouterr()  # panics of Rust write there


def test_a_file_that_changes_after_opening_is_named(tmp_path: Path) -> None:
    drive = interloc.open_drive(street(tmp_path))
    path = tmp_path / "strip.laz"
    whole = path.read_bytes()
    for data in (b"", whole[:3000], whole[:40_000]):
        path.write_bytes(data)
        with pytest.raises(DriveError, match=r"strip.laz: "):
            drive.ground_points(20)
    path.unlink()
    with pytest.raises(DriveError, match=r"strip.laz: cannot be read: no such file"):
        drive.ground_points(20)


# --- the same detections ---


def test_mobile_mapping_of_the_same_scans_gives_the_same_detections(sample: FolderDrive, tmp_path: Path) -> None:
    """Compared in the world of the cloud: level, with x along the first motion; it rounds to a thousandth of 1 mm."""
    drive = interloc.open_drive(write_mapping(sample, tmp_path / "cloud", files=2, scale=1e-6))
    found = interloc.detect(drive).detections
    ecef = ecef_poses(sample.georeference)
    level = ecef[0].copy()
    level[:3, :3] = ecef[0, :3, :3] @ sample.georeference.R_enu_lidar[0].T @ drive.georeference.R_enu_lidar[0]
    expected = interloc.detect(replace(sample, T_world_lidar=invert_transform(level) @ ecef)).detections
    assert drive.times_s is not None
    np.testing.assert_array_equal(found.keyframe, expected.keyframe)
    np.testing.assert_allclose(found.world_xy, expected.world_xy, atol=1e-2)  # a point more in one cell
