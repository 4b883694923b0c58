"""Small drives on disk, whole and reduced."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests import streets
from tests.small_drives import drive, make, reduced, sample, sample_result, sequence

__all__ = ["drive", "make", "reduced", "sample", "sample_result", "sequence"]


@pytest.fixture(scope="package")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole of the street of `tests.streets`. Shared: link it, do not change it."""
    return streets.write_street(tmp_path_factory.mktemp("streets") / "street")


@pytest.fixture
def edit(reduced: Path) -> Callable[..., None]:
    """Change fields of the manifest."""

    def change(**fields: Any) -> None:
        path = reduced / "reduced.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), **fields}))

    return change
