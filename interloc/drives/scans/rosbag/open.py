"""The opening of a bag as a drive, and the scans in it."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from interloc.arrays import IntArray
from interloc.drives.files import SourceFile
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.layouts import SCAN_FOLDERS, DriveParts
from interloc.drives.options import DriveOptions
from interloc.drives.scans.recording import CARLA_WORDS, Recording, ScanPoints, Topic
from interloc.drives.scans.rosbag.bag import (
    BagTopic,
    choose_points,
    find_bag,
    is_static,
    open_bag,
    pose_topics,
    read_scan_times,
)
from interloc.drives.scans.rosbag.files import read_messages
from interloc.drives.scans.rosbag.messages import TRANSFORMS, Encoding, WireError, read_points
from interloc.drives.scans.rosbag.trajectory import BagMotion, find_motion, read_bag_trajectory
from interloc.files import reason_of

_UNREAD_POSES = ("nav_msgs/msg/Path", "geometry_msgs/msg/TransformStamped")


@dataclass(frozen=True)
class BagScans:
    """The scans of a bag by ascending numbers; a `PointSource`.

    It opens the bag for every scan that it reads, which takes less than the reading itself; so it may be used from
    several threads and sent to other processes.
    """

    bag_files: tuple[SourceFile, ...]
    topic: str
    type: str
    encoding: Encoding
    frames: IntArray
    file_numbers: IntArray
    places: IntArray
    """(N,) which file each scan lies in, and (N, 4) where it lies there."""

    def _row(self, frame: int) -> int:
        row = int(np.searchsorted(self.frames, frame))
        if row == len(self.frames) or self.frames[row] != frame:
            raise DriveFileError(self.bag_files[0].name, f"holds no scan {frame} of {self.topic}.")
        return row

    def _file(self, row: int) -> SourceFile:
        return self.bag_files[int(self.file_numbers[row])]

    def name(self, frame: int) -> str:
        """Return the file, the topic and the number of a scan, for messages."""
        return f"{self._file(self._row(frame)).name}, {self.topic}, message {frame}"

    def files(self, frame: int) -> tuple[Path, ...]:
        """Return the file of the bag that a scan lies in."""
        return (self._file(self._row(frame)).path,)

    def read(self, frame: int) -> ScanPoints:
        """Read the points of a scan; those without a return are left out, with their labels."""
        row = self._row(frame)
        try:
            message = next(read_messages(self._file(row), self.places[row : row + 1]))
            return read_points(message, self.type, self.encoding)
        except WireError as error:
            raise DriveFileError(
                self.name(frame), f"{error}. Usual cause: a damaged bag, or a driver that fills its messages wrongly."
            ) from error


def open_rosbag(root: Path, options: DriveOptions, findings: Findings) -> Recording | None:
    """Open a bag, a file or the folder of one: its topics, and where and when its scans are; no points are read.

    It is None where the drive is of another kind. A bag that is damaged, holds no scans, or leaves open which topic
    they are is a `DriveError`.
    """
    if options.layout not in {"auto", "rosbag"}:
        return None
    if options.layout == "auto" and any((root / folder).is_dir() for folder in SCAN_FOLDERS):
        return None
    try:
        files = find_bag(root)
    except OSError as error:
        raise DriveFileError(str(root), f"cannot be read: {reason_of(error)}.") from error
    if files is None:
        return None
    bag = open_bag(files)
    points = choose_points(bag, options.points, findings)
    paths = [f"{each.name} ({each.type})" for each in bag.topics if each.type in _UNREAD_POSES and len(each)]
    if paths and options.poses is None and not pose_topics(bag, None):
        findings.warning(
            bag.name,
            f"{paths[0]} holds poses, which are not read from there. Write them to a file of TUM poses (time x y z qx "
            "qy qz qw) and give that (--poses), or record the Odometry they come from.",
        )
    if points.is_of_carla:
        findings.warning(bag.name, f"{points.topic.name}: {CARLA_WORDS}")
    folder = root if root.is_dir() else root.parent
    parts = DriveParts(
        layout="rosbag",
        root=root,
        scans=root,
        poses=None,
        times=None,
        calibration=(folder,),
        oxts=None,
        geo=folder / "geo.csv" if (folder / "geo.csv").is_file() else None,
        name=options.name or (root.stem if root.is_file() else root.absolute().name),
    )
    times = read_scan_times(bag, points.topic, findings)
    if len(times.frame_ids) > 1:
        findings.refuse(
            bag.name,
            f"{points.topic.name} holds scans in {len(times.frame_ids)} frames ({', '.join(times.frame_ids)}). Usual "
            "cause: several sensors on one topic: record each on a topic of its own, or join their points before.",
        )
    found = find_motion(bag, points, times, options, findings)
    rows, topic = found.frames, points.topic
    assert topic.encoding is not None
    source = BagScans(
        bag.files,
        topic.name,
        topic.type,
        topic.encoding,
        frames=rows,
        file_numbers=topic.files[times.order[rows]],
        places=topic.places[times.order[rows]],
    )
    return Recording(
        parts,
        source,
        rows,
        scan_bytes=sum(file.path.stat().st_size for file in bag.files),
        carries_labels=points.has_labels,
        has_remission=points.has_remission,
        has_times=points.has_times,
        carries_poses=bool(pose_topics(bag, None)) or found.pose_file is not None,
        read_trajectory=partial(read_bag_trajectory, bag, points, parts, found),
        topics=tuple(
            Topic(name=each.name, type=each.type, messages=len(each), role=_role(each, topic, found))
            for each in bag.topics
        ),
    )


def _role(
    topic: BagTopic, points: BagTopic, found: BagMotion
) -> Literal["points", "poses", "fix", "extrinsics"] | None:
    if topic is points:
        return "points"
    if topic is found.poses:
        return "poses"
    if topic in found.fixes[:1]:
        return "fix"
    if topic.type in TRANSFORMS and len(topic) and found.poses is not None:
        return "extrinsics" if is_static(topic) or found.poses.type not in TRANSFORMS else "poses"
    return None
