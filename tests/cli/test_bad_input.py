"""Bad input: a clear line that names the file, exit code 1, nothing half-written, an older result untouched."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from interloc.cli.main import run

Refuse = Callable[..., str]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def older(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An older result."""
    out = tmp_path_factory.mktemp("older") / "out"
    assert run(["detect", str(drive), "-o", str(out), "--quiet"]) == 0
    return out


@pytest.fixture
def refuse(interloc: Callable, older: Path, short_drive: Path, osm: Path) -> Refuse:
    """Run a drive into the folder of an older result; check that it fails cleanly and return what it says."""

    def call(*options: object, drive: Path = short_drive, osm: Path = osm) -> str:
        before = contents(older)
        outcome = interloc("run", drive, "-o", older, "--osm", osm, *options)
        assert outcome.code == 1
        assert not outcome.out
        assert contents(older) == before
        assert [path.name for path in older.parent.iterdir()] == ["out"]
        complaint: str = outcome.complaint
        return complaint.removeprefix("interloc: ")

    return call


def test_truncated_scan(refuse: Refuse, short_drive: Path) -> None:
    path = short_drive / "velodyne" / "000004.bin"
    path.write_bytes(path.read_bytes()[:-7])
    assert refuse().startswith("velodyne/000004.bin: ")
    assert "which is no multiple of 16" in refuse()


def test_labels_of_another_scan(refuse: Refuse, short_drive: Path) -> None:
    path = short_drive / "labels" / "000004.label"
    path.write_bytes(path.read_bytes()[:-40])
    text = refuse()
    assert text.startswith("labels/000004.label: ")
    assert "Usual cause: labels of another sequence" in text


def test_points_that_are_not_numbers_in_a_scan_looked_into_first(refuse: Refuse, short_drive: Path) -> None:
    spoil(short_drive / "velodyne" / "000000.bin")
    assert refuse().startswith("velodyne/000000.bin: point ")


def test_points_that_are_not_numbers_in_the_middle_of_the_run(
    refuse: Refuse, short_drive: Path, interloc: Callable
) -> None:
    """Only some scans are looked into before the work; the others speak up when they are read."""
    spoil(short_drive / "velodyne" / "000005.bin")
    text = refuse("--set", "keyframes.distance_m=0.1")
    assert text.startswith("velodyne/000005.bin: point ")
    assert "is not finite" in text
    assert interloc("info", short_drive, "--thorough").code == 1


def spoil(path: Path) -> None:
    points = np.fromfile(path, np.float32).reshape(-1, 4)
    labels = np.fromfile(path.parents[1] / "labels" / f"{path.stem}.label", np.uint32)
    points[np.flatnonzero(labels == 40)[7], 2] = np.nan
    points.tofile(path)


def test_pose_line_with_11_numbers(refuse: Refuse, short_drive: Path) -> None:
    path = short_drive / "poses.txt"
    lines = path.read_text().splitlines()
    lines[7] = lines[7].rsplit(" ", 1)[0]
    path.write_text("\n".join(lines))
    assert refuse().startswith("poses.txt: line 8: 11 numbers; expected 12")


def test_lidar_poses_declared_as_camera_poses(refuse: Refuse, drive: Path) -> None:
    poses = np.tile(np.eye(4), (210, 1, 1))
    poses[:, 0, 3] = 0.6 * np.arange(210)
    short = drive.parent / "lidar_poses"
    if not short.exists():
        short.mkdir()
        for name in ("velodyne", "labels", "calib.txt", "geo.csv"):
            (short / name).symlink_to(drive / name)
        np.savetxt(short / "poses.txt", poses[:, :3].reshape(-1, 12))
    text = refuse("--pose-frame", "camera", drive=short)
    assert text.startswith("poses.txt: ")
    assert "they are those of the LiDAR" in text


def test_camera_poses_declared_as_lidar_poses(refuse: Refuse, drive: Path) -> None:
    text = refuse("--pose-frame", "lidar", drive=drive)
    assert text.startswith("poses.txt: ")
    assert "they are those of the camera" in text


def test_learning_ids_instead_of_raw_ids(refuse: Refuse, short_drive: Path, interloc: Callable) -> None:
    for path in (short_drive / "labels").iterdir():
        ids = np.zeros(256, np.uint32)
        ids[[40, 48, 72]] = 9, 11, 17
        ids[np.fromfile(path, np.uint32)].tofile(path)
    text = refuse("--label-scheme", "semantickitti")
    assert "looks like the learning scheme" in text
    assert "--label-scheme learning" in text
    assert "scheme learning" in interloc("info", short_drive).out


def test_missing_frame_in_the_middle(refuse: Refuse, short_drive: Path) -> None:
    (short_drive / "velodyne" / "000003.bin").unlink()
    (short_drive / "labels" / "000003.label").unlink()
    assert refuse().startswith("velodyne: 1 scans are missing between 0 and 15 (3)")


def test_empty_drive(refuse: Refuse, short_drive: Path, tmp_path: Path) -> None:
    for path in (short_drive / "velodyne").iterdir():
        path.unlink()
    assert refuse().startswith("velodyne: holds no .bin file")
    (tmp_path / "empty").mkdir()
    assert "is an empty folder" in refuse(drive=tmp_path / "empty")
    assert "does not exist" in refuse(drive=tmp_path / "none")


def test_map_with_a_doctype(refuse: Refuse, osm: Path, tmp_path: Path) -> None:
    path = tmp_path / "bomb.osm"
    declaration = '<!DOCTYPE osm [<!ENTITY a "aaaaaaaaaa">]>'
    path.write_text(osm.read_text().replace('<osm version="0.6">', f'{declaration}<osm version="0.6">'))
    text = refuse(osm=path)
    assert "bomb.osm: declares a DOCTYPE" in text


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("cut.osm", b'<?xml version="1.0"?><osm version="0.6"><node id="1" la', "is damaged"),
        ("empty.osm", b"", "is empty"),
        ("cut.osm.gz", b"\x1f\x8b\x08\x00\x00\x00\x00\x00", "cut.osm.gz"),
        ("text.osm.pbf", b"hello", "text.osm.pbf"),
    ],
)
def test_map_that_is_damaged(name: str, content: bytes, says: str, refuse: Refuse, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    text = refuse(osm=tmp_path / name)
    assert name in text
    assert says in text


def test_map_that_is_not_there(refuse: Refuse, tmp_path: Path) -> None:
    assert "none.osm: no such file" in refuse(osm=tmp_path / "none.osm")


def test_a_clipped_map_works_with_a_note(interloc: Callable, drive: Path, osm: Path, tmp_path: Path) -> None:
    clipped = tmp_path / "clipped.osm"
    clipped.write_text("\n".join(line for line in osm.read_text().splitlines() if '<node id="5"' not in line))
    outcome = interloc("run", drive, "-o", tmp_path / "out", "--osm", clipped)
    assert outcome.code == 0
    assert "clipped.osm: 1 highways refer to nodes outside the extract and were cut" in outcome.err
    assert "1 of 1" in outcome.out


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("frame,lat_deg\n0,49\n", "geo.csv"),
        ("1 2 3\n", "georeference"),
        (None, "does not exist"),
    ],
)
def test_a_georeference_that_cannot_be_read(content: str | None, says: str, refuse: Refuse, tmp_path: Path) -> None:
    path = tmp_path / "geo.csv" if content and "," in content else tmp_path / "georeference.txt"
    if content is not None:
        path.write_text(content)
    assert says in refuse("--oxts", path)
