"""Reading of a drive folder step by step: the one path behind `open_drive` and `inspect_drive`."""

from __future__ import annotations

from pathlib import Path

from interloc.drives.checks import check_flat_road, check_georeference, sample_indices
from interloc.drives.files import shown
from interloc.drives.findings import Findings
from interloc.drives.folder import FolderDrive
from interloc.drives.found import Contents, Survey
from interloc.drives.layouts import find_layout
from interloc.drives.options import DriveOptions
from interloc.drives.scans.labels import SEMANTICKITTI, named_scheme
from interloc.drives.scans.raw import RawContents
from interloc.drives.scans.reduced import ReducedContents
from interloc.drives.scans.reduced_format import is_reduced
from interloc.drives.trajectory import read_track

SAMPLED_SCANS = 5
"""How many scans are looked into, unless all are."""


def survey(root: Path, options: DriveOptions, findings: Findings, *, thorough: bool = False) -> Survey:
    """Read all of a drive but its points, and check it; look into some scans, or into all of them (`thorough`).

    Raises
    ------
    DriveError, GeoreferenceError, ConfigError
        The first fault, where `findings` stops at it.
    """
    found = Survey()
    named_scheme(options.label_scheme)  # an option without meaning is refused first
    with findings.stage():
        found.contents = _find_contents(root, options)
        found.parts = found.contents.parts
    if found.contents is None:
        return found
    found.contents.list_scans(found, options, findings)
    if found.frames is None:
        return found
    read_track(found, options, findings)
    found.sample = sample_indices(found.usable, len(found.usable) if thorough else SAMPLED_SCANS)
    found.contents.look_into_labels(found, options, findings)
    found.drive = _assemble(found)
    if found.drive is not None and options.check:
        _check_contents(found, findings)
    return found


def _find_contents(root: Path, options: DriveOptions) -> Contents:
    """Find out how the scans of a folder are kept."""
    if is_reduced(root):
        return ReducedContents.find(root, options)
    return RawContents(find_layout(root, options))


def _assemble(found: Survey) -> FolderDrive | None:
    """Make the drive of what was found; None where a part is missing."""
    if found.contents is None or found.parts is None or found.frames is None or found.T_world_lidar is None:
        return None
    ground = found.contents.ground(found)
    if ground is None:
        return None
    return FolderDrive(
        root=found.parts.root,
        name=found.contents.name,
        layout=found.parts.layout,
        frames=found.frames,
        T_world_lidar=found.T_world_lidar,
        times_s=found.times_s,
        georeference=found.georeference,
        ground=ground,
        scheme=found.labels.scheme or SEMANTICKITTI,
        pose_frame=found.pose_frame,
        pose_frame_reason=found.pose_frame_reason,
    )


def _check_contents(found: Survey, findings: Findings) -> None:
    """Read the sampled scans, and see whether labels, poses and georeference fit together."""
    drive = found.drive
    assert drive is not None
    assert found.parts is not None
    pose_file = "oxts" if found.parts.poses is None else shown(found.parts.poses, drive.root)
    for index in found.sample:
        with findings.stage():
            drive.ground_points(index)
    found.flatness_m = check_flat_road(drive, found.usable, pose_file, findings)
    if drive.georeference is not None and drive.pose_frame != "oxts":
        found.georeference_error = check_georeference(drive.T_world_lidar, drive.georeference, findings)
