"""Which topics of a bag are scans, poses and fixes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drives.clocks import ClockShift, known_shift
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.scans.rosbag.bag import Bag, BagTopic
from interloc.drives.scans.rosbag.messages import (
    FIX,
    LIVOX,
    ODOMETRY,
    POINT_CLOUD,
    POSE,
    POSE_WITH_COVARIANCE,
    POSES,
    TRANSFORMS,
    CloudLayout,
    Encoding,
    Header,
    Wire,
    first_points,
    read_header,
    read_layout,
)

POINTS = (POINT_CLOUD, *LIVOX)

_DRIVERS = {  # raw packets, and what makes points of them
    "velodyne_msgs/msg/VelodyneScan": "velodyne_pointcloud",
    "ouster_ros/msg/PacketMsg": "ouster_ros",
    "ouster_msgs/msg/PacketMsg": "ouster_ros",
    "ouster_sensor_msgs/msg/PacketMsg": "ouster_ros",
    "hesai_ros_driver/msg/UdpFrame": "hesai_ros_driver",
    "pandar_msgs/msg/PandarScan": "hesai_pandar",
    "hesai_lidar/msg/PandarScan": "hesai_lidar",
    "rslidar_msgs/msg/rslidarScan": "rslidar_sdk",
    "rslidar_msg/msg/RslidarPacket": "rslidar_sdk",
    "nebula_msgs/msg/NebulaPackets": "nebula",
}
_FIXED_FRAMES = {"map", "odom", "world", "earth", "utm", "global", "camera_init"}
_USUAL_ORDER = {kind: place for place, kind in enumerate((ODOMETRY, POSE, POSE_WITH_COVARIANCE, *TRANSFORMS))}


@dataclass(frozen=True)
class PointsTopic:
    """The scans of a bag: their coordinate frame, and what each point carries."""

    topic: BagTopic
    frame_id: str
    has_labels: bool
    has_remission: bool
    has_times: bool = False


def choose_points(bag: Bag, given: str | None, findings: Findings) -> PointsTopic:
    """Choose the topic of the scans.

    Of several, one whose points carry labels comes first; scans of a sensor come before those that were moved into a
    fixed frame; then the one with the most points counts.
    """
    candidates = [topic for topic in bag.topics if topic.type in POINTS and topic.encoding is not None]
    if given is not None:
        return _judged(bag, named(bag, given, POINTS, "points"))[1]
    filled = [topic for topic in candidates if len(topic)]
    if not filled:
        raise bag.fault(_no_points(bag, candidates))
    judged = []
    for topic in filled:
        try:
            judged.append(_judged(bag, topic))
        except DriveFileError as error:
            if len(filled) == 1:
                raise
            findings.warning(error.path, error.message)
    if not judged:
        raise bag.fault(f"{len(filled)} topics of points, and the first message of each is damaged.")
    judged.sort(key=lambda each: each[0], reverse=True)
    (rank, best), others = judged[0], judged[1:]
    if others and others[0][0][:2] == rank[:2] and others[0][0][2] > 0.8 * rank[2]:
        raise bag.fault(
            f"both {best.topic.name} ({len(best.topic):,} messages) and {others[0][1].topic.name} "
            f"({len(others[0][1].topic):,} messages) could be the scans. Name one: "
            f"--points {best.topic.name} (points={best.topic.name!r}).",
        )
    if others:
        findings.note(
            bag.name,
            f"the scans are taken from {best.topic.name} ({best.topic.type}); other topics of points: "
            f"{', '.join(each.topic.name for _, each in others[:5])}. Choose with --points.",
        )
    return best


def _judged(bag: Bag, topic: BagTopic) -> tuple[tuple[bool, bool, int], PointsTopic]:
    """Look into the first message that has points; return how good a topic is."""
    if not len(topic):
        raise bag.fault(f"the topic {topic.name} holds no messages. Usual cause: a driver that was off.")

    def decode(head: bytes, encoding: Encoding) -> CloudLayout:
        return read_layout(head, topic.type, encoding, complete=False)

    for row, layout in enumerate(bag.decoded(topic, decode, heads=True)):
        if layout.count or row > 100:
            break
    frame = layout.header.frame_id
    rank = (layout.has("label"), frame not in _FIXED_FRAMES, len(topic) * layout.count)
    return rank, PointsTopic(topic, frame, layout.has("label"), layout.has("remission"), layout.has("time"))


def _no_points(bag: Bag, empty: list[BagTopic]) -> str:
    if empty:
        names = ", ".join(topic.name for topic in empty)
        return f"{names}: no messages. Expected one per scan. Usual cause: a driver that was off while recording."
    packets = [(topic, _DRIVERS[topic.type]) for topic in bag.topics if topic.type in _DRIVERS]
    if packets:
        topic, driver = packets[0]
        return (
            f"{topic.name} holds the raw packets of the sensor ({topic.type}), not points. Expected "
            f"sensor_msgs/PointCloud2: play the bag through the driver {driver} and record its points."
        )
    return (
        "holds no points. Expected a topic of sensor_msgs/PointCloud2 or Livox's CustomMsg. "
        f"It holds: {topic_list(bag)}."
    )


def pose_topics(bag: Bag, given: str | None) -> list[BagTopic]:
    """Return the topics that may be the poses, the best first: Odometry before poses, and both before /tf."""
    if given is not None:
        return [named(bag, given, (*POSES, *TRANSFORMS), "poses")]
    candidates = [
        topic
        for topic in bag.topics
        if topic.encoding is not None
        and len(topic)
        and ((topic.type in POSES and len(topic) > 1) or (topic.type in TRANSFORMS and not is_static(topic)))
    ]
    return sorted(candidates, key=lambda topic: (_USUAL_ORDER[topic.type], -len(topic), topic.name))


def fix_topics(bag: Bag, given: str | None) -> tuple[BagTopic, ...]:
    """Return the topics of GNSS fixes, that with the most first."""
    if given is not None:
        return (named(bag, given, (FIX,), "fix"),)
    candidates = [topic for topic in bag.topics if topic.type == FIX and topic.encoding is not None and len(topic)]
    return tuple(sorted(candidates, key=lambda topic: (-len(topic), topic.name)))


def named(bag: Bag, name: str, kinds: Collection[str], option: str) -> BagTopic:
    """Return the topic that an option names."""
    fitting = [topic for topic in bag.topics if topic.type in kinds]
    same = [topic for topic in bag.topics if topic.name.lstrip("/") == name.lstrip("/")]
    for topic in same:
        if topic in fitting and topic.encoding is not None:
            return topic
    there = ", ".join(f"{topic.name} ({len(topic):,} messages)" for topic in fitting[:20]) or "none"
    found = f"is of type {same[0].type}" if same else "is not in the bag"
    raise bag.fault(
        f"the topic {name!r} {found}. Topics that --{option} can name: {there}. All topics: {topic_list(bag)}.",
    )


def is_static(topic: BagTopic) -> bool:
    """Return whether a topic holds transforms that never change."""
    return topic.type in TRANSFORMS and topic.name.endswith("tf_static")


def topic_list(bag: Bag) -> str:
    """Write the topics of a bag, with their types."""
    texts = [f"{topic.name} ({topic.type or 'no type'}, {len(topic):,})" for topic in bag.topics[:15]]
    more = len(bag.topics) - len(texts)
    return (", ".join(texts) or "nothing") + (f" and {more} more" if more > 0 else "")


# When the scans were taken


def clock_lead_s(stamps_ns: IntArray, log_ns: IntArray) -> float:
    """Return by how much the stamps of messages are ahead of the times at which they were recorded, the median."""
    return float(np.median(stamps_ns - log_ns)) / 1e9 if len(stamps_ns) else float("nan")


def clock_shift(lead_s: float, other_lead_s: float) -> ClockShift | None:
    """Compare the clocks of two topics by their `clock_lead_s`, which may be NaN.

    None where the clocks are the same, or where one topic may only have been computed or recorded later.
    """
    ahead_s = lead_s - other_lead_s
    if not abs(ahead_s) > 0.5:
        return None
    if (known := known_shift(ahead_s)) is not None:
        return known
    if max(lead_s, other_lead_s) > 0.1 > min(lead_s, other_lead_s):  # nothing is recorded before it happens
        return ClockShift(ahead_s, "a clock that is not synchronised")
    return None


@dataclass(frozen=True)
class ScanTimes:
    """When the scans of a bag were taken."""

    order: IntArray
    """(N,) int64: rows of the topic in the order of time: scan number to row."""
    stamp_s: FloatArray
    log_s: FloatArray
    """(N,) float64: time in the header, and time of recording, of each scan."""
    frame_ids: tuple[str, ...] = ()
    """The coordinate frames of the points, those of the most scans first."""

    @property
    def lead_s(self) -> float:
        """By how much the stamps are ahead of the times of recording, the median; 0 where these are the stamps."""
        return float(np.median(self.stamp_s - self.log_s))


def read_scan_times(bag: Bag, topic: BagTopic, findings: Findings) -> ScanTimes:
    """Read the stamps of all scans, from the first bytes of each, and number the scans by them."""

    def decode(head: bytes, encoding: Encoding) -> tuple[Header, bytes | None]:
        return read_header(Wire(head, encoding)), first_points(head, topic.type, encoding)

    stamps = np.empty(len(topic), dtype=np.int64)
    frame_ids: Counter[str] = Counter()
    empty = repeated = 0
    before = b""
    for row, (header, points) in enumerate(bag.decoded(topic, decode, heads=True)):
        stamps[row] = header.stamp_ns
        frame_ids[header.frame_id] += 1
        empty += points == b""
        repeated += bool(points) and points == before
        before = points or b""
    _tell_idle(bag, topic, empty, repeated, findings)
    unset = int(np.count_nonzero(stamps <= 0))
    constant = len(stamps) > 2 and len(np.unique(stamps)) <= len(stamps) // 2
    if unset or constant:
        what = f"{unset:,} of {len(stamps):,} scans have a stamp of 0" if unset else "most scans have the same stamp"
        findings.note(bag.name, f"{topic.name}: {what}; the times at which they were recorded are used.")
        stamps = topic.log_ns
    recorded = np.argsort(topic.log_ns, kind="stable")
    steps = np.diff(stamps[recorded])
    if (steps < 0).any():
        back_s = float(-steps.min() / 1e9)
        say = findings.warning if back_s > 1.0 else findings.note
        say(
            bag.name,
            f"{topic.name}: the stamps of the scans run backwards {np.count_nonzero(steps < 0):,} times, by up to "
            f"{back_s:.3f} s; the scans are numbered by their stamps. Usual cause: two sensors on one topic, or a "
            "clock that was set while recording.",
        )
    order = recorded[np.argsort(stamps[recorded], kind="stable")]
    frames = tuple(frame for frame, _ in frame_ids.most_common())
    return ScanTimes(order, stamps[order] / 1e9, topic.log_ns[order] / 1e9, frames)


def _tell_idle(bag: Bag, topic: BagTopic, empty: int, repeated: int, findings: Findings) -> None:
    for count, what, usual in (
        (empty, "hold no points", "a sensor or network that was overloaded"),
        (repeated, "repeat the scan before under a new stamp", "a driver that hung"),
    ):
        if count:
            say = findings.warning if count > 0.05 * len(topic) else findings.note
            say(bag.name, f"{count:,} of {len(topic):,} scans of {topic.name} {what}. Usual cause: {usual}.")
