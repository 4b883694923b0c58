"""A part of a drive, by the numbers of its scans."""

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from interloc.config import KeyframeConfig
from interloc.drives.inspect import inspect_drive
from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions
from interloc.errors import ConfigError, DriveError
from interloc.geometry import invert_transform
from interloc.reduction.reduce import reduce_drive


@pytest.mark.parametrize(
    ("frames", "numbers"), [("3:9", range(3, 9)), (":2", range(2)), ("7:", range(7, 12)), (":", range(12))]
)
def test_scans_keep_their_numbers_and_w_is_the_first_of_them(drive: Path, frames: str, numbers: range) -> None:
    whole, part = open_drive(drive), open_drive(drive, frames=frames)
    rows = slice(numbers.start, numbers.stop)
    assert part.frames.tolist() == list(numbers)
    expected = invert_transform(whole.T_world_lidar[numbers.start]) @ whole.T_world_lidar[rows]
    np.testing.assert_allclose(part.T_world_lidar, expected, atol=1e-9)
    np.testing.assert_array_equal(part.times_s, whole.times_s[rows])
    np.testing.assert_array_equal(part.georeference.lat_deg, whole.georeference.lat_deg[rows])
    np.testing.assert_array_equal(part.ground_points(0).road, whole.ground_points(numbers.start).road)


def test_what_is_wrong_outside_of_it_does_not_matter(drive: Path) -> None:
    (drive / "velodyne/000001.bin").write_bytes(b"cut off")
    (drive / "labels/000010.label").unlink()
    assert len(inspect_drive(drive).problems) == 2
    report = inspect_drive(drive, frames="2:10")
    assert (report.problems, report.scans, report.first_frame, report.last_frame) == ([], 8, 2, 9)


@pytest.mark.parametrize("frames", ["12:20", "5:5", "8:3"])
def test_a_part_without_a_scan_is_refused_with_those_that_there_are(drive: Path, reduced: Path, frames: str) -> None:
    for root in (drive, reduced):
        with pytest.raises(DriveError, match=rf"has no scan in the part {frames} .* its scans are 0 to 11\."):
            open_drive(root, frames=frames)
        (problem,) = inspect_drive(root, frames=frames).problems
        assert problem.severity == "error"


@pytest.mark.parametrize("frames", ["5", "1-4", "-3:", "1:2:3", "a:b"])
def test_another_form_is_refused(frames: str) -> None:
    with pytest.raises(ConfigError, match=r"frames '.*': expected one such as 200:1400\."):
        DriveOptions.of(frames=frames)


def test_numbers_that_begin_later_with_one_pose_per_scan(tmp_path: Path, make: ModuleType) -> None:
    root = make.write_semantickitti(tmp_path / "late", frames=list(range(1000, 1012)))
    assert open_drive(root, frames="1004:1010").frames.tolist() == [1004, 1005, 1006, 1007, 1008, 1009]
    reduce_drive(root, tmp_path / "small", DriveOptions(frames="1004:1010"))
    assert open_drive(tmp_path / "small").frames.tolist() == [1004, 1005, 1006, 1007, 1008, 1009]


def test_reduced_drives(drive: Path, reduced: Path, tmp_path: Path) -> None:
    """A part of a reduced drive, and a drive of which a part was reduced."""
    part = open_drive(drive, frames="3:9")
    reduce_drive(drive, tmp_path / "small", DriveOptions(frames="3:9"), keyframes=KeyframeConfig())
    for found in (open_drive(reduced, frames="3:9"), open_drive(tmp_path / "small")):
        assert found.frames.tolist() == part.frames.tolist()
        np.testing.assert_allclose(found.T_world_lidar, part.T_world_lidar, atol=1e-6)
        np.testing.assert_allclose(found.georeference.lon_deg, part.georeference.lon_deg, atol=1e-9)
        np.testing.assert_array_equal(found.ground_points(0).road, part.ground_points(0).road)
