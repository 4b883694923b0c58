"""Reading of drives: layouts, poses, labels, georeference, and the checks of all of them."""

from interloc.drives.drive import Drive, DriveScan, Georeference, GroundPoints, scans_of
from interloc.drives.noise import NoisyDrive
from interloc.drives.open import open_drive

__all__ = ["Drive", "DriveScan", "Georeference", "GroundPoints", "NoisyDrive", "open_drive", "scans_of"]
