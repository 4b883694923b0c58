"""What `import interloc` offers, whatever else was imported before."""

import re
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

import interloc
from interloc.errors import install
from tests.crossing import SPACING_M, road_at
from tests.small_drives import level_poses


@pytest.mark.parametrize("name", interloc.__all__)
def test_every_name_resolves(name: str) -> None:
    assert callable(getattr(interloc, name))
    assert name in dir(interloc)


def test_a_name_that_is_not_there() -> None:
    with pytest.raises(AttributeError, match="No interloc attribute nothing"):
        interloc.nothing  # noqa: B018


def test_stream_takes_a_drive_or_scans_and_answers_every_keyframe() -> None:
    scans = [interloc.Scan(frame, level_poses(SPACING_M * frame), road_at(SPACING_M * frame)) for frame in range(48)]
    detector = interloc.Detector()
    pushed = [answer for scan in scans if (answer := detector.push(scan)) is not None] + list(detector.finish())
    streamed = list(interloc.stream(iter(scans)))
    assert [repr(each) for each in streamed] == [repr(each) for each in pushed]
    assert [each.keyframe.frame for each in streamed] == list(range(48))
    assert any(
        re.fullmatch(r"<KeyframeDetections frame \d+: 1 at \(-?\d+\.\d, -?\d+\.\d\) m>", repr(each))
        for each in streamed
    )


def test_python_m_interloc() -> None:
    answer = subprocess.run([sys.executable, "-m", "interloc", "--version"], capture_output=True, text=True, check=True)
    assert answer.stdout.startswith("InterLoc ")


def test_the_version_is_that_of_the_package() -> None:
    assert interloc.__version__ == version("interloc")


def test_mistakes_of_the_first_minute_are_told_in_words() -> None:
    scans = [interloc.Scan(frame, level_poses(2.0 * frame), road_at(2.0 * frame)) for frame in range(2)]
    for call, words in (
        (
            lambda: interloc.detect("sequences/07"),
            r"expected a drive, as interloc\.open_drive.* found str: 'sequences/07'",
        ),
        (lambda: list(interloc.stream(scans, "paper")), r"expected settings.* found str: 'paper'"),
        (lambda: interloc.evaluate("out", "map.osm"), r"expected a result, as interloc\.detect.* found str: 'out'"),
        (lambda: interloc.locate("07", "map.osm"), r"expected a drive.* found str: '07'"),
    ):
        with pytest.raises(interloc.InterLocError, match=words):
            call()


ROOT = Path(__file__).parents[1]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]


@pytest.mark.parametrize("extra", ["dask", "label", "las", "odometry", "parquet", "ros"])
def test_packages_are_named_by_which_an_extra_is_installed(extra: str) -> None:
    told = install(extra).replace("_", "-")
    assert told.startswith("pip install ")
    assert all(f'"{package}"' in told for package in EXTRAS[extra]) or told.startswith(f'pip install ".[{extra}]"')
