"""The plan of a client that reduces its drive itself: made by a worker, since it reads files of any size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from interloc.drives.reduction.plan import ReductionPlan


def plan(root: Path, numbers: Sequence[int], options: dict[str, Any]) -> ReductionPlan:
    """Call `plan_reduction`."""
    from interloc.drives.reduction.plan import plan_reduction  # noqa: PLC0415 - the server starts without it

    return plan_reduction(root, numbers, **options)
