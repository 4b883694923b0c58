"""The drives of a benchmark and how they are found, and what a measurement of them depends on."""

import csv
import hashlib
import json
import re
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from interloc.drive import Drive
from interloc.drives.georeference.read import ODOMETRY_OF_RAW
from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions, LabelFolder
from interloc.errors import ConfigError, DriveError, GeoreferenceError, MapError
from interloc.evaluation.published import SEQUENCES
from interloc.osm.container import MAP_ENDINGS
from interloc.processes import Progress

AXES = "axes.csv"
KNOWN_AXES = Path(__file__).parent / "axes"
"""Where the axes of roads meet, a file per map: read by eye off road maps that people drew from satellite images, to
about 0.5 m (docs/accuracy.md says how). Places that could not be told have no coordinates, and a note why."""
_PACKAGE = Path(__file__).resolve().parents[1]
_WITHOUT_INFLUENCE = ("cli", "client", "explain")
"""Parts of this package that no figure depends on."""
_SIMULATOR = ("config", "drive", "ground", "lidar", "raycast", "scene", "streets", "tracks", "twins")
"""Modules that a simulated drive depends on."""


@dataclass(frozen=True)
class FolderCase:
    """A drive on disk."""

    name: str
    """Name in the tables."""
    path: Path
    osm: Path
    """Folder of the drive, and the map to score it against."""
    options: DriveOptions = field(default_factory=DriveOptions)
    """How the drive is read."""
    seed: None = None

    def axes(self) -> dict[int, tuple[float, float]]:
        """Return longitude and latitude of where the axes of the roads meet, by the id of the node of OpenStreetMap.

        They stand in `axes.csv` of the drive (osm_id, lon, lat), or are those of `KNOWN_AXES`.
        """
        own = self.path / AXES
        found: dict[int, tuple[float, float]] = {}
        for path in [own] if own.is_file() else sorted(KNOWN_AXES.glob("*.csv")):
            try:
                with path.open(newline="") as lines:
                    rows = [row for row in csv.DictReader(lines) if row["lon"]]
                found |= {int(row["osm_id"]): (float(row["lon"]), float(row["lat"])) for row in rows}
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise DriveError(
                    f"{path}: expected a line osm_id,lon,lat and such numbers below it ({error})."
                ) from error
        return found

    def facts(self) -> dict[str, Any]:
        """Return what the drive depends on: names, sizes and times of all files."""
        given = [] if self.options.oxts is None else [self.options.oxts]
        return {
            "files": file_facts([self.path, self.osm, *given]),
            "axes": self.axes(),
            "options": self.options.model_dump(mode="json", exclude={"oxts"}),
        }

    def check(self) -> None:
        """Raise what is wrong with the drive, as far as that shows without reading all of it."""
        try:
            drive = open_drive(self.path, self.options)
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
        yield open_drive(self.path, self.options)

    def explain(self, frame: int, settings: tuple[str, ...]) -> list[str]:
        """Return the command lines that draw the steps of the method at a frame."""
        unusual = self.options.model_dump(mode="json", exclude_defaults=True)
        options = [text for name, value in unusual.items() for text in (f"--{name.replace('_', '-')}", value)]
        return [explain_command(self.path, frame, self.name, self.osm, (*options, *settings))]


def explain_command(drive: Path, frame: int, name: str, osm: Path, options: tuple[str, ...]) -> str:
    """Return the command line that draws the steps of the method at a frame of a drive."""
    out = f"explain_{name.replace('/', '_')}_{frame}"
    words = ["interloc", "explain", str(drive), "--frame", str(frame), "-o", out, "--osm", str(osm), *options]
    return shlex.join(words)


def semantickitti_cases(
    root: Path,
    oxts: Path,
    osm: Path,
    sequences: Sequence[str] = SEQUENCES,
    *,
    labels: LabelFolder = "labels",
) -> list[FolderCase]:
    """Return sequences of SemanticKITTI with their georeference and maps; a message says what is missing.

    `root` holds `sequences/NN` or `dataset/sequences/NN`; `oxts` holds `NN.txt[.gz]`, or the KITTI raw drives under
    their published names, at any of two depths; `osm` holds `NN.osm[.gz|.bz2|.pbf]`.
    """
    base = next((folder for folder in (root / "sequences", root / "dataset" / "sequences") if folder.is_dir()), None)
    if base is None:
        raise DriveError(f"{root}: no sequences/ and no dataset/sequences/ in it. Expected the root of SemanticKITTI.")
    cases = []
    for sequence in sequences:
        path = base / sequence
        if not path.is_dir():
            raise DriveError(f"{path}: no such folder. There are: {', '.join(numbered(base)) or 'none'}.")
        options = DriveOptions(labels=labels, oxts=_find_oxts(oxts, sequence))
        cases.append(FolderCase(sequence, path, _find_map(osm, sequence), options))
    return cases


