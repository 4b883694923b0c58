"""`interloc ros`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from interloc.cli import console, options

if TYPE_CHECKING:
    from interloc.config import DetectorConfig


@click.command(
    cls=options.Command,
    short_help="Run as a node of ROS 2: point clouds in, intersections out.",
)
@click.argument("points", required=False)
@click.argument("ros_arguments", nargs=-1, type=click.UNPROCESSED)
@click.option("--odom", "odometry", metavar="TOPIC", help="Poses as nav_msgs/Odometry.  [default: /tf]")
@click.option("--world-frame", metavar="FRAME", help="Frame of the map.  [default: the topmost one of the poses]")
@click.option("--label-scheme", default="semantickitti", show_default=True, help="Scheme of the labels of the points.")
@click.option("--files", is_flag=True, help="Print the folder of the launch file and the RViz configuration.")
@options.ONLINE_METHOD
@options.NETWORK
def command(
    points: str | None,
    ros_arguments: tuple[str, ...],
    odometry: str | None,
    world_frame: str | None,
    label_scheme: str,
    files: bool,
    config: DetectorConfig,
    model: Path | None,
    provider: str,
) -> None:
    """Find intersections in the clouds of the topic POINTS (sensor_msgs/PointCloud2), and publish them.

    The labels are a field of the points (`label`), or made by a network (--model). Published: interloc/markers
    (visualization_msgs/MarkerArray, latched), interloc/intersections and interloc/detections (JSON in
    std_msgs/String), interloc/processing_time_ms and interloc/latency_ms (std_msgs/Float64).

    \b
    Examples:
      interloc ros /velodyne_points
      interloc ros /points --odom /odometry -- --ros-args -p use_sim_time:=true
      ros2 launch $(interloc ros --files)/interloc.launch.py points:=/velodyne_points rviz:=true
    """
    import interloc.ros

    if files:
        click.echo(Path(interloc.ros.__file__).parent)
        return
    if points is None:
        raise click.UsageError("name the topic of the points: interloc ros /velodyne_points")
    from interloc.drives.labels import SEMANTICKITTI, named_scheme
    from interloc.errors import ConfigError, install

    console.set_up_log()
    try:
        from interloc.ros.node import NodeOptions, run
    except ImportError as error:
        raise ConfigError(
            f"rclpy of ROS 2 is not installed ({error}). Source the setup.bash of a ROS, or {install('ros2')}"
        ) from error
    label = None
    if model is not None:
        from interloc.labelling.networks import open_network

        label = open_network(model, provider)
        label.load()
    scheme = named_scheme(label_scheme) or SEMANTICKITTI
    chosen = NodeOptions(points, odometry, world_frame, config, scheme, None if label is None else label.label)
    run(chosen, ["interloc", *ros_arguments])
