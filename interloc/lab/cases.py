"""The drives of a benchmark: recorded ones, and twins: the track of a KITTI sequence, simulated over its real map."""

import csv
import os
import re
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from interloc.drive import Drive
from interloc.drives.files import SourceFile
from interloc.drives.georeference.read import raw_drive_of, read_oxts_rows
from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions, LabelFolder
from interloc.errors import ConfigError, DriveError, GeoreferenceError, MapError
from interloc.evaluation.compare import SEQUENCES
from interloc.lab.config import SceneConfig, SimulationOptions, StreetConfig
from interloc.lab.drive import Trip, simulate
from interloc.lab.streets import read_map
from interloc.lab.tracks import track_from_oxts
from interloc.osm.untrusted import MAP_ENDINGS
from interloc.processes import Progress
from interloc.results import versions
from interloc.wording import counted

AXES = "axes.csv"
KNOWN_AXES = Path(__file__).parent / "axes"
"""Where the axes of roads meet, a file per map: read by eye off road maps that people drew from satellite images, to
about 0.5 m (docs/accuracy.md says how). Places that could not be told have no coordinates, and a note why."""


def _state(*paths: Path) -> str:
    """Return a checksum of paths, sizes and times of files, and of all in folders: another one if any was replaced."""
    checksum = 0
    for path in paths:
        walked = os.walk(path.resolve(), followlinks=True)
        for each in sorted(Path(folder, name) for folder, _, names in walked for name in names) or [path.resolve()]:
            with suppress(OSError):  # it is missing, which its reader says
                status = each.stat()
                checksum = zlib.crc32(os.fsencode(f"{each} {status.st_size} {status.st_mtime_ns}"), checksum)
    return f"{checksum:08x}"


@dataclass(frozen=True)
class FolderCase:
    """A drive on disk."""

    name: str
    path: Path
    osm: Path
    """Folder of the drive, and the map to score it against."""
    options: DriveOptions = field(default_factory=DriveOptions)
    seed: None = None

    @cached_property
    def inputs(self) -> str:
        """Files, their state, and how they are read."""
        others = (self.options.oxts, self.options.poses, self.options.model)
        state = _state(self.path, self.osm, *(Path(each) for each in others if each is not None))
        return f"{self.path.resolve()}, {self.osm.resolve()}, {self.options!r}, {state}"

    def axes(self) -> dict[int, tuple[float, float]]:
        """Return longitude and latitude of where the axes of the roads meet, by the id of the node of OpenStreetMap.

        They stand in `axes.csv` of the drive (osm_id, lon, lat), or are those of `KNOWN_AXES`.
        """
        own = self.path / AXES
        found: dict[int, tuple[float, float]] = {}
        for path in [own] if own.is_file() else sorted(KNOWN_AXES.glob("*.csv")):
            try:
                with path.open(newline="", encoding="utf-8-sig") as lines:
                    rows = [row for row in csv.DictReader(lines) if row["lon"]]
                found |= {int(row["osm_id"]): (float(row["lon"]), float(row["lat"])) for row in rows}
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise DriveError(
                    f"{path}: expected a line osm_id,lon,lat and such numbers below it ({error})."
                ) from error
        return found

    def check(self) -> None:
        """Raise what is wrong with the drive, as far as that shows without reading all of it."""
        try:
            drive = open_drive(self.path, self.options)
        except (DriveError, GeoreferenceError) as error:
            kind = GeoreferenceError if isinstance(error, GeoreferenceError) else DriveError
            raise kind(f"{self.path}: {error}") from error
        if drive.georeference is None:
            raise GeoreferenceError(
                f"{self.path}: the drive has no georeference, so it cannot be compared with OpenStreetMap. "
                "Put oxts/data or geo.csv into it."
            )

    @contextmanager
    def opened(self, scratch: Path, progress: Progress | None = None) -> Iterator[Drive]:  # noqa: ARG002 - as the others
        """Give the drive."""
        yield open_drive(self.path, self.options)


