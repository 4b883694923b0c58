"""The step pictures of one keyframe as files."""

from __future__ import annotations

import json
import logging
from pathlib import Path

from interloc.config import DetectorConfig
from interloc.drawing import image, write_image
from interloc.drive import Drive
from interloc.explain.evidence import gather
from interloc.explain.figures import STEPS, overview, refinement_figure, step_figure
from interloc.explain.ground_truth import ground_truth
from interloc.explain.record import record
from interloc.explain.sheet import DPI
from interloc.files import atomic_folder, atomic_write
from interloc.osm.graph import RoadGraph
from interloc.osm.policies import Policy

logger = logging.getLogger(__name__)

RECORD = "explain.json"
OVERVIEW, REFINEMENT = "overview.png", "7_refinement.png"


def explain(
    drive: Drive,
    frame: int,
    config: DetectorConfig,
    out: Path,
    *,
    graph: RoadGraph | None = None,
    policy: Policy = "drive",
) -> list[Path]:
    """Draw the steps of the method for the keyframe nearest to a scan number.

    Parameters
    ----------
    drive
    frame : int
        Scan number. The keyframe taken is said in the log, in the pictures and in ``explain.json``.
    config
    out
        Folder of the pictures, written whole or not at all; one of an earlier call is replaced.
    graph
        Roads of OpenStreetMap to draw on top, where the drive is georeferenced.
    policy
        Which of them are roads and ground truth.

    Returns
    -------
    list of Path
        The six steps of the paper's Fig. 2, the refinement of its Fig. 5, all of them on one sheet, and the numbers.

    Raises
    ------
    ConfigError
        The drive has no such scan; there is no such policy.
    DriveError
        The drive is empty, or a scan of the window is damaged.
    OutputError
        The folder is something else's, or writing failed; nothing is left behind.
    """
    evidence = gather(drive, frame, config)
    logger.info(
        "frame %d: keyframe %d of %d is scan %d, %d keyframes in its window",
        frame,
        evidence.number + 1,
        evidence.keyframe_count,
        evidence.keyframe.frame,
        len(evidence.window),
    )
    truth = None
    if graph is not None and drive.georeference is None:
        logger.warning("%s: without georeference the roads of OpenStreetMap cannot be drawn", drive.name)
    elif graph is not None and drive.georeference is not None:
        truth = ground_truth(evidence, drive.georeference, graph, policy)
    with atomic_folder(out, marker=RECORD) as folder:
        for step in STEPS:
            write_image(folder / step.file, image(step_figure(step, evidence, truth), "png", dpi=DPI))
        write_image(folder / REFINEMENT, image(refinement_figure(evidence, truth), "png", dpi=DPI))
        write_image(folder / OVERVIEW, image(overview(evidence, truth), "png", dpi=DPI))
        with atomic_write(folder / RECORD) as handle:
            text = json.dumps(record(evidence, drive.name, truth), indent=2, allow_nan=False)
            handle.write(f"{text}\n".encode())
    return [out / name for name in (*(step.file for step in STEPS), REFINEMENT, OVERVIEW, RECORD)]
