"""The drives of a benchmark and how they are found: folders on disk, SemanticKITTI, and simulated twins of KITTI."""

from __future__ import annotations

import csv
import json
import re
import shlex
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from interloc.benchmark.fingerprint import file_facts, fingerprint, simulating_program
from interloc.drive import Drive
from interloc.drives.georeference.oxts import ODOMETRY_OF_RAW
from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions, LabelFolder
from interloc.errors import ConfigError, DriveError, GeoreferenceError, MapError
from interloc.evaluation.published import SEQUENCES
from interloc.files import write_file
from interloc.osm.container import MAP_ENDINGS
from interloc.processes import Progress

Poses = Literal["suma", "gt"]

AXES = "axes.csv"
KNOWN_AXES = Path(__file__).parent / "axes"
"""Where the axes of roads meet, a file per map: read by eye off road maps that people drew from satellite images, to
about 0.5 m (docs/accuracy.md says how). Places that could not be told have no coordinates, and a note why."""
TWIN_FACTS = "twin.json"
KITTI_SENSOR = "hdl-64e"


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

        Raises
        ------
        DriveError
            A file is damaged.
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
        """Raise what is wrong with the drive, as far as that shows without reading all of it.

        Raises
        ------
        DriveError, GeoreferenceError
            The drive is damaged, or has no georeference to compare it with a map by.
        """
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
        return [_explain(self.path, frame, self.name, self.osm, (*options, *settings))]


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
    sensor: str = KITTI_SENSOR
    """One of `interloc.simulate.config.SENSORS`."""

    @property
    def name(self) -> str:
        """Name in the tables: the sequence, and the sensor where it is not KITTI's."""
        return self.sequence if self.sensor == KITTI_SENSOR else f"{self.sequence} {self.sensor}"

    @property
    def shows_service_roads(self) -> bool:
        """Whether service roads are labelled as road: in half of the seeds."""
        return self.seed % 2 == 1

    @property
    def osm(self) -> Path:
        """Map of the sequence."""
        return self.kitti / "osm" / f"{self.sequence}.osm.gz"

    @property
    def inputs(self) -> list[Path]:
        """All files that the twin is made of."""
        from interloc.simulate.twins import twin_files  # noqa: PLC0415 - not needed for recorded drives

        return list(twin_files(self.kitti, self.sequence, poses=self.poses).values())

    def axes(self) -> None:
        """Return None: in a simulated drive the axes of the roads meet at the nodes of the map."""

    def facts(self) -> dict[str, Any]:
        """Return what the twin depends on: inputs, seed, and the simulator."""
        return {
            "twin": self.sequence,
            "seed": self.seed,
            "service_roads": self.shows_service_roads,
            "sensor": self.sensor,
            "poses": self.poses,
            "max_scans": self.max_scans,
            "files": file_facts(self.inputs),
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
        drive = self._place(self.keep) if self.keep is not None else Path(f"twin_{self._file_name}")
        show = _explain(drive, frame, self._file_name, self.osm, settings)
        if self.keep is not None:
            return [show]
        make = ["interloc", "simulate", "twin", self.sequence, "--kitti", str(self.kitti), "--seed", str(self.seed)]
        make += [] if self.sensor == KITTI_SENSOR else ["--sensor", self.sensor]
        make += ["--service-roads"] if self.shows_service_roads else []
        make += ["--poses", self.poses, "-o", str(drive)]
        return [shlex.join(make), show]

    def _place(self, keep: Path) -> Path:
        return keep / f"{self._file_name}_{self.poses}_seed{self.seed}"

    @property
    def _file_name(self) -> str:
        return self.name.replace(" ", "_")

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
        from interloc.simulate.config import SENSORS, SceneConfig, SimulationOptions, StreetConfig  # noqa: PLC0415
        from interloc.simulate.drive import simulate  # noqa: PLC0415
        from interloc.simulate.twins import twin_trip  # noqa: PLC0415 - not needed where all twins are kept

        options = SimulationOptions(
            seed=self.seed,
            keyframes_only=True,
            ground_only=True,
            max_scans=self.max_scans,
            scene=SceneConfig(
                streets=StreetConfig(service_roads="road" if self.shows_service_roads else "other_ground")
            ),
            sensor=SENSORS[self.sensor],
        )
        simulate(twin_trip(self.kitti, self.sequence, poses=self.poses), path, options, progress=progress)


Case = FolderCase | TwinCase


def _explain(drive: Path, frame: int, name: str, osm: Path, options: tuple[str, ...]) -> str:
    out = f"explain_{name.replace('/', '_')}_{frame}"
    words = ["interloc", "explain", str(drive), "--frame", str(frame), "-o", out, "--osm", str(osm), *options]
    return shlex.join(words)


def twin_cases(
    kitti: Path,
    sequences: Sequence[str] = SEQUENCES,
    *,
    seeds: int | Sequence[int] = 1,
    poses: Poses = "suma",
    keep: Path | None = None,
    max_scans: int | None = None,
    sensors: Sequence[str] = (KITTI_SENSOR,),
) -> list[TwinCase]:
    """Return the twins of some sequences, each with several sensors and seeds: so many of them, or these.

    Raises
    ------
    ConfigError
        There is no such sensor.
    DriveError
        The folder, or a file of a sequence, is missing.
    """
    from interloc.simulate.config import SENSORS  # noqa: PLC0415 - not needed for recorded drives

    for sensor in sensors:
        if sensor not in SENSORS:
            raise ConfigError(f"sensors: there is no '{sensor}'; choose from {', '.join(SENSORS)}")
    if not kitti.is_dir():
        raise DriveError(f"{kitti}: no such folder. Expected oxts/, poses_{poses}/, calib/, times/ and osm/ in it.")
    cases = []
    for sequence in sequences:
        case = TwinCase(kitti, sequence, poses=poses, keep=keep, max_scans=max_scans)
        missing = [path.relative_to(kitti).as_posix() for path in case.inputs if not path.is_file()]
        if missing:
            complete = [s for s in _numbered(kitti / "oxts") if _is_complete(TwinCase(kitti, s, poses=poses))]
            raise DriveError(
                f"{kitti}: sequence {sequence} has no {', '.join(missing)}. "
                f"Sequences with all that a twin needs: {', '.join(complete) or 'none'}."
            )
        cases += [
            TwinCase(kitti, sequence, seed, poses, keep, max_scans, sensor)
            for sensor in sensors
            for seed in (range(seeds) if isinstance(seeds, int) else seeds)
        ]
    return cases


def semantickitti_cases(
    root: Path,
    oxts: Path,
    osm: Path,
    sequences: Sequence[str] = SEQUENCES,
    *,
    labels: LabelFolder = "labels",
) -> list[FolderCase]:
    """Return sequences of SemanticKITTI with their georeference and maps.

    Parameters
    ----------
    root
        Folder with `sequences/NN` or `dataset/sequences/NN`.
    oxts
        Folder with `NN.txt[.gz]`, or with the KITTI raw drives under their published names, at any of two depths.
    osm
        Folder with `NN.osm[.gz|.bz2|.pbf]`.
    sequences
    labels
        Folder of the labels.

    Raises
    ------
    DriveError, GeoreferenceError, MapError
        Something is missing; the message says what was looked for.
    """
    base = next((folder for folder in (root / "sequences", root / "dataset" / "sequences") if folder.is_dir()), None)
    if base is None:
        raise DriveError(f"{root}: no sequences/ and no dataset/sequences/ in it. Expected the root of SemanticKITTI.")
    cases = []
    for sequence in sequences:
        path = base / sequence
        if not path.is_dir():
            raise DriveError(f"{path}: no such folder. There are: {', '.join(_numbered(base)) or 'none'}.")
        options = DriveOptions(labels=labels, oxts=_find_oxts(oxts, sequence))
        cases.append(FolderCase(sequence, path, _find_map(osm, sequence), options))
    return cases


def folder_cases(
    drives: Sequence[Path],
    maps: Sequence[Path],
    options: DriveOptions | None = None,
) -> list[FolderCase]:
    """Return any drives, with one map for all, or one map per drive in their order.

    Raises
    ------
    ConfigError
        There are neither one map nor as many as drives.
    DriveError, MapError
        A folder or a map is missing.
    """
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


def _is_complete(case: TwinCase) -> bool:
    return all(path.is_file() for path in case.inputs)


def _numbered(folder: Path) -> list[str]:
    if not folder.is_dir():
        return []
    return sorted({entry.name[:2] for entry in folder.iterdir() if re.fullmatch(r"\d\d(\..+)?", entry.name)})