def semantickitti_cases(
    root: Path, oxts: Path, osm: Path, sequences: Sequence[str] = SEQUENCES, *, labels: LabelFolder = "labels"
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
        maps = [each for ending in MAP_ENDINGS if (each := osm / f"{sequence}{ending}").is_file()]
        if not maps:
            endings = ", ".join(MAP_ENDINGS)
            raise MapError(f"{osm}: no map of sequence {sequence}. Expected {sequence} with one of {endings}.")
        cases.append(FolderCase(sequence, path, maps[0], options))
    return cases


def folder_cases(drives: Sequence[Path], maps: Sequence[Path], options: DriveOptions | None = None) -> list[FolderCase]:
    """Return any drives, with one map for all, or one map per drive in their order."""
    if len(maps) not in {1, len(drives)}:
        raise ConfigError(
            f"--osm: {counted(len(maps), 'map')} for {counted(len(drives), 'drive')}. "
            "Expected one for all, or one per drive in their order."
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


def _find_oxts(folder: Path, sequence: str) -> Path:
    for ending in (".txt", ".txt.gz"):
        if (path := folder / f"{sequence}{ending}").is_file():
            return path
    raw = raw_drive_of(sequence)
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


def twin_files(kitti_dir: Path, sequence: str) -> dict[str, Path]:
    """Return the files that a twin is made of; `buildings` only where there are any: else houses are made up."""
    files = {
        "oxts": kitti_dir / "oxts" / f"{sequence}.txt.gz",
        "poses": kitti_dir / "poses_suma" / f"{sequence}.txt",
        "calib": kitti_dir / "calib" / f"{sequence}.txt",
        "times": kitti_dir / "times" / f"{sequence}.txt",
        "osm": kitti_dir / "osm" / f"{sequence}.osm.gz",
    }
    buildings = kitti_dir / "osm_buildings" / f"{sequence}.osm.gz"
    return files | ({"buildings": buildings} if buildings.is_file() else {})


def twin_trip(kitti_dir: Path, sequence: str) -> Trip:
    """Return a sequence as it is to be simulated: places from OXTS, written with the poses of SemanticKITTI (SuMa)."""
    files = twin_files(kitti_dir, sequence)
    rows = read_oxts_rows(SourceFile(files["oxts"], Path()))
    camera = np.loadtxt(files["poses"]).reshape(-1, 3, 4)
    times = np.loadtxt(files["times"])
    count = min(len(rows), len(camera), len(times))
    track = track_from_oxts(rows[:count], times[:count])
    track = replace(track, poses_camera=camera[:count], calib_text=files["calib"].read_text())
    return Trip(track, read_map(files["osm"], files.get("buildings")), {"twin": sequence})


@dataclass(frozen=True)
class TwinCase:
    """A KITTI twin: the real track of a sequence, simulated over its real map with a LiDAR."""

    kitti: Path
    """Folder with `oxts/`, `poses_suma/`, `calib/`, `times/`, `osm/` and, if known, `osm_buildings/`."""
    sequence: str
    """Two digits."""
    seed: int = 0
    """Seed of everything random; with an odd one service roads are labelled as road, which the policy does not count.
    """
    keep: Path | None = None
    """Folder in which twins stay and are found again."""
    max_scans: int | None = None
    """Number of keyframes after which the drive ends."""

    @property
    def name(self) -> str:
        """Name in the tables."""
        return self.sequence

    @property
    def osm(self) -> Path:
        """Map of the sequence."""
        return self.kitti / "osm" / f"{self.sequence}.osm.gz"

    @cached_property
    def inputs(self) -> str:
        """Files, their state, and how many scans are simulated."""
        state = _state(*twin_files(self.kitti, self.sequence).values())
        return f"{self.kitti.resolve()}, {self.max_scans}, {state}"

    def axes(self) -> None:
        """Return None: in a simulated drive the axes of the roads meet at the nodes of the map."""

    def check(self) -> None:
        """Do nothing: its inputs were looked for when it was planned."""

    @contextmanager
    def opened(self, scratch: Path, progress: Progress | None = None) -> Iterator[Drive]:
        """Simulate the twin, unless it is kept from before; it is gone at the end, unless it is to be kept."""
        scene = SceneConfig(streets=StreetConfig(service_roads="road" if self.seed % 2 else "other_ground"))
        options = SimulationOptions(
            seed=self.seed, keyframes_only=True, ground_only=True, max_scans=self.max_scans, scene=scene
        )
        made_of = zlib.crc32(f"{self.inputs} {versions()}".encode())
        with nullcontext(self.keep) if self.keep else TemporaryDirectory(prefix=".twin-", dir=scratch) as folder:
            path = Path(folder) / f"{self.sequence}_seed{self.seed}_{made_of:08x}"
            if not path.is_dir():  # a drive is written whole or not at all
                simulate(twin_trip(self.kitti, self.sequence), path, options, progress=progress)
            yield open_drive(path)


Case = FolderCase | TwinCase


def twin_cases(
    kitti: Path,
    sequences: Sequence[str] = SEQUENCES,
    *,
    seeds: int | Sequence[int] = 1,
    keep: Path | None = None,
    max_scans: int | None = None,
) -> list[TwinCase]:
    """Return the twins of some sequences, each with several seeds: so many of them, or these."""
    if not kitti.is_dir():
        raise DriveError(f"{kitti}: no such folder. Expected oxts/, poses_suma/, calib/, times/ and osm/ in it.")

    def missing(sequence: str) -> list[str]:
        needed = twin_files(kitti, sequence).values()
        return [path.relative_to(kitti).as_posix() for path in needed if not path.is_file()]

    for sequence in sequences:
        if lacks := missing(sequence):
            complete = [each for each in numbered(kitti / "oxts") if not missing(each)]
            raise DriveError(
                f"{kitti}: sequence {sequence} has no {', '.join(lacks)}. "
                f"Sequences with all that a twin needs: {', '.join(complete) or 'none'}."
            )
    numbers = range(seeds) if isinstance(seeds, int) else seeds
    return [TwinCase(kitti, sequence, seed, keep, max_scans) for sequence in sequences for seed in numbers]
