"""KITTI twins: the real track of a KITTI sequence, simulated over its real map."""

import json
import shlex
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from interloc.drive import Drive
from interloc.drives.open import open_drive
from interloc.errors import DriveError
from interloc.evaluation.published import SEQUENCES
from interloc.files import write_file
from interloc.lab.cases import FolderCase, explain_command, file_facts, fingerprint, numbered, simulating_program
from interloc.lab.config import SceneConfig, SimulationOptions, StreetConfig
from interloc.lab.drive import Trip, simulate
from interloc.lab.streets import read_map
from interloc.lab.tracks import LidarTrack, read_oxts, track_from_oxts
from interloc.processes import Progress

Poses = Literal["suma", "gt"]
"""Poses to be written with a twin: SuMa's (SemanticKITTI's `poses.txt`) or KITTI's ground truth."""

TWIN_FACTS = "twin.json"


def twin_files(kitti_dir: Path, sequence: str, *, poses: Poses = "suma") -> dict[str, Path]:
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


def twin_track(kitti_dir: Path, sequence: str, *, poses: Poses = "suma") -> LidarTrack:
    """Return the track of a sequence: places from OXTS, and the given poses to be written with the drive."""
    files = twin_files(kitti_dir, sequence, poses=poses)
    rows = read_oxts(files["oxts"])
    camera = np.loadtxt(files["poses"]).reshape(-1, 3, 4)
    times = np.loadtxt(files["times"])
    count = min(len(rows), len(camera), len(times))
    track = track_from_oxts(rows[:count], times[:count])
    return replace(track, poses_camera=camera[:count], calib_text=files["calib"].read_text())


def twin_trip(kitti_dir: Path, sequence: str, *, poses: Poses = "suma") -> Trip:
    """Return a sequence as it is to be simulated; see `twin_track`."""
    track = twin_track(kitti_dir, sequence, poses=poses)
    files = twin_files(kitti_dir, sequence, poses=poses)
    return Trip(track, read_map(files["osm"], files.get("buildings")), {"twin": sequence, "poses": poses})


@dataclass(frozen=True)
class TwinCase:
    """A KITTI twin: the real track of a sequence, simulated over its real map with a LiDAR."""

    kitti: Path
    """Folder with `oxts/`, `poses_suma/`, `poses_gt/`, `calib/`, `times/`, `osm/` and, if known, `osm_buildings/`."""
    sequence: str
    """Two digits."""
    seed: int = 0
    """Seed of everything random; with an odd one service roads are labelled as road, which the policy does not count.
    """
    poses: Poses = "suma"
    """{"suma", "gt"}."""
    keep: Path | None = None
    """Folder in which twins stay and are found again."""
    max_scans: int | None = None
    """Number of keyframes after which the drive ends."""

    @property
    def name(self) -> str:
        """Name in the tables."""
        return self.sequence

    @property
    def shows_service_roads(self) -> bool:
        """Whether service roads are labelled as road: in half of the seeds."""
        return self.seed % 2 == 1

    @property
    def osm(self) -> Path:
        """Map of the sequence."""
        return self.kitti / "osm" / f"{self.sequence}.osm.gz"

    def axes(self) -> None:
        """Return None: in a simulated drive the axes of the roads meet at the nodes of the map."""

    def facts(self) -> dict[str, Any]:
        """Return what the twin depends on: inputs, seed, and the simulator."""
        return {
            "twin": self.sequence,
            "seed": self.seed,
            "service_roads": self.shows_service_roads,
            "poses": self.poses,
            "max_scans": self.max_scans,
            "files": file_facts(twin_files(self.kitti, self.sequence, poses=self.poses).values()),
            "simulator": simulating_program(),
        }

    def check(self) -> None:
        """Do nothing: its inputs were looked for when it was planned."""

    @contextmanager
    def opened(self, scratch: Path, progress: Progress | None = None) -> Iterator[Drive]:
        """Simulate the twin, unless it is kept from before; it is gone at the end, unless it is to be kept."""
        if self.keep is not None:
            yield open_drive(self._kept(self.keep, progress))
            return
        with tempfile.TemporaryDirectory(prefix=".twin-", dir=scratch) as folder:
            path = Path(folder) / self.sequence
            self._simulate(path, progress)
            yield open_drive(path)

    def explain(self, frame: int, settings: tuple[str, ...]) -> list[str]:
        """Return the command lines that make the twin, unless it is kept, and draw the steps at a frame."""
        drive = self._place(self.keep) if self.keep is not None else Path(f"twin_{self.sequence}")
        show = explain_command(drive, frame, self.sequence, self.osm, settings)
        if self.keep is not None:
            return [show]
        make = ["interloc", "simulate", "twin", self.sequence, "--kitti", str(self.kitti), "--seed", str(self.seed)]
        make += ["--service-roads"] if self.shows_service_roads else []
        make += ["--poses", self.poses, "-o", str(drive)]
        return [shlex.join(make), show]

    def _place(self, keep: Path) -> Path:
        return keep / f"{self.sequence}_{self.poses}_seed{self.seed}"

    def _kept(self, keep: Path, progress: Progress | None) -> Path:
        path = self._place(keep)
        now = fingerprint(self.facts())
        try:
            known = json.loads((path / TWIN_FACTS).read_text())["fingerprint"]
        except (OSError, ValueError, KeyError, TypeError):
            known = None
        if known != now:
            (path / TWIN_FACTS).unlink(missing_ok=True)
            self._simulate(path, progress)
            write_file(path / TWIN_FACTS, json.dumps({"fingerprint": now}))  # last: a folder that has it is complete
        return path

    def _simulate(self, path: Path, progress: Progress | None) -> None:
        options = SimulationOptions(
            seed=self.seed,
            keyframes_only=True,
            ground_only=True,
            max_scans=self.max_scans,
            scene=SceneConfig(
                streets=StreetConfig(service_roads="road" if self.shows_service_roads else "other_ground")
            ),
        )
        simulate(twin_trip(self.kitti, self.sequence, poses=self.poses), path, options, progress=progress)


Case = FolderCase | TwinCase


def twin_cases(
    kitti: Path,
    sequences: Sequence[str] = SEQUENCES,
    *,
    seeds: int | Sequence[int] = 1,
    poses: Poses = "suma",
    keep: Path | None = None,
    max_scans: int | None = None,
) -> list[TwinCase]:
    """Return the twins of some sequences, each with several seeds: so many of them, or these."""
    if not kitti.is_dir():
        raise DriveError(f"{kitti}: no such folder. Expected oxts/, poses_{poses}/, calib/, times/ and osm/ in it.")

    def missing(sequence: str) -> list[str]:
        needed = twin_files(kitti, sequence, poses=poses).values()
        return [path.relative_to(kitti).as_posix() for path in needed if not path.is_file()]

    for sequence in sequences:
        if lacks := missing(sequence):
            complete = [each for each in numbered(kitti / "oxts") if not missing(each)]
            raise DriveError(
                f"{kitti}: sequence {sequence} has no {', '.join(lacks)}. "
                f"Sequences with all that a twin needs: {', '.join(complete) or 'none'}."
            )
    numbers = range(seeds) if isinstance(seeds, int) else seeds
    return [TwinCase(kitti, sequence, seed, poses, keep, max_scans) for sequence in sequences for seed in numbers]
