"""KITTI twins: the real track of a KITTI sequence, simulated over its real map."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from interloc.errors import DriveError
from interloc.simulate.drive import Trip
from interloc.simulate.osm_map import read_map
from interloc.simulate.track_files import read_oxts
from interloc.simulate.tracks import LidarTrack, track_from_oxts


def twin_files(kitti_dir: Path, sequence: str, *, poses: Literal["suma", "gt"] = "suma") -> dict[str, Path]:
    """Return the files that a twin is made of; `buildings` only where there are any: else houses are made up."""
    files = {
        "oxts": kitti_dir / "oxts" / f"{sequence}.txt.gz",
        "poses": kitti_dir / f"poses_{poses}" / f"{sequence}.txt",
        "calib": kitti_dir / "calib" / f"{sequence}.txt",
        "times": kitti_dir / "times" / f"{sequence}.txt",
        "osm": kitti_dir / "osm" / f"{sequence}.osm.gz",
    }
    buildings = kitti_dir / "osm_buildings" / f"{sequence}.osm.gz"
    return files | ({"buildings": buildings} if buildings.is_file() else {})


def twin_track(kitti_dir: Path, sequence: str, *, poses: Literal["suma", "gt"] = "suma") -> LidarTrack:
    """Return the track of a sequence: places from OXTS, and the given poses to be written with the drive.

    Parameters
    ----------
    kitti_dir
        Folder with `oxts/NN.txt.gz`, `poses_suma/NN.txt`, `poses_gt/NN.txt`, `calib/NN.txt`, `times/NN.txt`,
        `osm/NN.osm.gz`.
    sequence
        Two digits.
    poses
        Which poses go with the drive: SuMa's (SemanticKITTI's `poses.txt`) or KITTI's ground truth.

    Raises
    ------
    DriveError
        A file is missing, or there is no such sequence.
    """
    files = twin_files(kitti_dir, sequence, poses=poses)
    for path in files.values():
        if not path.is_file():
            folders = f"oxts/, poses_{poses}/, calib/, times/ and osm/"
            raise DriveError(f"{path}: no such file. A twin needs {folders} of sequence {sequence}.")
    rows = read_oxts(files["oxts"])
    camera = np.loadtxt(files["poses"]).reshape(-1, 3, 4)
    times = np.loadtxt(files["times"])
    count = min(len(rows), len(camera), len(times))
    track = track_from_oxts(rows[:count], times[:count])
    return replace(track, poses_camera=camera[:count], calib_text=files["calib"].read_text())


def twin_trip(kitti_dir: Path, sequence: str, *, poses: Literal["suma", "gt"] = "suma") -> Trip:
    """Return a sequence as it is to be simulated.

    Parameters
    ----------
    kitti_dir, sequence, poses
        See `twin_track`; and `osm_buildings/NN.osm.gz` (optional: houses are made up without it).

    Raises
    ------
    DriveError, MapError
        Files are missing or damaged.
    """
    track = twin_track(kitti_dir, sequence, poses=poses)
    files = twin_files(kitti_dir, sequence, poses=poses)
    return Trip(track, read_map(files["osm"], files.get("buildings")), {"twin": sequence, "poses": poses})
