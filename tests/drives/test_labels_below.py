"""Labels are held against what lies under the vehicle: road, or the scheme is another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from interloc.drives.inspect import inspect_drive
from tests import streets


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


def severities(said: list[tuple[str, str]]) -> set[str]:
    return {severity for severity, _ in said}


def test_ids_of_the_learning_scheme_are_fine(street: Path) -> None:
    assert severities(relabelled(street, {40: 9, 44: 10, 48: 11, 50: 13, 72: 17})) == {"note"}


def test_ids_that_are_one_less(street: Path) -> None:
    said = relabelled(street, {40: 8, 44: 9, 48: 10, 50: 12, 72: 16})
    assert "error" in severities(said)
    assert "--label-scheme 8, or add 1 to every id" in str(said)


def test_the_classes_of_nuscenes(street: Path) -> None:
    said = relabelled(street, {40: 11, 44: 9, 48: 13, 50: 15, 72: 14})
    assert "error" in severities(said)
    assert "--label-scheme 11" in str(said)


def test_any_other_scheme(street: Path) -> None:
    said = relabelled(street, {40: 70, 44: 40, 48: 48, 50: 50, 72: 72})
    assert "another label scheme; name it, or give the ids of road, such as --label-scheme 70" in str(said)


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
