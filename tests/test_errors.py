"""What messages and documents tell people to install can be installed."""

import tomllib
from pathlib import Path

import pytest

from interloc.errors import install

ROOT = Path(__file__).parents[1]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]


@pytest.mark.parametrize("extra", ["dask", "label", "las", "odometry", "parquet", "ros"])
def test_packages_are_named_by_which_an_extra_is_installed(extra: str) -> None:
    told = install(extra).replace("_", "-")
    assert told.startswith("pip install ")
    assert all(f'"{package}"' in told for package in EXTRAS[extra]) or told.startswith(f'pip install ".[{extra}]"')
