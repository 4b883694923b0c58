"""The files of reduced drives: complete, bounded, as they are described, and nothing in them is trusted."""

import json
import pickle
import shutil
import struct
import zlib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import interloc.drives.scans.reduced_format as described
from interloc.config import KeyframeConfig, preset
from interloc.detection.keyframes import select_keyframes
from interloc.drive import Drive, GroundPoints
from interloc.drives.inspect import inspect_drive
from interloc.drives.labels import LEARNING, SCHEMES, LabelScheme
from interloc.drives.open import open_drive
from interloc.drives.scans.reduced_format import (
    MAX_BYTES,
    MAX_MANIFEST_BYTES,
    MAX_POINTS,
    ReducedLabels,
    decode_ground,
    encode_ground,
    from_runs,
    make_manifest,
    parse_manifest,
    read_manifest,
    to_runs,
)
from interloc.errors import DriveError, GeoreferenceError
from interloc.pipeline import detect

FIELDS: dict[str, Any] = {
    "name": "07",
    "layout": "semantickitti",
    "scans": [[0, 10]],
    "kept": [[0, 1], [4, 2]],
    "keyframes": {"distance_m": 2.0, "angle_deg": 5.0},
    "pose_frame": "camera",
    "pose_frame_reason": "it looks ahead",
    "files": {"poses": "poses.txt", "calibration": ["calib.txt"]},
    "labels": [{"folder": "labels", "scheme": "semantickitti", "road": [40, 60], "counts": {"40": 7}}],
}


def parse(**changes: Any) -> Any:
    head = {"format": "interloc-reduced-drive", "format_version": 1}
    return parse_manifest(json.dumps({**head, **FIELDS, **changes}).encode())


@given(st.sets(st.integers(0, 300)))
def test_runs_are_the_numbers_again(numbers: set[int]) -> None:
    ascending = np.array(sorted(numbers), np.int64)
    runs = to_runs(ascending)
    np.testing.assert_array_equal(from_runs(runs), ascending)
    assert all(a + count < b for (a, count), (b, _) in pairwise(runs))


def test_a_manifest_comes_back_as_it_was() -> None:
    manifest = make_manifest(FIELDS)
    assert parse_manifest(manifest.to_bytes()) == manifest
    assert manifest.frames.tolist() == list(range(10))
    assert manifest.kept_frames.tolist() == [0, 4, 5]
    assert str(manifest.keyframes) == "keyframes of 2 m, 5 degrees"


@pytest.mark.parametrize("scheme", [*SCHEMES.values(), LabelScheme("custom", frozenset({3, 40}))])
def test_label_schemes_come_back_as_they_were(scheme: LabelScheme) -> None:
    assert ReducedLabels.of("labels", scheme, {40: 1}).label_scheme == scheme


def test_a_scheme_that_only_has_the_name_of_a_known_one() -> None:
    labels = ReducedLabels(folder="labels", scheme="learning", road=[7])
    assert labels.label_scheme != LEARNING
    assert labels.label_scheme.road == {7}


DAMAGED: dict[str, tuple[dict[str, Any], str]] = {
    "another format": ({"format": "something"}, r"format: Input should be 'interloc-reduced-drive'"),
    "a later version": ({"format_version": 2}, "format_version: Input should be 1"),
    "an unknown field": ({"more": 1}, "more: Extra inputs are not permitted"),
    "no name": ({"name": ""}, "name: "),
    "a name that is a path": ({"name": "../07"}, "name: expected the name of a drive"),
    "a name of two lines": ({"name": "0\n7"}, "name: expected the name of a drive"),
    "runs that overlap": ({"scans": [[0, 8], [7, 3]]}, "scans: scan numbers must ascend"),
    "runs out of order": ({"kept": [[5, 1], [0, 1]]}, "kept: scan numbers must ascend"),
    "more than memory": ({"scans": [[0, 10**15]]}, r"scans\.0\.1: Input should be less than or equal to 1000000"),
    "kept what is none": ({"kept": [[9, 2]]}, "kept: holds numbers that are not among the scans"),
    "settings that are none": ({"keyframes": {"distance_m": "NaN", "angle_deg": 5}}, r"keyframes\.distance_m: "),
    "no poses": ({"files": {}}, "files.poses: expected a file, or pose_frame 'oxts'"),
    "an unknown label folder": ({"labels": [{**FIELDS["labels"][0], "folder": "../x"}]}, r"labels\.0\.folder: "),
    "a label folder twice": ({"labels": FIELDS["labels"] * 2}, "labels: a folder comes twice"),
    "an id that is none": ({"labels": [{**FIELDS["labels"][0], "road": [65536]}]}, r"labels\.0\.road\.0: "),
}


