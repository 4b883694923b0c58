"""Finding drives, their maps and their georeference, and saying what is missing."""

import gzip
from pathlib import Path

import pytest

from interloc.drives.options import DriveOptions
from interloc.errors import ConfigError, DriveError, GeoreferenceError, MapError
from interloc.lab.cases import folder_cases, semantickitti_cases, twin_cases


@pytest.fixture
def kitti_like(tmp_path: Path) -> Path:
    """A folder with all files of 00, and 03 without a map: empty ones, for nothing looks into them."""
    root = tmp_path / "kitti"
    for folder, ending in (("oxts", "txt.gz"), ("poses_suma", "txt"), ("calib", "txt"), ("times", "txt")):
        (root / folder).mkdir(parents=True)
        for sequence in ("00", "03"):
            (root / folder / f"{sequence}.{ending}").write_bytes(b"")
    (root / "osm").mkdir()
    (root / "osm/00.osm.gz").write_bytes(gzip.compress(b""))
    return root


@pytest.fixture
def data_set(tmp_path: Path) -> Path:
    for name in ("dataset/sequences/00", "dataset/sequences/03", "maps", "oxts", "raw"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "maps/00.osm.pbf").write_bytes(b"")
    (tmp_path / "maps/03.osm").write_bytes(b"")
    return tmp_path


def test_a_twin_for_each_seed(kitti_like: Path) -> None:
    cases = twin_cases(kitti_like, ["00"], seeds=3)
    assert [(case.name, case.seed) for case in cases] == [("00", 0), ("00", 1), ("00", 2)]


@pytest.mark.parametrize(
    ("folder", "sequence", "words"),
    [
        (".", "03", r"sequence 03 has no osm/03\.osm\.gz\. .*all that a twin needs: 00\."),
        (".", "77", r"sequence 77 has no oxts/77\.txt\.gz"),
        ("nowhere", "00", "no such folder"),
    ],
)
def test_what_a_twin_lacks_is_named(kitti_like: Path, folder: str, sequence: str, words: str) -> None:
    with pytest.raises(DriveError, match=words):
        twin_cases(kitti_like / folder, [sequence])


@pytest.mark.parametrize(
    ("sequence", "words"), [("00", "2011_10_03_drive_0027_sync"), ("03", "03 was never published")]
)
def test_a_missing_raw_drive_is_named(data_set: Path, sequence: str, words: str) -> None:
    with pytest.raises(GeoreferenceError, match=words):
        semantickitti_cases(data_set, data_set / "raw", data_set / "maps", [sequence])


def test_rows_of_oxts_are_found(data_set: Path) -> None:
    (data_set / "oxts/00.txt.gz").write_bytes(b"")
    (case,) = semantickitti_cases(data_set, data_set / "oxts", data_set / "maps", ["00"], labels="predictions")
    assert case.path == data_set / "dataset/sequences/00"
    assert case.osm == data_set / "maps/00.osm.pbf"
    assert case.options == DriveOptions(labels="predictions", oxts=data_set / "oxts/00.txt.gz")


@pytest.mark.parametrize("place", ["2011_10_03_drive_0027_sync", "2011_10_03/2011_10_03_drive_0027_sync"])
def test_raw_drives_are_found_under_their_published_names(data_set: Path, place: str) -> None:
    (data_set / "raw" / place / "oxts/data").mkdir(parents=True)
    (case,) = semantickitti_cases(data_set, data_set / "raw", data_set / "maps", ["00"])
    assert case.options.oxts == data_set / "raw" / place


def test_a_missing_sequence_or_map_is_named(data_set: Path) -> None:
    (data_set / "oxts/00.txt").write_bytes(b"")
    with pytest.raises(DriveError, match=r"There are: 00, 03"):
        semantickitti_cases(data_set, data_set / "oxts", data_set / "maps", ["05"])
    with pytest.raises(MapError, match="no map of sequence 00"):
        semantickitti_cases(data_set, data_set / "oxts", data_set / "oxts", ["00"])
    with pytest.raises(DriveError, match="Expected the root of SemanticKITTI"):
        semantickitti_cases(data_set / "maps", data_set / "oxts", data_set / "maps", ["00"])


def test_drives_are_named_so_that_they_differ(tmp_path: Path) -> None:
    osm = tmp_path / "map.osm"
    osm.write_bytes(b"")
    for name in ("a/00", "b/00", "a/01"):
        (tmp_path / name).mkdir(parents=True)
    (first, second) = folder_cases([tmp_path / "a/00", tmp_path / "a/01"], [osm])
    assert (first.name, second.name) == ("00", "01")
    (first, second) = folder_cases([tmp_path / "a/00", tmp_path / "b/00"], [osm])
    assert (first.name, second.name) == ("a/00", "b/00")
    with pytest.raises(ConfigError, match="given twice"):
        folder_cases([tmp_path / "a/00", tmp_path / "a/00"], [osm])


def test_maps_are_one_for_all_or_one_a_drive(tmp_path: Path) -> None:
    maps = [tmp_path / f"{number}.osm" for number in range(3)]
    for path in maps:
        path.write_bytes(b"")
    drives = [tmp_path / "a", tmp_path / "b"]
    for path in drives:
        path.mkdir()
    assert [case.osm for case in folder_cases(drives, maps[:1])] == [maps[0], maps[0]]
    assert [case.osm for case in folder_cases(drives, maps[:2])] == maps[:2]
    with pytest.raises(ConfigError, match="3 maps for 2 drives"):
        folder_cases(drives, maps)
    with pytest.raises(MapError, match="no such file"):
        folder_cases(drives, [tmp_path / "no.osm"])
