"""Scans that were lost before they came into a drive: told by the drive, what is made of it, and its results."""

from pathlib import Path

import numpy as np
import pytest

from interloc.city.drives import Pass
from interloc.config import preset
from interloc.drives.findings import Findings
from interloc.drives.folder import DROPPED, dropped_in_words
from interloc.drives.open import open_drive, read_drive
from interloc.drives.options import DriveOptions
from interloc.errors import DriveError
from interloc.pipeline import detect
from interloc.reduction.convert import convert_drive
from interloc.reduction.reduce import reduce_drive
from tests.app.street import write_street

WORDS = "57 of 97 scans were lost before they came into the drive (19 to 23 m, 42 to 44 m of the track)"


@pytest.fixture
def street(tmp_path: Path) -> Path:
    """40 scans, one every 2.1 m."""
    folder = write_street(tmp_path / "street", 40)
    (folder / DROPPED).write_text("after_frame,scans\n-1,2\n9,40\n10,5\n20,7\n39,3\n")
    return folder


def test_losses_go_with_the_drive_into_its_results(street: Path, tmp_path: Path) -> None:
    expected = {"scans": 57, "of": 97, "stretches_m": [(19.0, 23.0), (42.0, 44.0)]}
    drive = open_drive(street)
    assert drive.dropped == expected
    reduce_drive(street, tmp_path / "small")
    small = open_drive(tmp_path / "small")
    assert small.dropped == expected
    for root in (street, tmp_path / "small"):
        findings = Findings(stop_at_first=False)
        read_drive(root, DriveOptions(), findings, label_folders=("labels",))
        assert [each.severity for each in findings.found if WORDS in each.message] == ["warning"]
    result = detect(small, preset("default"))
    assert result.run["dropped"] == expected
    assert dropped_in_words(result.run["dropped"]).startswith(WORDS)
    seen = Pass.of(result)
    assert not seen.is_whole  # six of 82 m
    seen.write(tmp_path / "pass.npz")
    np.testing.assert_array_equal(Pass.read(tmp_path / "pass.npz").dropped_m, [[19, 23], [42, 44]])
    (street / DROPPED).write_text("after_frame,scans\n20,1\n")
    assert Pass.of(detect(open_drive(street), preset("default"))).is_whole


def test_losses_go_with_a_part_and_with_scans_that_get_other_numbers(street: Path, tmp_path: Path) -> None:
    options = DriveOptions(frames="8:30")
    convert_drive(street, tmp_path / "part", options)
    assert (tmp_path / "part" / DROPPED).read_text() == "after_frame,scans\n9,40\n10,5\n20,7\n"
    (street / "velodyne" / "000009.bin").unlink()
    lines = enumerate((street / "poses.txt").read_text().splitlines())
    (street / "poses.txt").write_text("".join(f"{frame} {line}\n" for frame, line in lines))
    convert_drive(street, tmp_path / "numbered", DriveOptions())
    assert (tmp_path / "numbered" / DROPPED).read_text() == "after_frame,scans\n-1,2\n8,40\n9,5\n19,7\n38,3\n"
    small = tmp_path / "small"
    reduce_drive(street, small, options)
    assert open_drive(small).dropped == open_drive(street, frames="8:30").dropped
    (street / DROPPED).unlink()
    reduce_drive(street, small)
    assert open_drive(small).dropped is None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "frame,count\n1,2\n",
        *(f"after_frame,scans\n{rows}\n" for rows in ("1", "5,1\n5,1", "1,0", "-2,1", "1,99999999999999999999", "x,y")),
        "\x00\xff",
    ],
)
def test_what_is_no_list_of_losses_is_refused(street: Path, text: str) -> None:
    (street / DROPPED).write_text(text)
    with pytest.raises(DriveError, match=r"^dropped\.csv: cannot be read"):
        open_drive(street)