@pytest.mark.parametrize(("changes", "words"), DAMAGED.values(), ids=DAMAGED)
def test_damage_is_named(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(DriveError, match=rf"^reduced\.json: {words}"):
        parse(**changes)


@pytest.mark.parametrize(
    "path",
    ["/etc/passwd", "../poses.txt", "a/../../b", "a//b", "./poses.txt", "C:/poses.txt", "a\\b", "a\0b", "", "a/"],
)
def test_no_path_leads_out(path: str) -> None:
    for role in ("poses", "times", "oxts", "geo"):
        with pytest.raises(DriveError, match=rf"^reduced\.json: files\.{role}: "):
            parse(files={"poses": "poses.txt", role: path})
    with pytest.raises(DriveError, match=r"^reduced\.json: files\.calibration\.0: "):
        parse(files={"poses": "poses.txt", "calibration": [path]})


def test_no_link_leads_out(reduced: Path, tmp_path: Path) -> None:
    (reduced / "poses.txt").rename(tmp_path / "elsewhere.txt")
    (reduced / "poses.txt").symlink_to(tmp_path / "elsewhere.txt")
    with pytest.raises(DriveError, match=r"^poses\.txt: is a link that leads out of the folder"):
        open_drive(reduced)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"format"', "\xff\xfe", "[" * 100_000])
def test_what_is_no_json_object(reduced: Path, text: str) -> None:
    (reduced / "reduced.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(DriveError, match=r"^reduced\.json: .*Expected the manifest of a reduced drive"):
        open_drive(reduced)


def test_a_manifest_that_is_too_large(reduced: Path) -> None:
    with (reduced / "reduced.json").open("ab") as file:
        file.truncate(MAX_MANIFEST_BYTES + 1)
    with pytest.raises(DriveError, match=r"^reduced\.json: is larger than 32 MB"):
        read_manifest(reduced)


def test_an_example_of_the_format_is_one() -> None:
    """The one in the description of the format."""
    text = described.__doc__ or ""
    example = text[text.index('{\n      "format"') : text.rindex("}") + 1]
    assert parse_manifest(example.encode()).kept_frames.tolist() == [0, 19, 31]


FINITE = st.floats(width=32, allow_nan=False, allow_infinity=False, allow_subnormal=True)
NAME = "ground/labels/000003.ground"


GROUND = GroundPoints(np.arange(18, dtype=np.float32).reshape(-1, 3) / 7 - 1, 4)


def file(planes: bytes, *, count: int = 6, road: int = 4, version: int = 1) -> bytes:
    return struct.pack("<4sIII", b"ILGP", version, count, road) + zlib.compress(planes)


@given(st.data())
def test_every_finite_float_comes_back_bit_by_bit(data: st.DataObject) -> None:
    xyz = data.draw(arrays.arrays(np.float32, st.tuples(st.integers(0, 30), st.just(3)), elements=FINITE))
    road = data.draw(st.integers(0, len(xyz)))
    again = decode_ground(encode_ground(GroundPoints(xyz, road)), NAME)
    assert again.xyz.tobytes() == xyz.tobytes()
    assert (again.xyz.shape, again.xyz.dtype, again.road_count) == (xyz.shape, np.float32, road)


def test_the_bytes_are_those_of_the_format() -> None:
    """Two points, worked out by hand: bits of 1.0 are 3f800000, of 2.0 40000000; their difference is 00800000."""
    xyz = np.array([[1.0, 0.0, 2.0], [2.0, 0.0, 1.0]], np.float32)
    data = encode_ground(GroundPoints(xyz, 2))
    assert data[:16] == b"ILGP" + bytes([1, 0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0])
    x, y, z = (0x7F000000, 0x01000000), (0, 0), (0x80000000, 0x00FFFFFF)
    planes = [value >> shift & 0xFF for shift in (24, 16, 8, 0) for axis in (x, y, z) for value in axis]
    assert zlib.decompress(data[16:]) == bytes(planes)


@pytest.mark.parametrize(
    "points",
    [
        GroundPoints(np.zeros((3, 3), np.float64), 1),  # type: ignore[arg-type]
        GroundPoints(np.zeros((3, 4), np.float32), 1),
        GroundPoints(np.zeros((3, 3), np.float32), 4),
    ],
)
def test_what_is_no_scan_is_not_written(points: GroundPoints) -> None:
    with pytest.raises(ValueError, match=r"expected \(N, 3\) float32"):
        encode_ground(points)


def test_no_scan_is_that_large() -> None:
    with pytest.raises(ValueError, match="4,000,001 ground points; no scan has more than 4,000,000"):
        encode_ground(GroundPoints(np.zeros((MAX_POINTS + 1, 3), np.float32), 0))
    with pytest.raises(DriveError, match="is larger than 51 MB, which the ground points of one scan never are"):
        decode_ground(bytes(MAX_BYTES + 1), NAME)


SOUND = encode_ground(GROUND)
NAN = np.full((6, 3), 1.0, np.float32)
NAN[4, 1] = np.nan

DAMAGED_GROUND = {
    "empty": (b"", r"is empty\. Usual cause: an upload or copy that did not finish"),
    "head only": (SOUND[:16], "holds 16 bytes; expected at least 24"),
    "cut short": (SOUND[:-30], r"is damaged: its 6 points unpack to \d+ of 72 bytes"),
    "checksum cut": (SOUND[:-1], "is damaged: the end of its 6 points is missing"),
    "one bit turned": (SOUND[:-1] + bytes([SOUND[-1] ^ 1]), "is damaged: .*incorrect data check"),
    "no zlib": (SOUND[:16] + b"\xff" * 20, "is damaged: .*incorrect header check"),
    "something behind": (SOUND + b"123", "3 bytes follow after its points"),
    "another kind of file": (b"PK\x03\x04" + SOUND[4:], r"starts with b'PK\\x03\\x04'; expected b'ILGP'"),
    "a later version": (file(bytes(72), version=2), "is of version 2; this InterLoc reads version 1"),
    "too many points": (file(b"", count=MAX_POINTS + 1), "promises 4,000,001 points; no scan has more than 4,000,000"),
    "more road than points": (file(bytes(72), road=7), "promises 7 road points among 6 points"),
    "fewer points than promised": (file(bytes(60)), "its 6 points unpack to 60 of 72 bytes"),
    "more points than promised": (file(bytes(84)), "its 6 points unpack to more than 72 bytes"),
    "points where none are promised": (file(bytes(12), count=0, road=0), "its 0 points unpack to more than 0 bytes"),
    "not finite": (encode_ground(GroundPoints(NAN, 6)), r"point 4 of 6 is not finite \(1, nan, 1\)"),
}


@pytest.mark.parametrize(("data", "words"), DAMAGED_GROUND.values(), ids=DAMAGED_GROUND)
def test_damaged_ground_is_named(data: bytes, words: str) -> None:
    with pytest.raises(DriveError, match=words) as caught:
        decode_ground(data, NAME)
    assert str(caught.value).startswith(f"{NAME}: ")


def test_a_bomb_is_not_unpacked() -> None:
    """64 MB of zeros behind a header of six points: no more than those are unpacked."""
    bomb = zlib.compress(bytes(1 << 26), level=1)
    with pytest.raises(DriveError, match="unpack to more than 72 bytes"):
        decode_ground(SOUND[:16] + bomb, NAME)


@given(st.integers(0, len(SOUND) - 1), st.integers(0, 255), st.booleans())
def test_whatever_byte_is_wrong_it_is_refused_or_harmless(at: int, byte: int, cut: bool) -> None:
    data = SOUND[:at] if cut else SOUND[:at] + bytes([byte]) + SOUND[at + 1 :]
    try:
        points = decode_ground(data, NAME)
    except DriveError as error:
        assert str(error).startswith(f"{NAME}: ")  # noqa: PT017 - both outcomes are right
    else:
        assert points.xyz.tobytes() == GROUND.xyz.tobytes()
        assert 0 <= points.road_count <= 6


def same_points(first: Drive, second: Drive, index: int) -> bool:
    a, b = first.ground_points(index), second.ground_points(index)
    return a.xyz.tobytes() == b.xyz.tobytes() and a.road_count == b.road_count and a.xyz.dtype == b.xyz.dtype


def test_it_is_the_same_drive(drive: Path, reduced: Path) -> None:
    before, after = open_drive(drive), open_drive(reduced)
    assert isinstance(after, Drive)
    assert (after.name, after.layout, after.scheme) == ("07", "semantickitti", before.scheme)
    assert (after.pose_frame, after.pose_frame_reason) == (before.pose_frame, before.pose_frame_reason)
    assert after.frames.tolist() == list(range(12))
    assert after.T_world_lidar.tobytes() == before.T_world_lidar.tobytes()
    assert after.times_s.tobytes() == before.times_s.tobytes()
    assert after.georeference.lat_deg.tobytes() == before.georeference.lat_deg.tobytes()
    assert after.georeference.source == before.georeference.source
    kept = select_keyframes(before.T_world_lidar, KeyframeConfig())
    assert kept.tolist() == [0, 3, 6, 9]
    assert all(same_points(before, after, int(index)) for index in kept)


def test_it_travels_to_other_processes(reduced: Path) -> None:
    drive = open_drive(reduced)
    data = pickle.dumps(drive)
    assert len(data) < 20_000
    assert same_points(pickle.loads(data), drive, 3)  # noqa: S301


def test_it_is_recognised_wherever_it_lies(reduced: Path, tmp_path: Path) -> None:
    (tmp_path / "velodyne").mkdir()
    shutil.move(reduced, tmp_path / "velodyne" / "00")
    assert open_drive(tmp_path / "velodyne" / "00").name == "07"


def test_nothing_above_it_is_looked_at(reduced: Path) -> None:
    """A calibration beside the folder is another drive's."""
    (reduced / "calib.txt").rename(reduced.parent / "calib.txt")
    with pytest.raises(DriveError, match=r"poses\.txt: holds camera poses .* there is no calib\.txt"):
        open_drive(reduced)


def test_a_scan_that_was_not_kept(reduced: Path) -> None:
    drive = open_drive(reduced)
    for index in (1, 11):
        with pytest.raises(DriveError, match=f"keyframes of 2 m, 5 degrees when it was reduced, and scan {index} was"):
            drive.ground_points(index)
    finer = preset("default").model_copy(update={"keyframes": KeyframeConfig(distance_m=1.0)})
    with pytest.raises(DriveError, match=r"keyframes\.distance_m.*reduce the drive again with --all-scans"):
        detect(drive, finer)


def test_the_report_is_that_of_the_drive(drive: Path, reduced: Path) -> None:
    before, after = inspect_drive(drive, thorough=True), inspect_drive(reduced, thorough=True)
    assert after.ok
    assert (after.reduced.kept_scans, after.reduced.distance_m, after.reduced.angle_deg) == (4, 2.0, 5.0)
    assert after.reduced.ground_bytes == sum(path.stat().st_size for path in (reduced / "ground").rglob("*.ground"))
    assert before.label_ids[40] == pytest.approx(after.label_ids[40], abs=1e-12)
    assert (before.looked_into, after.looked_into) == (12, 4)
    differing = {"path", "reduced", "looked_into", "flatness_m", "label_ids", "road_share"}
    assert before.model_dump(exclude=differing) == after.model_dump(exclude=differing)


def test_a_report_without_facts_of_the_scans(reduced: Path, edit: Callable[..., None]) -> None:
    labels = [{"folder": "labels", "scheme": "semantickitti", "road": [40, 60], "confusable": [44, 48, 49]}]
    edit(source=None, labels=labels)
    report = inspect_drive(reduced)
    assert report.ok
    assert (report.scans, report.scan_bytes, report.points_per_scan, report.road_share) == (12, 0, None, None)
    assert open_drive(reduced).scheme.name == "semantickitti"


def test_the_pose_frame_is_not_guessed_again(reduced: Path, edit: Callable[..., None]) -> None:
    """A drive that was declared so stays so, whatever the motion suggests."""
    edit(pose_frame="lidar", pose_frame_reason="declared so")
    with pytest.raises(DriveError, match="Poses were read as lidar poses: declared so"):
        open_drive(reduced)
    assert open_drive(reduced, check=False).pose_frame == "lidar"


def test_options_that_contradict_it(reduced: Path) -> None:
    assert open_drive(reduced, pose_frame="camera", layout="semantickitti", label_scheme="semantickitti").name == "07"
    for option, value, words in (
        ("pose_frame", "lidar", r"^poses\.txt: declared as poses of the LiDAR .* reduced with them as those of the"),
        ("layout", "kitti_raw", r"^reduced\.json: is a drive of layout semantickitti, not kitti_raw"),
        ("label_scheme", "learning", r"^reduced\.json: its points were chosen by label scheme semantickitti"),
        ("label_scheme", "40,60", r"^reduced\.json: its points were chosen by label scheme semantickitti"),
        ("labels", "predictions", r"^ground/predictions: is missing: .*There is labels/: choose it"),
        ("deskew", "off", r"^reduced\.json: is of a reduced drive, .* Leave --poses, --deskew and --model out"),
    ):
        with pytest.raises(DriveError, match=words):
            open_drive(reduced, **{option: value})
        report = inspect_drive(reduced, **{option: value})
        assert not report.ok


def test_a_georeference_from_elsewhere_comes_first(reduced: Path, tmp_path: Path, make: ModuleType) -> None:
    poses = make.lidar_poses(step_m=0.9, turn_rad=0.01)
    (tmp_path / "geo.csv").write_text(make.geo_csv(poses).replace(",49", ",48"))
    drive = open_drive(reduced, oxts=tmp_path / "geo.csv")
    assert drive.georeference.lat_deg[0] == pytest.approx(48.0, abs=0.01)
    with pytest.raises(GeoreferenceError, match="does not exist"):
        open_drive(reduced, oxts=tmp_path / "gone.csv")


def test_what_is_missing_is_named(reduced: Path, tmp_path: Path) -> None:
    ground = reduced / "ground/labels/000003.ground"
    ground.rename(tmp_path / "000003.ground")
    words = r"^ground/labels/000003\.ground: is missing: 1 of 4 scans that were kept are not there \(3\)"
    with pytest.raises(DriveError, match=words):
        open_drive(reduced)
    report = inspect_drive(reduced, thorough=True)
    assert [problem.severity for problem in report.problems] == ["error"]
    assert report.looked_into == 3
    shutil.move(reduced / "ground", reduced / "elsewhere")
    with pytest.raises(DriveError, match=r"^ground/labels: cannot be read: no such file"):
        open_drive(reduced)
    shutil.move(reduced / "elsewhere", reduced / "ground")
    (tmp_path / "000003.ground").rename(ground)
    poses = (reduced / "poses.txt").read_text()
    (reduced / "poses.txt").write_text("1 0 0\n")
    with pytest.raises(DriveError, match=r"^poses\.txt: line 1: 3 numbers"):
        open_drive(reduced)
    (reduced / "poses.txt").write_text(poses)
    (reduced / "reduced.json").unlink()
    with pytest.raises(DriveError, match=r"It is a reduced drive without its reduced\.json"):
        open_drive(reduced)


def test_damaged_ground_is_named_before_any_work(reduced: Path) -> None:
    path = reduced / "ground/labels/000003.ground"
    whole = path.read_bytes()
    for data, words in (
        (b"", "is empty"),
        (whole[:20], "holds 20 bytes"),
        (whole[:-5], "is damaged"),
        (whole[:4] + b"\x02" + whole[5:], "is of version 2"),
    ):
        path.write_bytes(data)
        with pytest.raises(DriveError, match=rf"^ground/labels/000003\.ground: {words}"):
            open_drive(reduced)
        errors = [problem for problem in inspect_drive(reduced).problems if problem.severity == "error"]
        assert errors[0].path == "ground/labels/000003.ground"


def test_damage_while_running_is_named(reduced: Path) -> None:
    drive = open_drive(reduced)
    (reduced / "ground/labels/000006.ground").unlink()
    with pytest.raises(DriveError, match=r"^ground/labels/000006\.ground: cannot be read: no such file"):
        detect(drive)
