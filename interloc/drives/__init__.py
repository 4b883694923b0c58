"""Reading of drives: layouts, poses, labels, georeference, and the checks of all of them."""

from interloc.drives.drive import Drive, DriveScan, Georeference, GroundPoints, scans_of
from interloc.drives.faults import Problem
from interloc.drives.inspect import DriveReport, inspect_drive
from interloc.drives.noise import NoisyDrive
from interloc.drives.open import open_drive

__all__ = [
    "Drive",
    "DriveReport",
    "DriveScan",
    "Georeference",
    "GroundPoints",
    "NoisyDrive",
    "Problem",
    "inspect_drive",
    "open_drive",
    "scans_of",
]
