"""KITTI twins: the real track of a KITTI sequence, simulated over its real map."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from interloc.errors import DriveError
from interloc.simulate.drive import Trip
from interloc.simulate.osm_map import read_map
from interloc.simulate.track_files import read_oxts
from interloc.simulate.tracks import LidarTrack, track_from_oxts


def twin_track(kitti_dir: Path, sequence: str, *, poses: Literal["suma", "gt"] = "suma") -> LidarTrack:
    """Return the track of a sequence: places from OXTS, and the given poses to be written with the drive.

    Parameters
    ----------
    kitti_dir
        Folder with `oxts/NN.txt.gz`, `poses_suma/NN.txt`, `poses_gt/NN.txt`, `calib/NN.txt`, `times/NN.txt`.
    sequence
        Two digits.
    poses
        Which poses go with the drive: SuMa's (SemanticKITTI's `poses.txt`) or KITTI's ground truth.

    Raises
    ------
    DriveError
        A file is missing, or there is no such sequence.
    """
    root = Path(kitti_dir)
    names = {
        "oxts": root / "oxts" / f"{sequence}.txt.gz",
        "poses": root / f"poses_{poses}" / f"{sequence}.txt",
        "calib": root / "calib" / f"{sequence}.txt",
        "times": root / "times" / f"{sequence}.txt",
    }
    for path in names.values():
        if not path.is_file():
            raise DriveError(
                f"{path}: no such file. A twin needs oxts/, poses_{poses}/, calib/ and times/ of sequence {sequence}."
            )
    rows = read_oxts(names["oxts"])
    camera = np.loadtxt(names["poses"]).reshape(-1, 3, 4)
    times = np.loadtxt(names["times"])
    count = min(len(rows), len(camera), len(times))
    track = track_from_oxts(rows[:count], times[:count])
    return LidarTrack(
        track.lat_deg,
        track.lon_deg,
        track.alt_m,
        track.R_enu_lidar,
        track.times_s,
        track.oxts,
        poses_camera=camera[:count],
        calib_text=names["calib"].read_text(),
    )


def twin_maps(kitti_dir: Path, sequence: str) -> tuple[Path, Path | None]:
    """Return the OSM files of a sequence: streets, and buildings where there are any."""
    buildings = Path(kitti_dir) / "osm_buildings" / f"{sequence}.osm.gz"
    return Path(kitti_dir) / "osm" / f"{sequence}.osm.gz", buildings if buildings.is_file() else None


def twin_trip(kitti_dir: Path, sequence: str, *, poses: Literal["suma", "gt"] = "suma") -> Trip:
    """Return a sequence as it is to be simulated.

    Parameters
    ----------
    kitti_dir, sequence, poses
        See `twin_track`; and `osm/NN.osm.gz`, `osm_buildings/NN.osm.gz` (optional: houses are made up without it).

    Raises
    ------
    DriveError, MapError
        Files are missing or damaged.
    """
    track = twin_track(kitti_dir, sequence, poses=poses)
    return Trip(track, read_map(*twin_maps(kitti_dir, sequence)), {"twin": sequence, "poses": poses})
