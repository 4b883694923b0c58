"""`interloc benchmark`."""

import io
import json
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from interloc.cli.main import run
from interloc.lab import run as running

SET = ("--set", "bev.resolution_m=0.4")


@pytest.fixture(scope="module")
def measured(drive: Path, osm: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A benchmark over the drive of these tests, and what was printed."""
    out = tmp_path_factory.mktemp("benchmark") / "out"
    with redirect_stdout(io.StringIO()) as printed:
        assert run(["benchmark", "drives", str(drive), "--osm", str(osm), "-o", str(out), *SET]) == 0
    return out, printed.getvalue()


def test_tables_and_files(measured: tuple[Path, str]) -> None:
    out, printed = measured
    assert "Performance, comparison with MMInsectDet, and errors of the labels" in printed
    assert (out / "benchmark.txt").read_text() == printed
    assert {path.name for path in out.iterdir()} == {"benchmark.json", "benchmark.txt", "rows"}
    record = json.loads((out / "benchmark.json").read_text())
    for preset in ("default", "paper"):
        (figures,) = (
            e for e in record["results"] if (e["preset"], e["drive"]) == (f"{preset} bev.resolution_m=0.4", "all")
        )
        assert figures["nodes_found"]["mean"] == figures["nodes_in_zone"]["mean"] == 1
        assert figures["ace_m"]["mean"] < 1.5


def test_presets_levels_and_seeds(measured: tuple[Path, str], drive: Path, osm: Path, interloc: Callable) -> None:
    out, _ = measured
    outcome = interloc(
        *("benchmark", "drives", drive, "--osm", osm, "-o", out, "--preset", "default", *SET),
        *("--noise", "20/20,5/5", "--noise", "5/5", "--seeds", 2, "--json"),
    )
    assert "1 of the rows are kept from before" in outcome.err
    record = outcome.json
    assert record == json.loads((out / "benchmark.json").read_text())
    assert record["presets"] == ["default bev.resolution_m=0.4"]
    assert record["noises"] == ["0/0", "20/20", "5/5"]
    assert record["config"]["default bev.resolution_m=0.4"]["bev"]["resolution_m"] == 0.4
    assert record["results"][-1]["ace_m"]["seeds"] == 2


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
