"""What lies under the vehicle is road: labels whose scheme says otherwise are read by the wrong scheme."""

from __future__ import annotations

from collections import Counter

import numpy as np

from interloc.arrays import Float32Array, UInt32Array
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.labels import LEARNING, LabelScheme

_NEAREST_M, _FARTHEST_M = 2.5, 6.0
_LOWEST, _ABOVE_M = 20.0, 0.3
_HARDLY, _MOSTLY = 0.25, 0.5
_ENOUGH = 50
_NUSCENES_ROAD, _NUSCENES_IDS = 11, 16


def ids_below(points: Float32Array, labels: UInt32Array) -> Counter[int]:
    """Count the ids of the ground around the vehicle, of (N, 4) points in L and their (N,) labels."""
    with np.errstate(invalid="ignore"):
        distance = np.hypot(points[:, 0], points[:, 1])
        near = (distance > _NEAREST_M) & (distance < _FARTHEST_M) & np.isfinite(points[:, 2])
    if np.count_nonzero(near) < _ENOUGH:
        return Counter()
    height = points[near, 2]
    lowest = height < np.percentile(height, _LOWEST) + _ABOVE_M
    ids, counts = np.unique(labels[near][lowest] & 0xFFFF, return_counts=True)
    return Counter(dict(zip(ids.tolist(), counts.tolist(), strict=True)))


def check_below(folder: str, below: Counter[int], scheme: LabelScheme, ids: set[int], findings: Findings) -> None:
    """Check that the ground around the vehicle is road.

    Parameters
    ----------
    folder : str
        Of the labels, in messages.
    below : Counter
        `ids_below` of some scans.
    ids : set of int
        All ids of these scans.
    """
    total = sum(below.values())
    if not total or not ids & scheme.road:  # without any road, that is said already
        return
    usual, count = below.most_common(1)[0]
    if sum(below[label] for label in scheme.road) > _HARDLY * total or count < _MOSTLY * total:
        return
    text = (
        f"{count / total:.0%} of the ground around the vehicle has id {usual}, which is no road in scheme "
        f"{scheme.name} (road: {', '.join(map(str, sorted(scheme.road)))}). "
    )
    if scheme.name == LEARNING.name and usual + 1 in scheme.road:
        findings.error(
            DriveFileError(
                folder,
                f"{text}Usual cause: ids that are one less, 0 to 18 with road = 8, as MMDetection3D writes them. Use "
                f"--label-scheme {usual}, or add 1 to every id.",
            )
        )
    elif scheme.name == LEARNING.name and usual == _NUSCENES_ROAD and max(ids) <= _NUSCENES_IDS:
        findings.error(
            DriveFileError(
                folder,
                f"{text}Usual cause: the 16 classes of nuScenes-lidarseg, whose driveable surface is 11. Use "
                f"--label-scheme {usual}.",
            )
        )
    elif usual in scheme.confusable | {0}:
        findings.warning(folder, f"{text}Usual cause: a drive off the road, or another label scheme.")
    else:
        findings.error(
            DriveFileError(
                folder,
                f"{text}Usual cause: another label scheme; name it, or give the ids of road, such as --label-scheme "
                f"{usual}.",
            )
        )
