"""A scored result, once for all tests of what is made of it."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.once import once
from tests.output.small import TIME_S, small_result, with_roads, write_folder


@pytest.fixture(scope="session")
def scored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result folder with an evaluation. Shared: do not change it."""
    result = with_roads(small_result())
    result = replace(result, drive="straße & <b>Co</b>", keyframes=replace(result.keyframes, time_s=TIME_S))
    return once(tmp_path_factory, "scored", lambda out: write_folder(out, result, scored=True))
