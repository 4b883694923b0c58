"""The plan of a client that reduces its drive itself: made by a worker, since it reads files of any size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from interloc.drives.findings import Finding
    from interloc.drives.options import LabelFolder
    from interloc.drives.scans.labels import LabelJudgement
    from interloc.reduction.plan import ReductionPlan


def plan(
    root: Path, numbers: Sequence[int], options: dict[str, Any], label_counts: dict[LabelFolder, dict[int, int]]
) -> tuple[ReductionPlan, dict[LabelFolder, tuple[LabelJudgement, list[Finding]]]]:
    """Plan the reduction of a drive, and judge the label ids that were counted in its scans."""
    from interloc.drives.scans.reduced_format import ReducedLabels  # noqa: PLC0415 - the server starts without it
    from interloc.reduction.plan import judge_counts, plan_reduction  # noqa: PLC0415

    made = plan_reduction(root, numbers, **options)
    judged = {folder: judge_counts(made, folder, counts) for folder, counts in label_counts.items()}
    if made.manifest is not None:
        known = [
            ReducedLabels.of(folder, labels.scheme, labels.counts)
            for folder, (labels, _) in judged.items()
            if labels.scheme is not None
        ]
        made = replace(made, manifest=made.manifest.with_labels(known))
    return made, judged
