"""One known pose places a drive."""

from __future__ import annotations

import numpy as np
import pytest

from interloc.errors import ConfigError
from interloc.geometry import bearing_deg, yaw_of
from interloc.localization.anchors import georeference_at
from tests.localization.town import drive_along

DRIVE = drive_along(np.array([[0.0, 0.0], [200.0, 0.0], [200.0, 200.0]]))


@pytest.mark.parametrize("row", [0, 150, len(DRIVE.frames) - 1])
def test_all_scans_follow_from_one(row: int) -> None:
    lon, lat = DRIVE.true_lonlat[row]
    heading = float(bearing_deg(DRIVE.true_yaw_rad[row]))
    placed = georeference_at(DRIVE, lat, lon, heading, frame=row)
    assert DRIVE.error_m(placed).max() < 0.02  # the truth is in one plane, meridians converge
    assert np.allclose(np.exp(1j * yaw_of(placed.R_enu_lidar)), np.exp(1j * DRIVE.true_yaw_rad), atol=1e-3)


def test_a_pose_that_is_none_is_refused() -> None:
    with pytest.raises(ConfigError, match="no pose on earth"):
        georeference_at(DRIVE, 123.0, 8.4, 0.0)
    with pytest.raises(ConfigError, match="there is no scan 5000"):
        georeference_at(DRIVE, 49.0, 8.4, 0.0, frame=5000)
