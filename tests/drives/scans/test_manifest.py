"""reduced.json: complete, bounded, and nothing in it is trusted."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import interloc.drives.scans.reduced_format as described
from interloc.drives.labels import LEARNING, SCHEMES, LabelScheme
from interloc.drives.open import open_drive
from interloc.drives.scans.reduced_format import (
    MAX_MANIFEST_BYTES,
    ReducedLabels,
    from_runs,
    make_manifest,
    parse_manifest,
    read_manifest,
    to_runs,
)
from interloc.errors import DriveError

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


def test_runs_of_some_numbers() -> None:
    assert to_runs(np.array([0, 1, 2, 7, 9, 10])) == [(0, 3), (7, 1), (9, 2)]


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
    "an unknown layout": ({"layout": "nuscenes"}, "layout: "),
    "no scans": ({"scans": []}, "scans: "),
    "a run of nothing": ({"scans": [[0, 0]]}, r"scans\.0\.1: "),
    "negative numbers": ({"scans": [[-1, 10]]}, r"scans\.0\.0: "),
    "half a run": ({"scans": [[0]]}, r"scans\.0\.1: Field required"),
    "runs that overlap": ({"scans": [[0, 8], [7, 3]]}, "scans: scan numbers must ascend"),
    "runs out of order": ({"kept": [[5, 1], [0, 1]]}, "kept: scan numbers must ascend"),
    "a million and one": ({"scans": [[0, 10**6], [10**7, 1]]}, "scans: more than 1,000,000 scans"),
    "more than memory": ({"scans": [[0, 10**15]]}, r"scans\.0\.1: Input should be less than or equal to 1000000"),
    "kept what is none": ({"kept": [[9, 2]]}, "kept: holds numbers that are not among the scans"),
    "settings that are none": ({"keyframes": {"distance_m": "NaN", "angle_deg": 5}}, r"keyframes\.distance_m: "),
    "no poses": ({"files": {}}, "files.poses: expected a file, or pose_frame 'oxts'"),
    "an unknown label folder": ({"labels": [{**FIELDS["labels"][0], "folder": "../x"}]}, r"labels\.0\.folder: "),
    "a label folder twice": ({"labels": FIELDS["labels"] * 2}, "labels: a folder comes twice"),
    "no road": ({"labels": [{**FIELDS["labels"][0], "road": []}]}, r"labels\.0\.road: "),
    "an id that is none": ({"labels": [{**FIELDS["labels"][0], "road": [65536]}]}, r"labels\.0\.road\.0: "),
    "three label folders": ({"labels": FIELDS["labels"] * 3}, "labels: List should have at most 2"),
    "a long reason": ({"pose_frame_reason": "x" * 2001}, "pose_frame_reason: "),
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


def test_edited_manifest_is_read(reduced: Path, edit: Callable[..., None]) -> None:
    edit(name="another")
    assert open_drive(reduced).name == "another"
