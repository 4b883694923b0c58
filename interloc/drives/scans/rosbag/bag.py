"""A bag: one file or several, the topics in it, and which of them are scans, poses and fixes."""

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drives.files import SourceFile
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.georeference.fixes import ClockShift, known_shift
from interloc.drives.layouts import ENDINGS
from interloc.drives.scans.recording import CARLA_FIELD
from interloc.drives.scans.rosbag.files import (
    CHUNK_START,
    HEAD_BYTES,
    MAX_BYTES,
    OFFSET,
    Channel,
    channels_of,
    locate,
    read_messages,
)
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
    WireError,
    is_empty,
    read_header,
    read_layout,
)
from interloc.errors import install

SUFFIXES = ENDINGS["rosbag"]

Decoded = TypeVar("Decoded")

_PART = re.compile(r"(_\d{4}(-\d\d){5})?_\d+$")  # of a bag that was split while it was recorded
_METADATA = "metadata.yaml"
_METADATA_BYTES = 1024**2


@dataclass(frozen=True)
class BagTopic:
    """All messages of a topic, in the order in which they lie in the files; they are indexed when asked for."""

    name: str
    type: str
    bag_files: tuple[SourceFile, ...]
    channels: tuple[tuple[int, Channel], ...]
    """By the numbers of the files that they lie in."""

    def __len__(self) -> int:
        counts = [channel.count for _, channel in self.channels]
        return len(self.log_ns) if None in counts else sum(filter(None, counts))

    @property
    def encoding(self) -> Encoding | None:
        """Of the messages; None where it is not known."""
        encodings = {channel.encoding for _, channel in self.channels}
        return encodings.pop() if len(encodings) == 1 else None

    @cached_property
    def _index(self) -> IntArray:
        """(N, 6): file, time of recording and place of every message."""
        pieces = []
        for number, channel in self.channels:
            rows = locate(self.bag_files[number], channel)
            pieces.append(np.column_stack([np.full(len(rows), number), rows]))
        index = np.concatenate(pieces)
        return index[np.lexsort((index[:, 2 + OFFSET], index[:, 2 + CHUNK_START], index[:, 0]))]

    @property
    def files(self) -> IntArray:
        """(N,) int64: which file of the bag each lies in."""
        return self._index[:, 0]

    @property
    def log_ns(self) -> IntArray:
        """(N,) int64: when each was recorded, nanoseconds."""
        return self._index[:, 1]

    @property
    def places(self) -> IntArray:
        """(N, 4) int64: where it lies there."""
        return self._index[:, 2:]

    def messages(self, limit: int = MAX_BYTES) -> Iterator[bytes]:
        """Read the messages, or the beginning of each."""
        for number in np.unique(self.files):
            yield from read_messages(self.bag_files[number], self.places[self.files == number], limit)


@dataclass(frozen=True)
class Bag:
    """The files of a bag, and its topics by name."""

    files: tuple[SourceFile, ...]
    topics: list[BagTopic]

    @property
    def name(self) -> str:
        """How messages call it."""
        return self.files[0].name if len(self.files) == 1 else f"{self.files[0].name} ... {self.files[-1].name}"

    def fault(self, message: str) -> DriveFileError:
        """Return the error to raise about it: what was found, what was expected, the usual cause."""
        return DriveFileError(self.name, message)

    def decoded(
        self, topic: BagTopic, decode: Callable[[bytes, Encoding], Decoded], *, heads: bool = False
    ) -> Iterator[Decoded]:
        """Yield what a function makes of every message of a topic, or of its beginning."""
        assert topic.encoding is not None
        for number, message in enumerate(topic.messages(HEAD_BYTES if heads else MAX_BYTES)):
            try:
                found = decode(message, topic.encoding)
            except WireError as error:
                raise self.fault(f"{topic.name}, message {number}: {error}.") from error
            yield found


def open_bag(files: tuple[SourceFile, ...]) -> Bag:
    """Read which topics are in a bag."""
    if missing := [name for name in ("rosbags", "mcap") if find_spec(name) is None]:
        raise files[0].fault(f"needs the package {missing[0]} to be read. Install it with: {install('ros')}")
    topics: dict[tuple[str, str], list[tuple[int, Channel]]] = {}
    for number, file in enumerate(files):
        for channel in channels_of(file):
            topics.setdefault((channel.topic, channel.type), []).append((number, channel))
    return Bag(files, [BagTopic(*key, files, tuple(channels)) for key, channels in sorted(topics.items())])


def find_bag(root: Path) -> tuple[SourceFile, ...] | None:
    """Find the files of the bag that a path leads to, a file or a folder with one bag; None where there is none."""
    if root.is_file() and root.suffix.lower() in SUFFIXES:
        return (SourceFile(root, root.parent),)
    if not root.is_dir():
        return None
    found = _in_folder(root)
    if not found:
        inner = [folder for folder in sorted(root.iterdir()) if (folder / _METADATA).is_file()]
        if len(inner) == 1:
            found = _in_folder(inner[0])
    return tuple(SourceFile(path, root) for path in found) or None


