"""The drives of a benchmark: folders on disk, and twins that are simulated when their turn comes."""

from __future__ import annotations

import json
import shlex
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

from interloc.benchmark.fingerprint import SIMULATING, code_fingerprint, file_facts, fingerprint
from interloc.drive import Drive
from interloc.drives.open import open_drive
from interloc.errors import DriveError, GeoreferenceError
from interloc.files import atomic_write

Progress = Callable[[int, int], None]
Poses = Literal["suma", "gt"]

TWIN_FACTS = "twin.json"


class Case(Protocol):
    """A drive with its map.

    Attributes
    ----------
    name : str
        In the tables.
    seed : int or None
        Of the drive, where chance made it; None for a recorded one.
    osm : Path
        Map to score against.
    """

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def seed(self) -> int | None: ...  # noqa: D102
    @property
    def osm(self) -> Path: ...  # noqa: D102

    def facts(self) -> dict[str, Any]:
        """Return what the drive depends on, as plain values."""
        ...

    def check(self) -> None:
        """Raise what is wrong with the drive, as far as that shows without reading all of it."""
        ...

    @contextmanager
    def opened(self, scratch: Path, progress: Progress | None = None) -> Iterator[Drive]:
        """Give the drive, made in `scratch` if it does not exist yet."""
        ...

    def explain(self, frame: int, settings: tuple[str, ...]) -> list[str]:
        """Return the command lines that draw the steps of the method at a frame."""
        ...


@dataclass(frozen=True)
class FolderCase:
    """A drive on disk.

    Attributes
    ----------
    name : str
    path, osm : Path
    options : dict
        Of `interloc.drives.open_drive`.
    """

    name: str
    path: Path
    osm: Path
    options: dict[str, Any] = field(default_factory=dict)
    seed: None = None

    def facts(self) -> dict[str, Any]:
        """Return what the drive depends on: names, sizes and times of all files."""
        oxts = self.options.get("oxts")
        given = [] if oxts is None else [Path(oxts)]
        return {
            "files": file_facts([self.path, self.osm, *given]),
            "options": {key: str(value) for key, value in self.options.items() if key != "oxts"},
        }

    def check(self) -> None:
        """Raise what is wrong with the drive, as far as that shows without reading all of it.

        Raises
        ------
        DriveError, GeoreferenceError
            The drive is damaged, or has no georeference to compare it with a map by.
        """
        try:
            drive = open_drive(self.path, **self.options)
        except GeoreferenceError as error:
            raise GeoreferenceError(f"{self.path}: {error}") from error
        except DriveError as error:
            raise DriveError(f"{self.path}: {error}") from error
        if drive.georeference is None:
            raise GeoreferenceError(
                f"{self.path}: the drive has no georeference, so it cannot be compared with OpenStreetMap. "
                "Put oxts/data or geo.csv into it."
            )

    @contextmanager
    def opened(self, scratch: Path, progress: Progress | None = None) -> Iterator[Drive]:  # noqa: ARG002 - as the others
        """Give the drive."""
        yield open_drive(self.path, **self.options)

    def explain(self, frame: int, settings: tuple[str, ...]) -> list[str]:
        """Return the command lines that draw the steps of the method at a frame."""
        usual = {"labels": "labels", "label_scheme": "auto", "pose_frame": "auto", "layout": "auto", "oxts": None}
        options = [
            text
            for key, value in self.options.items()
            if value != usual.get(key)
            for text in (f"--{key.replace('_', '-')}", str(value))
        ]
        return [_explain(self.path, frame, self.name, self.osm, (*options, *settings))]


@dataclass(frozen=True)
class TwinCase:
    """A KITTI twin: the real track of a sequence, simulated over its real map.

    Attributes
    ----------
    kitti : Path
        Folder with `oxts/`, `poses_suma/`, `poses_gt/`, `calib/`, `times/`, `osm/` and, if known, `osm_buildings/`.
    name : str
        Sequence, two digits.
    seed : int
        Of everything that chance decides.
    poses : {"suma", "gt"}
    keep : Path or None
        Folder in which twins stay and are found again.
    max_scans : int or None
        Only so many keyframes.
    """

    kitti: Path
    name: str
    seed: int = 0
    poses: Poses = "suma"
    keep: Path | None = None
    max_scans: int | None = None

    @property
    def osm(self) -> Path:
        """Map of the sequence."""
        return self.kitti / "osm" / f"{self.name}.osm.gz"

    @property
    def inputs(self) -> list[Path]:
        """All files that the twin is made of."""
        root, name = self.kitti, self.name
        needed = [
            root / "oxts" / f"{name}.txt.gz",
            root / f"poses_{self.poses}" / f"{name}.txt",
            root / "calib" / f"{name}.txt",
            root / "times" / f"{name}.txt",
            self.osm,
        ]
        buildings = root / "osm_buildings" / f"{name}.osm.gz"
        return [*needed, buildings] if buildings.exists() else needed

    def facts(self) -> dict[str, Any]:
        """Return what the twin depends on: inputs, seed, and the simulator."""
        return {
            "twin": self.name,
            "seed": self.seed,
            "poses": self.poses,
            "max_scans": self.max_scans,
            "files": file_facts(self.inputs),
            "simulator": code_fingerprint(SIMULATING),
        }

    def check(self) -> None:
        """Nothing: its inputs were looked for when it was planned."""

    @contextmanager
    def opened(self, scratch: Path, progress: Progress | None = None) -> Iterator[Drive]:
        """Simulate the twin, unless it is kept from before; it is gone at the end, unless it is to be kept."""
        if self.keep is not None:
            yield open_drive(self._kept(self.keep, progress))
            return
        with tempfile.TemporaryDirectory(prefix=".twin-", dir=scratch) as folder:
            path = Path(folder) / self.name
            self._simulate(path, progress)
            yield open_drive(path)

    def explain(self, frame: int, settings: tuple[str, ...]) -> list[str]:
        """Return the command lines that make the twin, unless it is kept, and draw the steps at a frame."""
        drive = self._place(self.keep) if self.keep is not None else Path(f"twin_{self.name}")
        show = _explain(drive, frame, self.name, self.osm, settings)
        if self.keep is not None:
            return [show]
        make = ["interloc", "simulate", "twin", self.name, "--kitti", str(self.kitti), "--seed", str(self.seed)]
        make += ["--poses", self.poses, "-o", str(drive)]
        return [shlex.join(make), show]

    def _place(self, keep: Path) -> Path:
        return keep / f"{self.name}_{self.poses}_seed{self.seed}"

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
            with atomic_write(path / TWIN_FACTS) as handle:  # last: a folder that has it is complete
                handle.write(json.dumps({"fingerprint": now}).encode())
        return path

    def _simulate(self, path: Path, progress: Progress | None) -> None:
        from interloc.simulate.config import SimulationOptions  # noqa: PLC0415
        from interloc.simulate.twins import simulate_twin  # noqa: PLC0415 - not needed where all twins are kept

        options = SimulationOptions(seed=self.seed, keyframes_only=True, ground_only=True, max_scans=self.max_scans)
        simulate_twin(self.kitti, self.name, path, options, poses=self.poses, progress=progress)


def _explain(drive: Path, frame: int, name: str, osm: Path, options: tuple[str, ...]) -> str:
    out = f"explain_{name.replace('/', '_')}_{frame}"
    words = ["interloc", "explain", str(drive), "--frame", str(frame), "-o", out, "--osm", str(osm), *options]
    return shlex.join(words)
