"""Where the LiDAR of a bag was at every scan: by its poses and GNSS fixes, or by a file of poses."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.drive import Georeference
from interloc.drives.findings import DriveFileError, Finding, Findings
from interloc.drives.georeference.fixes import (
    MIN_EXTENT_M,
    MIN_FIXES,
    Fixes,
    Shift,
    Standing,
    are_moving,
    extent_m,
    fit_moving,
    georeference_from_fixes,
    misfit_m,
    tell_standing,
)
from interloc.drives.georeference.geodetic import check_georeference, in_degrees, without_standing
from interloc.drives.georeference.read import read_georeference
from interloc.drives.layouts import DriveParts
from interloc.drives.options import ODOMETRY, DriveOptions
from interloc.drives.poses.motion import LONGEST_GAP_S, TimedPoses, body_motion, longest_piece
from interloc.drives.scans.rosbag.bag import (
    Bag,
    BagTopic,
    PointsTopic,
    ScanTimes,
    clock_lead_s,
    clock_shift,
    fix_topics,
    pose_topics,
    topic_list,
    why_no_fixes,
)
from interloc.drives.scans.rosbag.messages import NO_FIX, TRANSFORMS, read_fix
from interloc.drives.scans.rosbag.motion import (
    Edge,
    FrameTree,
    LidarMotion,
    first_child_frame,
    latest_of_each,
    read_motion,
    read_tree,
)
from interloc.drives.trajectory import LidarPoses, Trajectory, read_trajectory
from interloc.errors import InterLocError
from interloc.geometry import enu_from_lonlat, from_first, travelled

_COMPARED = 3
"""So many topics of poses are held against each other."""

_APART_M, _APART = 3.0, 0.007
"""So far may poses part, and by that share of the way: good odometry drifts by less than 1 %."""

_MANY, _MOST = 0.2, 0.9
"""Shares of the scans without a pose: that is worth a warning, and no drive."""


@dataclass(frozen=True)
class BagMotion:
    """What a bag tells of the motion of its LiDAR."""

    frames: IntArray
    """(N,) numbers of the scans that are used, those whose pose is known, and their times in seconds."""
    times_s: FloatArray
    motion: LidarMotion | None = None
    """None where a file of poses is used instead, or the bag has a fault."""
    poses: BagTopic | None = None
    fixes: tuple[BagTopic, ...] = ()
    """The topics of GNSS fixes, the best first."""
    tree: FrameTree = field(default_factory=FrameTree)
    pose_file: Path | None = None
    """That was given instead of a topic."""
    fault: InterLocError | None = None
    """Why there is no motion."""


def find_motion(
    bag: Bag, points: PointsTopic, times: ScanTimes, options: DriveOptions, findings: Findings
) -> BagMotion:
    """Read the poses of a bag, and choose the scans whose pose is known: all, where there are no poses.

    What is wrong with the poses is kept as `fault`: a drive can be looked at without them.
    """
    every = np.arange(len(times.order), dtype=np.int64)
    found = BagMotion(every, times.stamp_s)
    given = options.poses
    is_topic = given is not None and any(topic.name.lstrip("/") == given.lstrip("/") for topic in bag.topics)
    if given == ODOMETRY:
        if is_topic:
            findings.note(bag.name, f"the poses are computed from the points; those of /{given} are --poses /{given}.")
        return replace(found, fault=bag.fault("its poses are still to be computed from the points."))
    if given and Path(given).is_file() and not is_topic:
        with findings.stage():
            found = replace(found, fixes=fix_topics(bag, options.fix))
            found = replace(found, tree=read_tree(bag))
        return replace(found, pose_file=Path(given))
    try:
        found = replace(found, fixes=fix_topics(bag, options.fix))
        if not (candidates := pose_topics(bag, given)):
            only = "It has GNSS fixes, but these tell no attitude, and are too far apart in time. "
            raise bag.fault(
                f"holds no poses. {only if found.fixes else ''}Expected nav_msgs/Odometry, PoseStamped or /tf of an "
                f"odometry or SLAM, or a file of poses (--poses). It holds: {topic_list(bag)}."
            )
        found = replace(found, tree=read_tree(bag))
        candidates = _owned_first(candidates, bag, points, found.tree) if options.poses is None else candidates
        topic, motion, times = _first_that_covers(candidates, bag, points, times, found.tree, findings)
    except InterLocError as fault:
        return replace(found, fault=fault)
    times_s = times.stamp_s
    covered = motion.covers(times_s)
    if left_out := int(np.count_nonzero(~covered)):
        first, last = motion.span_s
        text = (
            f"{left_out:,} of {len(covered):,} scans are left out: no pose is known at their time. The poses last "
            f"from {first:.3f} s to {last:.3f} s, the scans from {times_s.min():.3f} s to {times_s.max():.3f} s"
        )
        if left_out > _MOST * len(covered):
            gap = f"{text}, and poses more than {LONGEST_GAP_S:.0f} s apart tell nothing between."
            return replace(found, fault=bag.fault(f"{gap} Usual cause: poses that were kept too rarely."))
        (findings.warning if left_out > _MANY * len(covered) else findings.note)(bag.name, f"{text}.")
    found = replace(found, frames=every[covered], times_s=times_s[covered], motion=motion, poses=topic)
    rows, jumps = longest_piece(motion.at(found.times_s)[:, :3, 3], found.times_s, found.frames)
    if not jumps:
        return found
    findings.warning(bag.name, f"the poses of {topic.name} {jumps}")
    times_s = found.times_s[rows]
    motion = replace(motion, within_s=(float(times_s[0]), float(times_s[-1])))
    return replace(found, frames=found.frames[rows], times_s=times_s, motion=motion)


def _owned_first(candidates: list[BagTopic], bag: Bag, points: PointsTopic, tree: FrameTree) -> list[BagTopic]:
    """Put /tf before poses that do not say whose they are, where it leads from the points to a fixed frame."""
    if all(edge.fixed for edge in tree.upwards(points.frame_id)):
        return candidates

    def rank(topic: BagTopic) -> int:
        if topic.type in TRANSFORMS:
            return 1
        owner = first_child_frame(bag, topic)
        return 0 if owner and tree.between(owner, points.frame_id) is not None else 2

    return sorted(candidates, key=rank)


def _first_that_covers(
    candidates: list[BagTopic], bag: Bag, points: PointsTopic, times: ScanTimes, tree: FrameTree, findings: Findings
) -> tuple[BagTopic, LidarMotion, ScanTimes]:
    """Return the topic whose poses are known at some scan, its motion, and the times of scans by its clock.

    It is the first, but for odometry of wheels, which lies in a plane, where there are others.
    """
    covering: list[tuple[BagTopic, LidarMotion, ScanTimes, list[Finding]]] = []
    faults: list[DriveFileError] = []
    for topic in candidates:
        said = Findings(stop_at_first=False)
        try:
            covering.append((topic, *_cover(topic, bag, points, times, tree, said), said.found))
        except DriveFileError as error:
            faults += [] if covering else [error]
        if len(covering) == _COMPARED:
            break
    if not covering:
        raise faults[0]
    wheels = [_looks_like_wheels(topic, motion) for topic, motion, *_ in covering]
    chosen = wheels.index(min(wheels))
    topic, motion, on_clock, notes = covering[chosen]
    for finding in [*(Finding("warning", fault.path, fault.message) for fault in faults), *notes]:
        findings.tell(finding)
    others = [other.name for other in candidates if other is not topic]
    text = (
        f"the poses are taken from {topic.name} ({topic.type}); others may be in {', '.join(others[:5])}. Choose with "
        "--poses."
    )
    for (other, moves, *_), rank in zip(covering, wheels, strict=True):
        both = on_clock.stamp_s[motion.covers(on_clock.stamp_s) & moves.covers(on_clock.stamp_s)]
        if other is topic or rank != wheels[chosen] or len(both) < 2:
            continue
        ours, theirs = (each.at(both)[:, :3, 3] for each in (motion, moves))
        ends = [0, len(both) // 2, -1]  # distances from these are the same in any world, and of any body nearly so
        to_ours, to_theirs = (np.linalg.norm(each[:, None] - each[ends], axis=2) for each in (ours, theirs))
        apart_m = float(np.abs(to_ours - to_theirs).max())
        length_m = float(np.linalg.norm(np.diff(ours, axis=0), axis=1).sum())
        if apart_m > max(_APART_M, _APART * length_m):
            findings.warning(
                bag.name,
                f"which poses are better cannot be told: on {length_m:,.0f} m those of {topic.name} and {other.name} "
                f"part by {apart_m:.0f} m. One of them drifts, as odometry of wheels does, or jumps; {text}",
            )
            return topic, motion, on_clock
    if others:
        findings.note(bag.name, text)
    return topic, motion, on_clock


def _looks_like_wheels(topic: BagTopic, motion: LidarMotion) -> int:
    """Tell how much speaks for odometry of wheels: its name, and that it lies in a plane, as no measured poses do."""
    if topic.type in TRANSFORMS:
        return 0
    T = motion.edges[0].moves.poses
    is_plane = bool((T[:, 2, 3] == T[0, 2, 3]).all() and (T[:, 2, 2] > 1 - 1e-12).all())
    return 2 * ("wheel" in topic.name.lower()) + is_plane


def _cover(
    topic: BagTopic, bag: Bag, points: PointsTopic, times: ScanTimes, tree: FrameTree, findings: Findings
) -> tuple[LidarMotion, ScanTimes]:
    """Read the poses of a topic, and bring the times of the scans to their clock."""
    said = Findings(stop_at_first=False)
    motion = read_motion(bag, topic, tree, points.frame_id, said)
    first, last = motion.span_s
    if (shift := clock_shift(times.lead_s, motion.lead_s, times.stamp_s, (first, last))) is not None:
        times = replace(times, stamp_s=times.stamp_s - shift.ahead_s)
        said.warning(
            bag.name,
            f"the stamps of {points.topic.name} are {shift.ahead_s:+.3f} s off those of {topic.name}, by the times at "
            f"which both were recorded: the scans are put right by that. Usual cause: {shift.why}.",
        )
    stamp_s = times.stamp_s
    if not motion.covers(stamp_s).any():
        raise bag.fault(
            f"no scan has a pose of {topic.name}: the scans last from {stamp_s.min():.3f} s to {stamp_s.max():.3f} "
            f"s, the poses from {first:.3f} s to {last:.3f} s. Expected poses at most 2 s apart while scans were "
            "taken. Usual cause: different clocks, or an odometry that did not run."
        )
    for finding in said.found:
        findings.tell(finding)
    return motion, times


def read_bag_trajectory(
    bag: Bag,
    points: PointsTopic,
    parts: DriveParts,
    found: BagMotion,
    frames: IntArray,
    options: DriveOptions,
    findings: Findings,
) -> Trajectory:
    """Return poses and times of some scans, by their numbers, and their georeference."""
    rows = np.searchsorted(found.frames, frames)
    found = replace(found, frames=frames, times_s=found.times_s[rows])
    if found.pose_file is not None:
        parts = replace(parts, poses=found.pose_file)
        trajectory = read_trajectory(parts, found.frames, options, findings, times_s=found.times_s)
        if trajectory.poses is None or trajectory.georeference is not None or not found.fixes:
            return trajectory
        world = trajectory.poses.T_world_lidar
        edge = Edge("world", points.frame_id, TimedPoses(found.times_s, world))
        motion = LidarMotion((edge,), np.eye(4), len(world), trajectory.poses.reason)
        georeference, reason = _georeference(bag, points, found, motion, world, findings)
        return replace(trajectory, georeference=georeference, georeference_reason=reason)
    if found.fault is not None or found.motion is None:
        with findings.stage():
            assert found.fault is not None
            raise found.fault
        return Trajectory(times_s=found.times_s, georeference_reason="the poses could not be read")
    world = found.motion.at(found.times_s)
    relative = from_first(world)
    georeference, reason = None, ""
    with findings.stage():
        try:
            georeference = read_georeference(parts, found.frames, options.oxts, findings)
            if georeference is not None:
                georeference = without_standing(relative, georeference, found.frames, findings)
        except InterLocError as error:
            reason = str(error)
            raise
    if georeference is None and not reason:
        georeference, reason = _georeference(bag, points, found, found.motion, world, findings)
    how = body_motion(relative)
    if how is not None and how.along[2] > 0.65:
        findings.refuse(
            bag.name,
            f"{found.motion.reason}: {how.describe()}. Expected the axes of ROS, x forward and z up. Usual cause: "
            "the axes of LOAM (x left, y up, z forward) or of a camera, whose transform to the points is not in "
            "the bag. Choose other poses with --poses, or record that transform.",
        )
    poses = LidarPoses(relative, "lidar", found.motion.reason)
    return Trajectory(poses, found.motion.count, found.times_s, georeference, "" if georeference else reason)


def _georeference(
    bag: Bag, points: PointsTopic, found: BagMotion, motion: LidarMotion, world: FloatArray, findings: Findings
) -> tuple[Georeference | None, str]:
    """Return the georeference by the fixes of a bag, given the (N, 4, 4) poses of its scans; or why there is none."""
    reasons: list[str] = []
    with findings.stage():
        for topic in found.fixes:
            fixes = BagFixes(bag, topic, points.frame_id, found.tree)
            georeference, reason = fixes.georeference(motion, found.times_s, world, findings)
            if georeference is None:
                reasons.append(reason)
                continue
            if others := [other.name for other in found.fixes if other is not topic]:
                why = f", because of {reasons[0]}" if reasons else f"; others are in {', '.join(others[:5])}"
                findings.note(bag.name, f"the fixes are taken from {topic.name}{why}. Choose with --fix.")
            return georeference, ""
    reason = "; ".join(reasons) or why_no_fixes(bag)
    findings.note(bag.name, f"no georeference: {reason}")
    return None, reason


# GNSS fixes


_ARM_STD_M = 1.0
"""Along each axis, of a place on a car that is not known."""


@dataclass(frozen=True)
class BagFixes:
    """The fixes of one topic."""

    bag: Bag
    topic: BagTopic
    points_frame: str
    tree: FrameTree

    def georeference(
        self, motion: LidarMotion, times_s: FloatArray, world: FloatArray, findings: Findings
    ) -> tuple[Georeference | None, str]:
        """Lay the motion on the fixes, given times and (N, 4, 4) poses of the scans; None and why where that fails."""
        found, reason = self._within(motion, times_s, world, findings)
        if found is None:
            return None, reason
        fixes, distance_m = found
        georeference, reason = self._laid_on(fixes, distance_m, world)
        swapped = fixes.swapped
        if swapped is not None and (georeference is None or swapped.off_poses_m < fixes.off_poses_m / 2):
            other, _ = self._laid_on(swapped, distance_m, world)
            if other is not None:
                georeference = other
                findings.warning(
                    self.bag.name,
                    f"{self.topic.name}: latitude and longitude are exchanged, and are read the other way round: so "
                    "the motion is that of the poses.",
                )
        if georeference is None:
            findings.warning(self.bag.name, reason)
        return georeference, reason

    def _laid_on(self, fixes: Fixes, distance_m: FloatArray, world: FloatArray) -> tuple[Georeference | None, str]:
        source = f"{self.topic.name} (GNSS), heading from the motion"
        georeference, doubts = georeference_from_fixes(fixes, world, distance_m, source), Findings(stop_at_first=False)
        check_georeference(from_first(world), georeference, doubts)
        return (None, f"{self.topic.name} {doubts.found[0].message}") if doubts.found else (georeference, "")

    def _within(
        self, motion: LidarMotion, scan_times_s: FloatArray, world: FloatArray, findings: Findings
    ) -> tuple[tuple[Fixes, FloatArray] | None, str]:
        """Return the fixes within the poses, and the distance driven until every scan; or why there are none."""
        name, messages = self.topic.name, list(self.bag.decoded(self.topic, read_fix))
        stamps = np.array([fix.header.stamp_ns for fix in messages], dtype=np.int64)
        is_set = bool((stamps > 0).all())
        times_s = stamps / 1e9 if is_set else self.topic.log_ns / 1e9
        lead_s = clock_lead_s(stamps, self.topic.log_ns) if is_set else float("nan")
        shift = clock_shift(lead_s, motion.lead_s, times_s, motion.span_s)
        if shift is not None:
            times_s = times_s - shift.ahead_s
            findings.warning(
                self.bag.name,
                f"the stamps of {name} are {shift.ahead_s:+.3f} s off those of the poses, by the times at which both "
                f"were recorded: the fixes are put right by that. Usual cause: {shift.why}.",
            )
        positions = np.array([fix.position for fix in messages], dtype=np.float64).reshape(-1, 3)
        positions[:, 0], positions[:, 1], is_e7 = in_degrees(positions[:, 0], positions[:, 1])
        if is_e7:
            findings.warning(self.bag.name, f"{name}: positions are multiples of 1e-7 degrees, and are read as such.")
        status = np.array([fix.status for fix in messages])
        valid = _valid_fixes(positions, status)
        if not valid.any():
            return None, f"{name}: none of {len(messages):,} fixes has a position{_why_invalid(positions, status)}"
        has_height = np.isfinite(positions[:, 2])
        positions[~has_height, 2] = np.median(positions[has_height, 2]) if has_height.any() else 0.0
        rows = np.flatnonzero(valid)[latest_of_each(times_s[valid])]
        antenna_frame = messages[int(rows[0])].header.frame_id
        T_lidar_antenna = self.tree.between(self.points_frame, antenna_frame) if antenna_frame else None
        antenna = np.zeros(3) if T_lidar_antenna is None else T_lidar_antenna[:3, 3]
        late, runs = self._late(motion, antenna, times_s[rows], positions[rows], findings)
        tell_standing(
            runs, times_s[rows] - motion.span_s[0], "{:.1f} to {:.1f} s", f"{self.bag.name}: {name}", findings
        )
        rows = rows[are_moving(runs, len(rows))]
        if late is not None and not late.is_sure:
            return None, (
                f"{name}: the fixes are late or early against the poses, by {abs(late.late):.0f} s or so (about "
                f"{late.metres:.0f} m): that is not sure enough to put it right. Usual cause: two clocks"
            )
        if late is not None:
            times_s = times_s - late.late
            findings.warning(
                self.bag.name,
                f"{name}: the fixes are {abs(late.late):.2f} s {'late' if late.late > 0 else 'early'} against the "
                f"poses (so put right they lie {late.after_m:.1f} m off the path, else {late.before_m:.1f} m; about "
                f"{late.metres:.0f} m along the road). Usual cause: a receiver that tells its positions late, or two "
                "clocks.",
            )
        covered = rows[motion.covers(times_s[rows])]
        rows = covered[latest_of_each(times_s[covered])]
        if len(rows) < MIN_FIXES:
            return None, (
                f"{name}: {len(rows)} of {len(messages):,} fixes have a position while the pose is known; expected at "
                f"least {MIN_FIXES}"
            )
        at_fixes = motion.at(times_s[rows])
        if T_lidar_antenna is None:
            findings.note(
                self.bag.name,
                f"{name}: where the antenna is on the vehicle is not known (no transform leads from "
                f"{self.points_frame} to {antenna_frame or 'its frame, which is not named'}): it is taken to be at "
                f"the LiDAR, and positions count as {_ARM_STD_M:.0f} m less sure. Record it in /tf_static.",
            )
        places = at_fixes[:, :3, :3] @ antenna + at_fixes[:, :3, 3]
        distance_m = _distances(
            np.concatenate([times_s[rows], scan_times_s]), np.concatenate([at_fixes[:, :3, 3], world[:, :3, 3]])
        )
        std_m = np.array([fix.std_m for fix in messages])[rows]
        fixes = Fixes(
            positions[rows, 0],
            positions[rows, 1],
            positions[rows, 2],
            places,
            distance_m[: len(rows)],
            None if np.isnan(std_m).all() else np.where(np.isnan(std_m), np.nanmax(std_m), std_m),
            0.0 if T_lidar_antenna is not None else _ARM_STD_M,
        )
        if extent_m(fixes) < MIN_EXTENT_M or float(np.ptp(places, axis=0).max()) < MIN_EXTENT_M / 2:
            return None, (
                f"{name}: the fixes reach over {extent_m(fixes):.1f} m; expected at least {MIN_EXTENT_M:.0f} m, or the "
                "heading is not known"
            )
        return (fixes, distance_m[len(rows) :]), ""

    def _late(
        self, motion: LidarMotion, antenna: FloatArray, times_s: FloatArray, positions: FloatArray, findings: Findings
    ) -> tuple[Shift | None, list[Standing]]:
        """Find out whether (K,) fixes, in their order, are late against the motion, and which of them stand still."""
        first, last = motion.span_s
        if len(times_s) < MIN_FIXES or last <= first:
            return None, []
        grid = np.linspace(first, last, int(np.clip((last - first) / 0.2, 2, 20_000)))
        at, lonlat = motion.at(grid), positions[:, [1, 0]]
        path = (at[:, :3, :3] @ antenna + at[:, :3, 3])[:, :2]
        shift, runs = fit_moving(grid, path, times_s, enu_from_lonlat(lonlat[0, 1], lonlat[0, 0], lonlat))
        if shift is None or not shift.is_there:
            if shift is not None and shift.undecided:
                findings.undecided(self.bag.name, f"{self.topic.name}: {shift.undecided}")
            return None, runs
        exchanged = enu_from_lonlat(lonlat[0, 0], lonlat[0, 1], lonlat[:, ::-1])
        is_mirrored = misfit_m(grid, path, times_s, exchanged) < shift.after_m  # then a shift may seem to help
        return None if is_mirrored else shift, runs


def _valid_fixes(positions: FloatArray, status: IntArray) -> BoolArray:
    lat, lon = positions[:, 0], positions[:, 1]
    with np.errstate(invalid="ignore"):
        on_earth = (np.abs(lat) < 89) & (np.abs(lon) <= 360) & ((lat != 0) | (lon != 0))
        height = ~(np.abs(positions[:, 2]) > 20_000)
    valid: BoolArray = (status != NO_FIX) & on_earth & height  # newer messages leave the status at -2, unknown
    return valid


def _why_invalid(positions: FloatArray, status: IntArray) -> str:
    """Return what is wrong with fixes of which none is sound, in words that follow."""
    if (status == NO_FIX).all():
        return f": the receiver had none (status {NO_FIX})"
    if not np.isfinite(positions[:, :2]).all(axis=1).any():
        return ": they are not finite"
    lat, lon = positions[int(np.argmax(status != NO_FIX)), :2]
    return (
        f": latitude {lat:g}, longitude {lon:g} is no place to drive. Expected degrees. Usual cause: metres of UTM or "
        "of a local frame in the message"
    )


def _distances(times_s: FloatArray, positions: FloatArray) -> FloatArray:
    """Return the distance driven until each of (M,) times at (M, 3) positions, in the order in which they are given."""
    order = np.argsort(times_s, kind="stable")
    distances = np.empty(len(times_s))
    distances[order] = travelled(positions[order])
    return distances
