"""Reading of drives: layouts, poses, labels, georeference, and the checks of all of them; and their reduction."""

from interloc.drive import Drive, DriveScan, Georeference, GroundPoints, scans_of
from interloc.drives.faults import Problem
from interloc.drives.inspect import DriveReport, inspect_drive
from interloc.drives.noise import NoisyDrive
from interloc.drives.open import open_drive
from interloc.drives.reduction.ground import decode_ground, encode_ground
from interloc.drives.reduction.manifest import ReducedManifest
from interloc.drives.reduction.plan import ReductionPlan, plan_reduction, scheme_of
from interloc.drives.reduction.reduce import Reduction, prepare_reduction, reduce_drive, reduce_scan

__all__ = [
    "Drive",
    "DriveReport",
    "DriveScan",
    "Georeference",
    "GroundPoints",
    "NoisyDrive",
    "Problem",
    "ReducedManifest",
    "Reduction",
    "ReductionPlan",
    "decode_ground",
    "encode_ground",
    "inspect_drive",
    "open_drive",
    "plan_reduction",
    "prepare_reduction",
    "reduce_drive",
    "reduce_scan",
    "scans_of",
    "scheme_of",
]
