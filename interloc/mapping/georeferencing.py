"""Detections of keyframes in the tables of a run, georeferenced where the drive is (paper, eq. 12)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference
from interloc.errors import GeoreferenceError
from interloc.geometry import bearing_deg, lonlat_from_enu, rotate_2d, yaw_of
from interloc.labelling.track import Stretch, joined
from interloc.results import DetectionTable, KeyframeTable

if TYPE_CHECKING:
    from interloc.detection.detector import KeyframeDetections  # slow to import: the web process does without


def build_tables(
    found: Sequence[KeyframeDetections], scans: IntArray, georeference: Georeference | None
) -> tuple[KeyframeTable, DetectionTable]:
    """Bring the detections of a run into columns, each placed on the ellipsoid by the fix of its own keyframe.

    Keyframes without detections take part, since not seeing is an observation. `scans` are the positions of the
    keyframes among the scans of the drive; no detection belongs to an intersection yet. A keyframe without a fix is a
    GeoreferenceError.

    Paper, eq. 12, with the fix as the origin of a local east-north-up frame: p_enu = R(yaw) p_L. The drift of the poses
    over the drive thereby never reaches the map; only their error within one window does. Directions in W turn into
    directions in ENU by the difference of the two headings of that keyframe.
    """
    poses = np.array([k.keyframe.T_world_lidar for k in found], dtype=np.float64).reshape(-1, 4, 4)
    world_yaw = yaw_of(poses[:, :3, :3])
    counts = np.array([len(k.score) for k in found], dtype=np.int64)
    keyframe = np.repeat(np.arange(len(found), dtype=np.int64), counts)
    lidar_xy = _stack([k.lidar_xy for k in found])

    turn = np.zeros(len(found))  # from W to the frame of the bearings
    lonlat_keyframes = lonlat_detections = enu_yaw = position_std = None
    if georeference is not None:
        check_fixes(georeference, scans)
        lat, lon = georeference.lat_deg[scans], georeference.lon_deg[scans]
        enu_yaw = yaw_of(georeference.R_enu_lidar[scans])
        position_std = None if georeference.position_std_m is None else georeference.position_std_m[scans]
        turn = enu_yaw - world_yaw
        lonlat_keyframes = np.stack([lon, lat], axis=-1)
        enu_xy = rotate_2d(lidar_xy, enu_yaw[keyframe])
        lonlat_detections = lonlat_from_enu(lat[keyframe], lon[keyframe], enu_xy)
    angles = [np.asarray(a, dtype=np.float64) for k in found for a in k.branch_angles_rad]
    branches = [len(a) for a in angles]
    bearings = bearing_deg(np.concatenate([np.zeros(0), *angles]) + np.repeat(turn[keyframe], branches))

    keyframe_table = KeyframeTable(
        frame=np.array([k.keyframe.frame for k in found], dtype=np.int64),
        time_s=np.array([np.nan if k.keyframe.time_s is None else k.keyframe.time_s for k in found], dtype=np.float64),
        world_xy=poses[:, :2, 3].copy(),
        world_yaw_rad=world_yaw,
        lonlat=lonlat_keyframes,
        enu_yaw_rad=enu_yaw,
        position_std_m=position_std,
        is_doubtful=np.array([k.keyframe.is_doubtful for k in found], dtype=np.bool_),
    )
    detection_table = DetectionTable(
        keyframe=keyframe,
        lidar_xy=lidar_xy,
        world_xy=_stack([k.world_xy for k in found]),
        lonlat=lonlat_detections,
        bearings_deg=[bearings[i:j] for i, j in pairwise(np.cumsum([0, *branches]).tolist())],
        widths_m=[np.asarray(w, dtype=np.float64) for k in found for w in k.branch_widths_m],
        score=np.concatenate([np.zeros(0), *(k.score for k in found)]),
        intersection=np.full(len(keyframe), -1, dtype=np.int64),
        position_std_m=np.concatenate([np.zeros(0), *(k.std_m for k in found)]),
    )
    return keyframe_table, detection_table


def doubtful_stretches(keyframes: KeyframeTable) -> list[Stretch]:
    """Return from where to where along the track labels may be wrong, metres: from such a keyframe to the one after."""
    if keyframes.is_doubtful is None or not keyframes.is_doubtful.any():
        return []
    driven = np.cumsum(np.hypot(*np.diff(keyframes.world_xy, axis=0, prepend=keyframes.world_xy[:1]).T)).round()
    ends = np.append(driven[1:], driven[-1])
    return joined(zip(driven[keyframes.is_doubtful].tolist(), ends[keyframes.is_doubtful].tolist(), strict=True))


def check_fixes(georeference: Georeference, scans: IntArray) -> None:
    """Refuse (GeoreferenceError) a georeference without the fix of a scan, by their positions in the drive."""
    parts = [georeference.lat_deg, georeference.lon_deg, georeference.R_enu_lidar.sum(axis=(1, 2))]
    std_m = georeference.position_std_m
    count = min(map(len, parts if std_m is None else [*parts, std_m]))
    has_fix = np.flatnonzero(np.isfinite(sum(each[:count] for each in parts)))
    missing = scans[~np.isin(scans, has_fix)]
    if len(missing):
        raise GeoreferenceError(
            f"{georeference.source}: scan number {missing[0] + 1} of the drive has no fix, or one that is no number. "
            "Every scan needs one. Usual cause: the georeference of another drive."
        )


def _stack(columns: Sequence[FloatArray]) -> FloatArray:
    """Concatenate (n, 2) arrays, of which there may be none."""
    return np.concatenate([np.zeros((0, 2)), *(np.asarray(c, dtype=np.float64).reshape(-1, 2) for c in columns)])
