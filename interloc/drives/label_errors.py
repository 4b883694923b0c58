"""Label errors on purpose: what the result does when the segmentation errs (paper, section V-C)."""

import re
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Drive, Georeference, GroundPoints, is_slow
from interloc.errors import ConfigError


@dataclass(frozen=True)
class MislabelledDrive:
    """A drive whose labels err: a `Drive`; shares outside of 0..1 are a ConfigError."""

    drive: Drive
    """The drive with the labels as they are."""
    r_fpr: float
    """Share of the confusable points (sidewalk, parking, other ground) that are taken for road, 0..1."""
    r_fnr: float
    """Share of the road points that are missed, 0..1."""
    seed: int = 0
    """The same points err for the same seed and frame, whatever the process and the order of reading."""

    def __post_init__(self) -> None:
        for name, share in (("r_fpr", self.r_fpr), ("r_fnr", self.r_fnr)):
            if not 0 <= share <= 1:
                raise ConfigError(f"{name} is {share:g}; expected a share from 0 to 1 (5 % is 0.05).")
        if self.seed < 0:
            raise ConfigError(f"seed is {self.seed}; expected 0 or more.")

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.drive.name

    @property
    def frames(self) -> IntArray:
        """(N,) int64 scan numbers."""
        return self.drive.frames

    @property
    def T_world_lidar(self) -> FloatArray:
        """(N, 4, 4) float64 pose of the LiDAR at each scan."""
        return self.drive.T_world_lidar

    @property
    def times_s(self) -> FloatArray | None:
        """(N,) float64 seconds, or None."""
        return self.drive.times_s

    @property
    def is_slow(self) -> bool:
        """Whether several scans should be read at once."""
        return is_slow(self.drive)

    @property
    def georeference(self) -> Georeference | None:
        """Georeference, or None."""
        return self.drive.georeference

    def ground_points(self, index: int) -> GroundPoints:
        """Read a scan, and let some of its labels err."""
        points = self.drive.ground_points(index)
        draw = np.random.default_rng([self.seed, int(self.drive.frames[index])]).random(
            len(points.xyz), dtype=np.float32
        )
        is_road = points.is_road
        return GroundPoints.split(points.xyz, np.where(is_road, draw >= self.r_fnr, draw < self.r_fpr))


def parse_level(level: str) -> tuple[float, float]:
    """Return r-FPR and r-FNR as shares, 0..1, of a level in percent such as "5/20"; another text is a ConfigError."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*/\s*(\d+(?:\.\d+)?)\s*", level)
    shares = tuple(float(part) / 100.0 for part in match.groups()) if match else ()
    if len(shares) != 2 or max(shares) > 1.0:
        raise ConfigError(f"level {level!r} is not valid. Expected r-FPR/r-FNR in percent, such as 5/20.")
    return shares[0], shares[1]
