"""Which drives a benchmark is about: twins of KITTI sequences, SemanticKITTI itself, or any folders."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from interloc.benchmark.cases import FolderCase, Poses, TwinCase
from interloc.drives.georeference.oxts import ODOMETRY_OF_RAW
from interloc.errors import ConfigError, DriveError, GeoreferenceError, MapError
from interloc.evaluation.published import SEQUENCES

MAP_ENDINGS = (".osm", ".osm.gz", ".osm.bz2", ".osm.pbf")


def twin_cases(
    kitti: Path,
    sequences: Sequence[str] = SEQUENCES,
    *,
    seeds: int = 1,
    poses: Poses = "suma",
    keep: Path | None = None,
    max_scans: int | None = None,
) -> list[TwinCase]:
    """Return the twins of some sequences, each with several seeds.

    Raises
    ------
    DriveError
        The folder, or a file of a sequence, is missing.
    """
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
        cases += [TwinCase(kitti, sequence, seed, poses, keep, max_scans) for seed in range(seeds)]
    return cases


def semantickitti_cases(
    root: Path,
    oxts: Path,
    osm: Path,
    sequences: Sequence[str] = SEQUENCES,
    **options: Any,  # noqa: ANN401 - passed on
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
    options
        Of `open_drive`.

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
        cases.append(
            FolderCase(sequence, path, _find_map(osm, sequence), {**options, "oxts": _find_oxts(oxts, sequence)})
        )
    return cases


def folder_cases(
    drives: Sequence[Path],
    maps: Sequence[Path],
    **options: Any,  # noqa: ANN401 - passed on
) -> list[FolderCase]:
    """Return any drives, with one map for all, or one map a drive in their order.

    Raises
    ------
    ConfigError
        There are neither one map nor as many as drives.
    DriveError, MapError
        A folder or a map is missing.
    """
    if len(maps) not in {1, len(drives)}:
        raise ConfigError(
            f"--osm: {len(maps)} maps for {len(drives)} drives. Expected one for all, or one a drive in their order."
        )
    for path in maps:
        if not path.is_file():
            raise MapError(f"{path}: no such file. Expected an OSM file: {', '.join(MAP_ENDINGS)}.")
    for path in drives:
        if not path.is_dir():
            raise DriveError(f"{path}: no such folder. Expected the folder of a drive.")
    chosen = maps if len(maps) == len(drives) else [maps[0]] * len(drives)
    return [
        FolderCase(name, path, osm, dict(options))
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
    """Return the sequence numbers that name files or folders in a folder."""
    if not folder.is_dir():
        return []
    return sorted({entry.name[:2] for entry in folder.iterdir() if re.fullmatch(r"\d\d(\..+)?", entry.name)})
