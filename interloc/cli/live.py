"""`interloc live`."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from interloc.cli import console, options
from interloc.errors import ConfigError, install
from interloc.wording import counted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from interloc.arrays import JsonObject
    from interloc.client.live import Said
    from interloc.config import DetectorConfig
    from interloc.drives.folder import FolderDrive
    from interloc.drives.options import DriveOptions
    from interloc.live.session import Answer
    from interloc.live.worker import Document

_PAUSE_S = 1.0  # between two lines about scans that were dropped
_NO_HURRY = 1000.0
"""A speed from which on every scan is waited for, and none is dropped."""


@click.command(cls=options.Command, short_help="Play a drive as it was driven: intersections while driving.")
@options.DRIVE
@click.option("--print", "prints", is_flag=True, help="Detect right here, and print one JSON object per keyframe.")
@click.option(
    "--server", envvar="INTERLOC_SERVER", metavar="URL", help="Send the scans to a service, whose page shows them."
)
@click.option("--name", help="Name of the session and of its drive.  [default: that of DRIVE]")
@click.option("--keep", is_flag=True, help="Have the service make a drive of it, and run it, when it ends.")
@options.TOKEN
@click.option(
    "--speed",
    type=click.FloatRange(min=0.0, min_open=True),
    show_default="1 with a server, else as fast as it goes",
    help="How fast it is played: 1 as it was driven, 2 twice as fast, 1000 as fast as it goes without dropping any.",
)
@options.INPUT
@options.ONLINE_METHOD
@options.QUIET
def live(
    drive: Path,
    prints: bool,
    server: str | None,
    token: str | None,
    name: str | None,
    keep: bool,
    speed: float | None,
    reading: DriveOptions,
    config: DetectorConfig,
) -> None:
    """Play DRIVE, a folder or a bag, scan by scan, and follow what is found.

    \b
    Examples:
      interloc live sequences/07 --print --lookahead 0
      interloc live sequences/07 --server http://127.0.0.1:8000
      interloc live city.mcap --print --speed 1 | jq -c '.events[]'
    """
    if not prints and server is None:
        raise click.UsageError("give --print, to detect right here, or --server URL, or both")
    if server is None and (keep or name is not None):
        raise click.UsageError("--keep and --name need --server")
    from interloc.drives.open import open_drive

    source = open_drive(drive, reading)
    if server is None:
        _print_answers(source, config, speed)
    else:
        begin: JsonObject = {"name": name or source.name, "config": config.model_dump(mode="json"), "keep": keep}
        _send_scans(source, config, 1.0 if speed is None else speed, server, token, begin, prints=prints)


def _send_scans(
    drive: FolderDrive,
    config: DetectorConfig,
    speed: float,
    server: str,
    token: str | None,
    begin: JsonObject,
    *,
    prints: bool,
) -> None:
    from interloc.client.live import LiveSender
    from interloc.live.scan import play

    shown_s = -_PAUSE_S

    def hear(said: Said) -> None:
        nonlocal shown_s
        if said["type"] == "dropped" and not prints:  # the next one says how many, too, and so does the end
            if time.monotonic() < shown_s + _PAUSE_S:
                return
            shown_s = time.monotonic()
        if prints:
            click.echo(json.dumps(said))
        elif not console.is_quiet():
            for line in _in_words(said):
                click.echo(line)

    keeps_all = speed >= _NO_HURRY
    sender = LiveSender(server, token, begin, hear, keeps_all=keeps_all)
    sender.run(lambda after: play(drive, config, speed=None if keeps_all else speed, after=after))


def _in_words(said: Said) -> Iterator[str]:
    """Yield what there is to tell of an answer."""
    for event in said["events"] if said["type"] == "scan" else ():
        if event["kind"] != "seen":
            place = f"{event.get('lon_deg', event['world_x_m']):.6f}, {event.get('lat_deg', event['world_y_m']):.6f}"
            branches = f"{event['branch_count']} branches"
            yield (
                f"{event['kind']:<9}  intersection {event['id']} at {place}, within {event['position_std_m']:.1f} m, "
                f"{branches}, confidence {event['confidence']:.2f}"
            )
    if said["type"] == "dropped":
        reason = said.get("reason", "the service is too slow, or the drive is played too fast (--speed).")
        yield f"dropped    {counted(said['dropped'], 'scan')} so far: {reason}"
    elif said["type"] == "refused" and said["frame"] is not None:
        yield f"refused    scan {said['frame']}: {said['reason']}"
    elif said["type"] == "session":
        yield f"session    {said['id']}"
    elif said["type"] == "end":
        scans = said["keyframes"] + said["dropped"]
        lost = f", {said['dropped']:,} of {scans:,} scans dropped" if said["dropped"] else ""
        yield f"end        {said['keyframes']} keyframes, {len(said['intersections'])} intersections{lost}"
        if "drive_id" in said:
            yield f"kept       drive {said['drive_id']}, {said.get('problem') or 'job ' + said['job_id']}"


def _print_answers(drive: FolderDrive, config: DetectorConfig, speed: float | None) -> None:
    from interloc.detection.warm import warm_up
    from interloc.live.scan import play
    from interloc.live.session import LiveSession
    from interloc.live.worker import LiveWorker, answer_document, end_document

    def say(document: Document, _: Answer | None = None) -> None:
        click.echo(json.dumps(document, allow_nan=False))

    warm_up(config)
    if speed is not None and speed >= _NO_HURRY:
        speed = None
    session, scans = LiveSession(config), play(drive, config, speed=speed)
    if speed is None:
        for scan in scans:
            say(answer_document(session.push(scan), scan))
        for answer in session.finish():
            say(answer_document(answer))
        say(end_document(session))
        return
    worker = LiveWorker(session, say)
    for scan in scans:
        worker.put(scan)
    worker.finish()
    worker.join()


@click.command(cls=options.Command, short_help="Run as a node of ROS 2: point clouds in, intersections out.")
@click.argument("points", required=False)
@click.argument("ros_arguments", nargs=-1, type=click.UNPROCESSED)
@click.option("--odom", "odometry", metavar="TOPIC", help="Poses as nav_msgs/Odometry.  [default: /tf]")
@click.option("--world-frame", metavar="FRAME", help="Frame of the map.  [default: the topmost one of the poses]")
@click.option("--label-scheme", default="semantickitti", help="Scheme of the labels of the points.")
@click.option("--files", is_flag=True, help="Print the folder of the launch file and the RViz configuration.")
@options.ONLINE_METHOD
@options.NETWORK
def ros(
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
