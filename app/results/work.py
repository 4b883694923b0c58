"""Short work that a request waits for: pictures of a keyframe, files for other programs."""

import hashlib
import json
import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np

from app.work.requests import IntersectionsJob
from interloc.files import atomic_folder, write_file
from interloc.output.layout import ROAD_FILE
from interloc.output.road import draw_road, read_road
from interloc.output.vector_files import write_vector_file
from interloc.results import versions

VIEW = "view.json"
"""File with the place of pictures and the numbers behind them; it is written last."""

ROAD_PICTURE = "road.png"

_KEPT = 300  # keyframes per job whose pictures are kept, about 100 kB each


def draw_keyframe(drive_folder: Path, drive_name: str, request: IntersectionsJob, frame: int, folder: Path) -> int:
    """Draw all overlays of the keyframe nearest to a scan into a folder, which appears complete or not at all.

    Returns the number of that keyframe; nothing was drawn if it is another one than asked for. Drive and request are
    those of the job, as it was worked on.
    """
    from app.jobs.work.intersections import open_input  # noqa: PLC0415 - the method, which the server does without
    from interloc.explain.evidence import gather  # noqa: PLC0415
    from interloc.explain.figures import OVERLAYS, describe_overlays, draw_overlay  # noqa: PLC0415

    drive, keyframes = open_input(drive_folder, drive_name, request)
    frames = drive.frames[keyframes]
    nearest = int(frames[np.argmin(np.abs(frames - frame))])
    if nearest != frame:
        return nearest
    evidence = gather(drive, frame, request.config)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with atomic_folder(folder, marker=VIEW) as new:
        for layer in OVERLAYS:
            write_file(new / f"{layer}.png", draw_overlay(evidence, layer))
        view = describe_overlays(evidence, drive_name, drive.georeference)
        write_file(new / VIEW, json.dumps(view, allow_nan=False).encode() + b"\n")
    with suppress(OSError):
        by_age = sorted(folder.parent.iterdir(), key=lambda each: each.stat().st_mtime)
        for oldest in by_age[:-_KEPT]:
            shutil.rmtree(oldest, ignore_errors=True)
    return nearest


def export_path(cache: Path, name: str, drive_name: str) -> Path:
    """Return where an export is kept in the cache of a job: of this version, and of this name of the drive."""
    named = hashlib.sha256(drive_name.encode()).hexdigest()[:8]
    return cache / "exports" / f"{versions()['interloc']}-{named}" / name


def write_export(folder: Path, path: Path, layer: str | None, drive_name: str) -> None:
    """Write a layer of a result, or all of them, as a file for other programs; its suffix says which format.

    What another version has written, or under another name, goes (see `export_path`).
    """
    with suppress(OSError):
        for other in path.parent.parent.iterdir():
            if other.is_file():
                other.unlink()
            elif other != path.parent:
                shutil.rmtree(other, ignore_errors=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_vector_file(folder, path, layer=layer, drive=drive_name)


def draw_road_picture(result: Path, folder: Path) -> None:
    """Draw the road seen by LiDAR into a folder, which appears complete or not at all."""
    mosaic = read_road(result / ROAD_FILE)
    picture = draw_road(mosaic)
    bounds = list(picture.bounds)
    view = {
        "bounds_lonlat": None if mosaic.epsg is None else bounds,
        "bounds_world_m": bounds if mosaic.epsg is None else None,
        "size_px": list(picture.size),
        "picture_resolution_m": picture.cell_m,
        "resolution_m": mosaic.raster.cell_m,
        "crs": None if mosaic.epsg is None else f"EPSG:{mosaic.epsg}",
    }
    folder.parent.mkdir(parents=True, exist_ok=True)
    with atomic_folder(folder, marker=VIEW) as new:
        write_file(new / ROAD_PICTURE, picture.png)
        write_file(new / VIEW, json.dumps(view, allow_nan=False).encode() + b"\n")
