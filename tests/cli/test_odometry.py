"""`interloc odometry`, and --poses odometry of the commands that read drives."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from interloc.geometry import invert_transform
from tests.street_points import poses_along, seen, street, write_scans

pytest.importorskip("small_gicp", reason="poses from points need small_gicp")

POSES = poses_along(np.full(4, 1.5), turn_rad=0.02)


@pytest.fixture
def scans(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A drive of points, and nothing else."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return write_scans(tmp_path / "drive", [seen(street(), pose) for pose in POSES])


def test_poses_are_written_and_read(interloc: Callable, scans: Path, tmp_path: Path) -> None:
    out = tmp_path / "poses.txt"
    done = interloc("odometry", scans, "-o", out)
    assert done.code == 0
    assert "5 scans, 6 m" in done.out
    expected = (invert_transform(POSES[0]) @ POSES)[:, :3].reshape(-1, 12)
    np.testing.assert_allclose(np.loadtxt(out), expected, atol=0.05)
    assert "was not touched" in interloc("odometry", scans, "-o", out).complaint
    written = interloc("convert", scans, "-o", tmp_path / "copy", "--poses", "odometry", "--quiet")
    assert written.code == 0
    np.testing.assert_allclose(np.loadtxt(tmp_path / "copy/poses.txt"), np.loadtxt(out), atol=1e-6)


def test_tum_needs_times(interloc: Callable, scans: Path, tmp_path: Path) -> None:
    out = tmp_path / "poses.tum"
    assert "those of the scans are not known" in interloc("odometry", scans, "-o", out, "--quiet").complaint
    (scans / "times.txt").write_text("".join(f"{0.1 * row:.3f}\n" for row in range(5)))
    done = interloc("odometry", scans, "-o", out, "--json").json
    assert (done["scans"], done["has_times"], done["how"]) == (5, True, "odometry over the points of 5 scans")
    rows = np.loadtxt(out)
    np.testing.assert_allclose(rows[:, 0], 0.1 * np.arange(5))
    np.testing.assert_allclose(np.linalg.norm(rows[:, 4:], axis=1), 1)
