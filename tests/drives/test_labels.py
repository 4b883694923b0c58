"""Label schemes, and labels held against what lies under the vehicle: road, or the scheme is another."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interloc.drives.inspect import inspect_drive
from interloc.drives.labels import KITTI360, LEARNING, SCHEMES, SEMANTICKITTI, guess_scheme, named_scheme
from interloc.drives.open import open_drive
from interloc.errors import ConfigError
from tests import streets


def test_the_groups_of_every_scheme() -> None:
    """Road; and parking, sidewalk, other ground."""
    assert {name: (sorted(each.road), sorted(each.confusable)) for name, each in SCHEMES.items()} == {
        "semantickitti": ([40, 60], [44, 48, 49]),
        "learning": ([9], [10, 11, 12]),
        "kitti360": ([7], [6, 8, 9]),
        "las": ([11], [2]),
    }
    assert all(scheme.road | scheme.confusable <= scheme.known for scheme in SCHEMES.values())


@given(st.frozensets(st.integers(0, 65535), min_size=1, max_size=20))
def test_the_table_holds_the_custom_ids_and_no_others(ids: frozenset[int]) -> None:
    scheme = named_scheme(",".join(map(str, ids)))
    assert set(np.flatnonzero(scheme.groups() == 1).tolist()) == ids
    assert not (scheme.groups() == 2).any()


@pytest.mark.parametrize("choice", ["40,60", "40 60", " 60, 40 "])
def test_ids_as_text(choice: str) -> None:
    scheme = named_scheme(choice)
    assert scheme.road == {40, 60}


@pytest.mark.parametrize("choice", ["", "kitty", "40;60", "-1", "70000", "²"])
def test_choices_that_are_none(choice: str) -> None:
    with pytest.raises(ConfigError, match="label scheme"):
        named_scheme(choice)


@pytest.mark.parametrize(
    ("ids", "kitti360", "expected"),
    [
        ([0, 10, 40, 48, 70, 252], False, SEMANTICKITTI),
        ([0, 1, 9, 11, 15, 19], False, LEARNING),
        ([0, 1, 9, 11, 15, 19], True, LEARNING),
        ([0, 10, 11, 13], False, SEMANTICKITTI),  # cars only: no 9
        ([6, 7, 8, 11, 21, 26], True, KITTI360),
        ([6, 7, 8, 11, 21, 26, 65535], True, KITTI360),
        ([6, 7, 8, 11, 21, 26], False, SEMANTICKITTI),
        ([0, 10, 40, 48, 70], True, SEMANTICKITTI),  # a network trained on SemanticKITTI
    ],
)
def test_the_ids_tell_the_scheme(ids: list[int], kitti360: bool, expected: object) -> None:
    assert guess_scheme(np.array(ids), kitti360=kitti360) is expected


@pytest.fixture
def street(tmp_path: Path) -> Path:
    return streets.write_street(tmp_path / "street", rows=slice(0, 12))


def relabelled(path: Path, ids: dict[int, int]) -> list[tuple[str, str]]:
    """Map the ids of all labels, with some parking beside the road; return what is said of the labels."""
    for file in (path / "labels").iterdir():
        labels = np.fromfile(file, np.uint32)
        labels[np.flatnonzero(labels == 48)[::2]] = 44
        np.array([ids[int(label)] for label in labels], np.uint32).tofile(file)
    return [(p.severity, p.message) for p in inspect_drive(path).problems if p.path == "labels"]


@pytest.mark.parametrize(
    ("ids", "severity", "words"),
    [
        ({40: 9, 44: 10, 48: 11, 50: 13, 72: 17}, "note", ""),  # the learning scheme
        ({40: 8, 44: 9, 48: 10, 50: 12, 72: 16}, "error", "--label-scheme 8, or add 1 to every id"),
        ({40: 11, 44: 9, 48: 13, 50: 15, 72: 14}, "error", "--label-scheme 11"),  # of nuScenes
        ({40: 0, 44: 1, 48: 1, 50: 2, 72: 9}, "error", "--label-scheme 0"),  # of Cityscapes
        (
            {40: 70, 44: 40, 48: 48, 50: 50, 72: 72},
            "error",
            "another label scheme; name it, or give the ids of road, such as --label-scheme 70",
        ),
    ],
)
def test_ids_are_held_against_what_lies_below(street: Path, ids: dict[int, int], severity: str, words: str) -> None:
    said = relabelled(street, ids)
    assert severity in {each for each, _ in said}
    assert words in str(said)


def test_little_road_is_a_warning(street: Path) -> None:
    for file in (street / "labels").iterdir():
        labels = np.fromfile(file, np.uint32)
        road = np.flatnonzero(labels == 40)
        labels[road[len(labels) // 50 :]] = 48
        labels.tofile(file)
    assert "10 to 40 % are usual" in str([p.message for p in inspect_drive(street).problems if p.severity == "warning"])


@pytest.mark.parametrize(
    ("dtype", "words"),
    [
        (np.int64, "8 bytes (int64) per point"),
        (np.float64, "np.fromfile(FILE, np.float64).astype(np.uint32).tofile(FILE)"),
        (np.uint8, "1 byte (uint8) per point"),
        (np.uint16, "2 bytes (uint16) per point"),
        (np.float32, "holds floating-point numbers (40"),
    ],
)
def test_labels_of_another_type(street: Path, dtype: type, words: str) -> None:
    for file in (street / "labels").iterdir():
        np.sort(np.fromfile(file, np.uint32)).astype(dtype).tofile(file)
    assert words in str([p.message for p in inspect_drive(street).problems])


EVERY = dict.fromkeys(SEMANTICKITTI.known or (), 9)


@pytest.mark.parametrize(
    ("ids", "words"),
    [
        ({**EVERY, 44: 0}, "labels of moving objects .*--labels geometry"),
        ({**EVERY, 50: 251}, "labels of moving objects"),
        (dict.fromkeys(EVERY, 7), "every one has the id 7.*--labels geometry"),
    ],
)
def test_labels_that_cannot_be_of_road_are_refused(street: Path, ids: dict[int, int], words: str) -> None:
    found = relabelled(street, ids)
    assert any(severity == "error" and re.search(words, message) for severity, message in found)


def test_scans_without_any_label_are_left_out_and_counted(street: Path) -> None:
    files = sorted((street / "labels").iterdir())
    for file in files[1::2]:
        file.write_bytes(bytes(file.stat().st_size))
    report, drive = inspect_drive(street), open_drive(street)
    assert drive.frames.tolist() == [int(file.stem) for file in files[::2]]
    assert len(drive.T_world_lidar) == len(drive.frames) == report.scans
    assert any(f"{len(files[1::2])} of {len(files)} scans have no label" in each.message for each in report.problems)