def folder_cases(
    drives: Sequence[Path],
    maps: Sequence[Path],
    options: DriveOptions | None = None,
) -> list[FolderCase]:
    """Return any drives, with one map for all, or one map per drive in their order."""
    if len(maps) not in {1, len(drives)}:
        raise ConfigError(
            f"--osm: {len(maps)} maps for {len(drives)} drives. Expected one for all, or one per drive in their order."
        )
    for path in maps:
        if not path.is_file():
            raise MapError(f"{path}: no such file. Expected an OSM file: {', '.join(MAP_ENDINGS)}.")
    for path in drives:
        if not path.is_dir():
            raise DriveError(f"{path}: no such folder. Expected the folder of a drive.")
    chosen = maps if len(maps) == len(drives) else [maps[0]] * len(drives)
    return [
        FolderCase(name, path, osm, options or DriveOptions())
        for name, path, osm in zip(_names(drives), drives, chosen, strict=True)
    ]


def _names(drives: Sequence[Path]) -> list[str]:
    """Name drives by their folders, with as many of the folders above as tell them apart."""
    parts = [path.resolve().parts for path in drives]
    for length in range(1, max(map(len, parts)) + 1):
        names = ["/".join(each[-length:]) for each in parts]
        if len(set(names)) == len(names):
            return names
    twice = Counter(map(str, drives)).most_common(1)[0][0]
    raise ConfigError(f"{twice} is given twice. Expected each drive once.")


def _find_map(folder: Path, sequence: str) -> Path:
    for ending in MAP_ENDINGS:
        if (path := folder / f"{sequence}{ending}").is_file():
            return path
    raise MapError(
        f"{folder}: no map of sequence {sequence}. Expected {sequence} with one of {', '.join(MAP_ENDINGS)}."
    )


def _find_oxts(folder: Path, sequence: str) -> Path:
    for ending in (".txt", ".txt.gz"):
        if (path := folder / f"{sequence}{ending}").is_file():
            return path
    raw = next((name for name, (of, *_) in ODOMETRY_OF_RAW.items() if of == sequence), None)
    if raw is None:
        raise GeoreferenceError(
            f"{folder}: no {sequence}.txt[.gz], and the KITTI raw drive of sequence {sequence} was never published."
        )
    # As unpacked: 2011_10_03/2011_10_03_drive_0027_sync/oxts, with or without the day and the ending.
    for pattern in (f"{raw}*", f"*/{raw}*"):
        for path in sorted(folder.glob(pattern)):
            if (path / "oxts").is_dir():
                return path
    raise GeoreferenceError(
        f"{folder}: no georeference of sequence {sequence}. Expected {sequence}.txt, {sequence}.txt.gz, "
        f"or the KITTI raw drive {raw}_sync (with its oxts/), here or in a folder of its day."
    )


def numbered(folder: Path) -> list[str]:
    """Return the sequences, two digits, after which entries of a folder are named."""
    if not folder.is_dir():
        return []
    return sorted({entry.name[:2] for entry in folder.iterdir() if re.fullmatch(r"\d\d(\..+)?", entry.name)})


def fingerprint(facts: dict[str, Any]) -> str:
    """Return a short text that differs where the facts (plain values) differ."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:20]


@cache
def measuring_program() -> str:
    """Return a fingerprint of the program that measures: the whole package without what no figure depends on."""
    files = (path for path in _PACKAGE.rglob("*.py") if path.relative_to(_PACKAGE).parts[0] not in _WITHOUT_INFLUENCE)
    return _contents(files)


@cache
def simulating_program() -> str:
    """Return a fingerprint of the simulator."""
    return _contents(path for path in Path(__file__).parent.glob("*.py") if path.stem in _SIMULATOR)


def _contents(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.relative_to(_PACKAGE).as_posix().encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:20]


def file_facts(paths: Iterable[Path]) -> list[tuple[str, int, int]]:
    """Return name, size and time of change of files, and of the files in folders, in a fixed order."""
    facts = []
    for path in paths:
        files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
        for file in files:
            status = file.stat()
            name = file.relative_to(path).as_posix() if path.is_dir() else file.name
            facts.append((name, status.st_size, status.st_mtime_ns))
    return facts
