"""Networks of other kinds, which other packages bring."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike

from interloc.errors import ModelError
from interloc.labelling import networks
from interloc.labelling.networks import remission_scale

ROOT = Path(__file__).parents[2]
EXAMPLE = re.compile(r"^## A network of your own$.*?^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.fixture(params=["all_road_network", "nowhere"])
def package(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Install the package of docs/library.md, or one that is damaged."""
    found = EXAMPLE.search((ROOT / "docs/library.md").read_text())
    (tmp_path / "all_road_network.py").write_text(found[1])
    about = tmp_path / "all_road-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: all_road\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[interloc.networks]\nall_road = {request.param}\n")
    monkeypatch.syspath_prepend(tmp_path)
    networks._installed_kinds.cache_clear()
    yield request.param
    networks._installed_kinds.cache_clear()


def test_a_network_of_another_package(package: str, tmp_path: Path) -> None:
    models = tmp_path / "models"
    for name in ("ours", "theirs", "none"):
        (models / name).mkdir(parents=True)
    (models / "theirs/all_road.txt").touch()
    (models / "ours/arch_cfg.yaml").touch()
    if package == "nowhere":
        with pytest.raises(ModelError, match="networks of the kind all_road: nowhere cannot be loaded"):
            networks.open_network(models / "theirs")
        return
    ours, theirs = networks.describe_networks(models)
    assert "model.onnx is missing" in str(ours.problem)
    assert (theirs.name, theirs.problem) == ("theirs", None)
    assert networks.open_network(models / "theirs").label(np.zeros((3, 4), np.float32)).tolist() == [40] * 3
    with pytest.raises(ModelError, match=r"model\.onnx is missing"):
        networks.open_network(models / "none")


SPREAD = np.random.default_rng(0).uniform(0, 1, 5000)


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        *((highest * SPREAD, 1.0) for highest in (0.3, 1.0, 1.2)),
        *((highest * SPREAD, 255.0) for highest in (20.0, 255.0)),
        (3000.0 * SPREAD, 65535.0),
        (np.concatenate([[1e9, np.nan, np.inf], np.full(5000, 0.3)]), 1.0),  # single wrong values do not matter
        *((none, 1.0) for none in ([], [0.0, 0.0], [np.nan])),
        (np.arange(256, dtype=np.uint8), 255.0),
        (np.arange(0, 60000, 10, dtype=np.uint16), 65535.0),
    ],
)
def test_smallest_scale_that_holds_the_values(values: ArrayLike, scale: float) -> None:
    assert remission_scale(values) == scale  # type: ignore[arg-type]
