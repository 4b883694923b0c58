"""`interloc benchmark`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from interloc.benchmark import run as running


@pytest.fixture(scope="module")
def finished(drive: Path, osm: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A benchmark over the drive of these tests. Shared: do not change it."""
    from interloc.cli.main import run  # noqa: PLC0415

    out = tmp_path_factory.mktemp("benchmark") / "out"
    assert run(["benchmark", "drives", str(drive), "--osm", str(osm), "-o", str(out), "--quiet"]) == 0
    return out


def test_tables_and_files(finished: Path, drive: Path, osm: Path, interloc: Callable) -> None:
    outcome = interloc("benchmark", "drives", drive, "--osm", osm, "-o", finished)
    assert outcome.code == 0
    for words in ("II. Performance per drive", "III. Comparison with MMInsectDet", "IV. Errors of the labels"):
        assert words in outcome.out
    assert outcome.out.endswith(f"report  {finished / 'benchmark.html'}\n")
    assert "2 of the rows are kept from before" in outcome.err
    assert (finished / "benchmark.txt").read_text() in outcome.out
    assert {path.name for path in finished.iterdir()} == {
        *("benchmark.html", "benchmark.json", "benchmark.txt", "failures", "figures", "rows")
    }


def test_the_crossing_is_found(finished: Path) -> None:
    record = json.loads((finished / "benchmark.json").read_text())
    for preset in ("default", "paper"):
        (figures,) = (e for e in record["results"] if (e["preset"], e["drive"]) == (preset, "all"))
        assert figures["nodes_found"]["mean"] == figures["nodes_in_zone"]["mean"] == 1
        assert figures["ace_m"]["mean"] < 1.5


def test_presets_levels_and_seeds(drive: Path, osm: Path, tmp_path: Path, interloc: Callable) -> None:
    outcome = interloc(
        *("benchmark", "drives", drive, "--osm", osm, "-o", tmp_path / "out", "--preset", "default"),
        *("--set", "bev.resolution_m=0.4", "--noise", "20/20,5/5", "--noise", "5/5", "--seeds", 2, "--json", "--quiet"),
    )
    assert not outcome.err
    record = outcome.json
    assert record == json.loads((tmp_path / "out/benchmark.json").read_text())
    assert record["presets"] == ["default bev.resolution_m=0.4"]
    assert record["noises"] == ["0/0", "20/20", "5/5"]
    assert record["config"]["default bev.resolution_m=0.4"]["bev"]["resolution_m"] == 0.4
    assert [(row["noise"], row["seed"]) for row in record["rows"]] == [
        *(("0/0", 0), ("20/20", 0), ("20/20", 1), ("5/5", 0), ("5/5", 1))
    ]


def test_an_interrupted_run_says_that_rows_are_kept(
    drive: Path, osm: Path, tmp_path: Path, interloc: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(running, "measure", interrupt)
    outcome = interloc("benchmark", "drives", drive, "--osm", osm, "-o", tmp_path / "out", "--quiet")
    assert outcome.code == 1
    assert "finished rows are kept in" in outcome.complaint


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("twins", "--kitti", "nowhere"), 1, "nowhere: no such folder"),
        (("semantickitti", "--root", ".", "--oxts", ".", "--osm", "."), 1, "Expected the root of SemanticKITTI"),
        (("drives", "nowhere", "--osm", "no.osm"), 1, "no.osm: no such file"),
    ],
)
def test_what_is_missing_is_named(
    arguments: tuple[str, ...],
    code: int,
    words: str,
    interloc: Callable,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = interloc("benchmark", *arguments, "-o", "out")
    assert outcome.code == code
    assert words in outcome.complaint
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (("--noise", "20"), "Expected r-FPR/r-FNR in percent"),
        (("--noise", "200/0"), "Expected r-FPR/r-FNR in percent"),
        (("--preset", "best"), "there is no 'best'"),
        (("--set", "bev.colour=1"), "colour"),
    ],
)
def test_options_without_meaning(
    option: tuple[str, ...], words: str, drive: Path, osm: Path, interloc: Callable, tmp_path: Path
) -> None:
    outcome = interloc("benchmark", "drives", drive, "--osm", osm, "-o", tmp_path / "out", *option)
    assert outcome.code == 2
    assert words in outcome.complaint
    assert not (tmp_path / "out").exists()


def test_a_georeference_of_several_drives_is_refused(drive: Path, osm: Path, interloc: Callable) -> None:
    outcome = interloc("benchmark", "drives", drive, drive.parent, "--osm", osm, "--oxts", "x", "-o", "out")
    assert outcome.code == 2
    assert "put oxts/data or geo.csv into each" in outcome.err


def test_a_drive_without_georeference(local_drive: Path, osm: Path, interloc: Callable, tmp_path: Path) -> None:
    outcome = interloc("benchmark", "drives", local_drive, "--osm", osm, "-o", tmp_path / "out", "--quiet")
    assert outcome.code == 1
    assert f"{local_drive}: the drive has no georeference" in outcome.complaint
    assert not (tmp_path / "out").exists()


def test_a_damaged_drive_is_named_before_any_is_measured(
    drive: Path, short_drive: Path, osm: Path, interloc: Callable, tmp_path: Path
) -> None:
    (short_drive / "labels/000003.label").unlink()
    outcome = interloc("benchmark", "drives", drive, short_drive, "--osm", osm, "-o", tmp_path / "out", "--quiet")
    assert outcome.code == 1
    assert str(short_drive) in outcome.complaint
    assert not (tmp_path / "out").exists()


def test_a_sequence_without_a_map(interloc: Callable, data: Callable[[str], Path], tmp_path: Path) -> None:
    kitti = data("kitti")
    outcome = interloc("benchmark", "twins", "--kitti", kitti, "--sequences", "07,03", "-o", tmp_path / "out")
    assert outcome.code == 1
    assert "sequence 03 has no osm/03.osm.gz" in outcome.complaint
