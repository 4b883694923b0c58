"""The options by which a drive is read."""

from typing import Any

import pytest

from interloc.drives.options import DriveOptions
from interloc.errors import ConfigError


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"labels": "else"}, "labels 'else': expected 'auto', 'labels', 'predictions' or 'geometry'"),
        ({"pose_frame": "imu"}, "pose frame 'imu': expected 'auto', 'camera' or 'lidar'"),
        (
            {"layout": "nuscenes"},
            "layout 'nuscenes': expected 'auto', 'semantickitti', 'kitti_raw', 'kitti360', 'pcd', 'rosbag' or 'las'",
        ),
        ({"label_scheme": "mine"}, "label scheme 'mine': expected auto, semantickitti, learning, kitti360"),
        ({"label_scheme": {-1}}, "label scheme '-1': expected auto"),
        ({"label_scheme": set()}, "label scheme '': expected auto"),
        ({"label_scheme": [70000]}, "must be numbers from 0 to 65535"),
        ({"crs": "foo"}, "crs 'foo': expected one such as EPSG:25832"),
        ({"colour": "red"}, "colour 'red': Extra inputs are not permitted"),
    ],
)
def test_an_unknown_option_or_choice(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        DriveOptions.of(**arguments)


def test_arguments_come_before_given_options() -> None:
    given = DriveOptions(labels="predictions", layout="kitti_raw", name="08")
    assert DriveOptions.of(given, labels="auto") == DriveOptions(layout="kitti_raw", name="08")
