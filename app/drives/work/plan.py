"""The plan for a client that reduces a drive itself, made from the small files that are there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from interloc.config import KeyframeConfig
from interloc.drives.findings import Finding
from interloc.drives.labels import LabelJudgement
from interloc.drives.layouts import ScanFolder
from interloc.drives.options import LabelFolder, ReadingOptions
from interloc.drives.scans.reduced_format import ReducedLabels
from interloc.reduction.plan import ReductionPlan, judge_counts, plan_reduction


def plan_and_judge(
    root: Path,
    numbers: Sequence[int],
    options: ReadingOptions,
    keyframes: KeyframeConfig | None,
    scan_folder: ScanFolder | None,
    label_counts: dict[LabelFolder, dict[int, int]],
) -> tuple[ReductionPlan, dict[LabelFolder, tuple[LabelJudgement, list[Finding]]]]:
    """Plan the reduction of a drive, and judge the label ids that were counted in its scans.

    Parameters
    ----------
    root, numbers, options, keyframes, scan_folder
        As of `plan_reduction`.
    label_counts
        For each label folder, how many points carry each label id.
    """
    made = plan_reduction(root, numbers, options, keyframes=keyframes, scan_folder=scan_folder)
    judged = {folder: judge_counts(made, folder, counts) for folder, counts in label_counts.items()}
    if made.manifest is not None:
        known = [
            ReducedLabels.of(folder, labels.scheme, labels.counts)
            for folder, (labels, _) in judged.items()
            if labels.scheme is not None
        ]
        made = replace(made, manifest=made.manifest.with_labels(known))
    return made, judged
