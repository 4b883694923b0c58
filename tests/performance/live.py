"""Measure live sessions: `python -m tests.performance.live [--seconds 30] [--what points,ground,node]`.

125,000 points at 10, 40 and 160 Hz, every third scan a keyframe: sent to the service as they are, or the ground only,
sorted; and to the node of ROS 2. The server, or the node, has one core for itself where there are two. A time counts
from the moment before a scan is sent to its answer. To be reached at 10 Hz: 95 % within 30 ms, nothing dropped. What
is too much is dropped and reported, and the memory of the process stays.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import psutil
from websockets.sync.client import connect

from interloc.live.scan import LiveScan
from interloc.live.wire import encode_scan
from tests.app.processes import started

POINTS = 125_000
RATES_HZ = (10.0, 40.0, 160.0)
STEP_M = 1.0  # between scans: every third is a keyframe
CYCLE = 100  # scans after which the street repeats itself: a crossing every 100 m
PROFILE = Path(__file__).parents[2] / "interloc" / "ros" / "fastdds.xml"  # room for clouds in shared memory
ALONE = ("unshare", "--map-root-user", "--net")


def street(number: int, *, ground_only: bool) -> LiveScan:
    """A scan of a street between walls, of which 40 % is road."""
    generator = np.random.default_rng(number)
    x, y = generator.uniform(-60, 60, (2, POINTS)) * generator.uniform(0.1, 1.0, POINTS)
    is_road = (np.abs(y) < 5) | (np.abs((x + STEP_M * number) % 100 - 50) < 5)
    z = np.where(is_road, -1.73, generator.uniform(-1.5, 4, POINTS))
    points = np.stack([x, y, z, np.full(POINTS, 0.3)], axis=-1).astype(np.float32)
    if ground_only:
        road = np.ascontiguousarray(points[is_road, :3])
        return LiveScan(0, np.eye(4), road, road_count=len(road))
    return LiveScan(0, np.eye(4), points, np.where(is_road, 40, 50).astype(np.uint32))


def at(scan: LiveScan, frame: int) -> LiveScan:
    """The scan at its place on the street."""
    pose = np.eye(4)
    pose[0, 3] = STEP_M * frame
    return replace(scan, frame=frame, T_world_lidar=pose)


def pin(core: int, pid: int = 0) -> None:
    """Give a process a core of its own, where there are several."""
    cores = sorted(os.sched_getaffinity(pid))
    if len(cores) > 1:
        for task in psutil.Process(pid or None).threads():
            os.sched_setaffinity(task.id, {cores[core]})


def service(hz: float, seconds: float, scans: list[LiveScan]) -> None:
    """Send scans to a server at a rate, and see when they are answered."""
    sent: dict[int, float] = {}
    delays_ms: list[float] = []
    last: dict[str, Any] = {}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        server = stack.enter_context(started(folder / "data", folder / "log", workers=1, log_level="warning"))
        process = psutil.Process(server.process.pid)
        pin(0, process.pid)
        url = f"{server.address.replace('http', 'ws')}/api/v1/live"
        connection = stack.enter_context(connect(url, compression=None, max_size=None))
        connection.send(json.dumps({"type": "begin", "name": "performance"}))
        connection.recv()

        def listen() -> None:
            for text in connection:
                answer = json.loads(text)
                if answer["type"] == "scan" and answer["frame"] in sent:
                    delays_ms.append(1000 * (time.perf_counter() - sent.pop(answer["frame"])))
                last.update(answer)

        listener = threading.Thread(target=listen, daemon=True)
        listener.start()
        memory_mb = []
        began = time.perf_counter()
        for frame in range(int(hz * seconds)):
            message = encode_scan(at(scans[frame % CYCLE], frame))
            time.sleep(max(0.0, began + frame / hz - time.perf_counter()))
            sent[frame] = time.perf_counter()
            connection.send(message)
            memory_mb.append(process.memory_info().rss / 1e6)
        took_s = time.perf_counter() - began
        connection.send(json.dumps({"type": "end"}))
        listener.join(60)
    report(hz, len(memory_mb) / took_s, delays_ms, last["dropped"], memory_mb)


def node(hz: float, seconds: float, scans: list[LiveScan]) -> None:
    """Publish clouds for the node, in this network, and see what latencies it tells."""
    import rclpy  # noqa: PLC0415 - an extra
    from nav_msgs.msg import Odometry  # noqa: PLC0415
    from rclpy.qos import qos_profile_sensor_data  # noqa: PLC0415
    from sensor_msgs.msg import PointCloud2  # noqa: PLC0415
    from std_msgs.msg import Float64, Header, String  # noqa: PLC0415

    from tests.ros.played import cloud  # noqa: PLC0415

    running = subprocess.Popen([sys.executable, "-m", "interloc", "ros", "points", "--odom", "odom"])
    rclpy.init()
    try:
        player = rclpy.create_node("player")
        delays_ms: list[float] = []
        said: list[dict[str, Any]] = [{"dropped": 0}]
        player.create_subscription(Float64, "interloc/latency_ms", lambda m: delays_ms.append(m.data), 1000)
        player.create_subscription(String, "interloc/detections", lambda m: said.append(json.loads(m.data)), 1000)
        clouds = player.create_publisher(PointCloud2, "points", qos_profile_sensor_data)
        poses = player.create_publisher(Odometry, "odom", qos_profile_sensor_data)
        while not (clouds.get_subscription_count() and poses.get_subscription_count()):
            rclpy.spin_once(player, timeout_sec=0.1)
        pin(0, running.pid)
        messages = [cloud(Header(frame_id="lidar"), scan.points[:, :3], scan.labels) for scan in scans]
        memory_mb = []
        began = time.monotonic()
        for frame in range(int(hz * seconds)):
            while (left_s := began + frame / hz - time.monotonic()) > 0:
                rclpy.spin_once(player, timeout_sec=left_s)
            message, odometry = messages[frame % CYCLE], Odometry(child_frame_id="base_link")
            now = time.time_ns()
            message.header.stamp.sec, message.header.stamp.nanosec = now // 10**9, now % 10**9
            odometry.header.frame_id, odometry.header.stamp = "odom", message.header.stamp
            odometry.pose.pose.position.x, odometry.pose.pose.orientation.w = STEP_M * frame, 1.0
            poses.publish(odometry)
            clouds.publish(message)
            memory_mb.append(psutil.Process(running.pid).memory_info().rss / 1e6)
        took_s = time.monotonic() - began
        for _ in range(20):
            rclpy.spin_once(player, timeout_sec=0.05)
    finally:
        running.terminate()
        running.wait(20)
        rclpy.try_shutdown()
    report(hz, len(memory_mb) / took_s, delays_ms, said[-1]["dropped"], memory_mb)


def report(hz: float, reached_hz: float, delays_ms: list[float], dropped: int, memory_mb: list[float]) -> None:
    """Show what came out."""
    half, most = np.percentile(delays_ms, [50, 95])
    third = len(memory_mb) // 3
    click.echo(
        f"  {hz:4.0f} Hz (sent at {reached_hz:.1f}): {len(delays_ms):5,} of {len(memory_mb):,} answered, {dropped:,} "
        f"dropped; median {half:.1f} ms, 95 % within {most:.1f} ms, worst {max(delays_ms):.0f} ms; memory "
        f"{np.mean(memory_mb[third : 2 * third]):.0f} MB in the middle, {memory_mb[-1]:.0f} MB at the end"
    )


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--what", default="points,ground,node")
    options = parser.parse_args()
    for what in options.what.split(","):
        if what == "node" and "INTERLOC_ALONE" not in os.environ:
            if shutil.which("unshare") is None:
                continue
            again = [*ALONE, "sh", "-c", 'ip link set lo up && exec "$@"', "sh", sys.executable, "-m", __spec__.name]
            more = ["--seconds", str(options.seconds), "--what", "node"]
            subprocess.run(
                [*again, *more],
                env={**os.environ, "INTERLOC_ALONE": "1", "FASTRTPS_DEFAULT_PROFILES_FILE": str(PROFILE)},
                check=True,
            )
            continue
        click.echo(f"{what}: load {os.getloadavg()[0]:.1f}")
        scans = [street(number, ground_only=what == "ground") for number in range(CYCLE)]
        for hz in RATES_HZ:
            (node if what == "node" else service)(hz, options.seconds, scans)


if __name__ == "__main__":
    main()