def _in_folder(folder: Path) -> list[Path]:
    bags = [path for path in folder.glob("[!.]*") if path.suffix.lower() in SUFFIXES and path.is_file()]
    if len({(_PART.sub("", path.stem), path.suffix) for path in bags}) > 1:
        names = ", ".join(sorted(path.name for path in bags)[:5])
        raise DriveFileError(
            str(folder),
            f"holds several bags ({names}{' ...' if len(bags) > 5 else ''}). Expected one drive: give one of them.",
        )
    parts = _parts_told(folder / _METADATA) if bags else set()
    missing = sorted(parts - {path.name for path in bags})
    if 0 < len(missing) < len(parts):  # else all were renamed
        raise DriveFileError(
            str(folder / _METADATA),
            f"names {', '.join(missing[:5])}, which {'is' if len(missing) == 1 else 'are'} missing. Expected all parts "
            "of the bag. Usual cause: a copy that was interrupted.",
        )
    pieces = {path: re.split(r"(\d+)", path.name) for path in bags}  # part 10 comes after part 9
    return sorted(bags, key=lambda path: [int(piece) if piece.isdigit() else piece for piece in pieces[path]])


def _parts_told(metadata: Path) -> set[str]:
    """Return the names of the files that rosbag2's description of a bag lists; nothing in it is trusted."""
    try:
        with metadata.open("rb") as file:
            text = file.read(_METADATA_BYTES).decode(errors="replace")
    except OSError:
        return set()
    return set(re.findall(r"(?m)^ *- [\"']?([^/\s\"']+\.(?:mcap|db3))[\"']?\s*$", text))


# Scans, poses and fixes


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
    is_of_carla: bool = False
    """The points have CARLA's labels, which are not read."""


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
            f"--points {best.topic.name} (points={best.topic.name!r})."
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
    is_of_carla = CARLA_FIELD in layout.names and not layout.has("label")
    rank = (layout.has("label"), frame not in _FIXED_FRAMES, len(topic) * layout.count)
    return rank, PointsTopic(
        topic, frame, layout.has("label"), layout.has("remission"), layout.has("time"), is_of_carla
    )


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


_OTHER_FIXES = {  # what tells positions, too, and is not read -> what makes fixes of it
    "nmea_msgs/msg/Sentence": "nmea_navsat_driver (nmea_topic_driver)",
    "gps_msgs/msg/GPSFix": "gps_tools (gps_to_nav_sat_fix)",
    "gps_common/msg/GPSFix": "gps_tools (gps_to_nav_sat_fix)",
    "novatel_oem7_msgs/msg/BESTPOS": "novatel_oem7_driver",
    "novatel_gps_msgs/msg/NovatelPosition": "novatel_gps_driver",
    "ublox_msgs/msg/NavPVT": "ublox_gps",
    "septentrio_gnss_driver/msg/PVTGeodetic": "septentrio_gnss_driver",
    "sbg_driver/msg/SbgGpsPos": "sbg_driver",
}


def why_no_fixes(bag: Bag) -> str:
    """Return why a bag without fixes has none."""
    for topic in bag.topics:
        if (tool := _OTHER_FIXES.get(topic.type)) is not None and len(topic):
            return (
                f"the bag holds no GNSS fixes (sensor_msgs/NavSatFix), but {topic.name} ({topic.type}), which is not "
                f"read: play the bag through {tool}, record its fixes, or give a geo.csv (--oxts)"
            )
    return "the bag holds no GNSS fixes (sensor_msgs/NavSatFix)"


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
        f"the topic {name!r} {found}. Topics that --{option} can name: {there}. All topics: {topic_list(bag)}."
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


def clock_shift(
    lead_s: float, other_lead_s: float, times_s: FloatArray, span_s: tuple[float, float]
) -> ClockShift | None:
    """Compare the clocks of two topics by their `clock_lead_s`, which may be NaN, and by the times of both.

    None where the clocks are the same, or where one topic may only have been computed or recorded later: (N,) times of
    the one lie then in the span of the other.
    """
    ahead_s = lead_s - other_lead_s
    if not abs(ahead_s) > 0.5:
        return None
    if (known := known_shift(ahead_s)) is not None:
        return known
    if max(lead_s, other_lead_s) > 0.1 > min(lead_s, other_lead_s):  # nothing is recorded before it happens
        return ClockShift(ahead_s, "a clock that is not synchronised")
    if times_s.max() < span_s[0] or times_s.min() > span_s[1]:
        return ClockShift(ahead_s, "a LiDAR or receiver without time synchronisation")
    return None


@dataclass(frozen=True)
class ScanTimes:
    """When the scans of a bag were taken."""

    order: IntArray
    """(N,) int64: rows of the topic in the order of time: scan number to row."""
    stamp_s: FloatArray
    """(N,) float64: time in the header of each scan."""
    lead_s: float
    """By how much the stamps are ahead of the times of recording, the median; 0 where these are the stamps."""
    frame_ids: tuple[str, ...] = ()
    """The coordinate frames of the points, those of the most scans first."""


def read_scan_times(bag: Bag, topic: BagTopic, findings: Findings) -> ScanTimes:
    """Read the stamps of all scans, from the first bytes of each, and number the scans by them."""

    def decode(head: bytes, encoding: Encoding) -> tuple[Header, bool]:
        return read_header(Wire(head, encoding)), is_empty(head, topic.type, encoding)

    stamps = np.empty(len(topic), dtype=np.int64)
    frame_ids: Counter[str] = Counter()
    empty = 0
    for row, (header, has_none) in enumerate(bag.decoded(topic, decode, heads=True)):
        stamps[row] = header.stamp_ns
        frame_ids[header.frame_id] += 1
        empty += has_none
    if empty:
        (findings.warning if empty > 0.05 * len(topic) else findings.note)(
            bag.name,
            f"{empty:,} of {len(topic):,} scans of {topic.name} hold no points. Usual cause: a sensor or network that "
            "was overloaded.",
        )
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
    stamp_s = stamps[order] / 1e9
    return ScanTimes(order, stamp_s, float(np.median(stamp_s - topic.log_ns[order] / 1e9)), frames)
