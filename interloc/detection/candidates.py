"""Detection of intersection candidates on the centerline (paper, section III-B.6)."""

from dataclasses import dataclass, replace

import numpy as np

from interloc.arrays import FloatArray, Int32Array, IntArray
from interloc.config import CrossingCandidates, HarrisCandidates
from interloc.detection.centerline import Centerline
from interloc.kernels import skeleton
from interloc.kernels.harris import harris_scores, local_maxima

PARTED_WIDTHS = 1.2  # from one junction of the centerline to another that may be an intersection of its own


@dataclass(frozen=True)
class Candidates:
    """Where intersections may be."""

    positions: FloatArray
    """(C, 2) float64: row and column in the image, pixels."""
    widths: FloatArray
    """(C,) float64: road width there, pixels."""
    merged: list[FloatArray]
    """list of (M, 2) float64: row and column of the Harris corners or junctions of the centerline that each one stands
    for."""
    are_junctions: bool
    """Whether these are junctions of the centerline."""

    def core(self, index: int) -> FloatArray:
        """Return row and column of the junctions of the centerline in a candidate, (J, 2); none for Harris corners."""
        return self.merged[index] if self.are_junctions else np.empty((0, 2))

    def parted(self, indices: list[int]) -> "Candidates":
        """Return them with one for each of the junctions of some candidates that lie farther apart than others."""
        positions, widths, merged = list(self.positions), self.widths.tolist(), list(self.merged)
        for i in indices:
            places, groups = merge_until_stable(self.core(i), PARTED_WIDTHS * float(self.widths[i]))
            if len(places) > 1:
                parts = [self.merged[i][group] for group in groups]
                positions[i], merged[i] = places[0], parts[0]
                positions += list(places[1:])
                merged += parts[1:]
                widths += [widths[i]] * (len(parts) - 1)
        if len(positions) == len(self.positions):
            return self
        return replace(self, positions=np.array(positions), widths=np.array(widths), merged=merged)

    def inside(self, size: int, margin: float) -> IntArray:
        """Return which candidates lie at least a margin from the border of an image of ``size`` pixels per side."""
        within = (self.positions >= margin) & (self.positions <= size - 1 - margin)
        return np.flatnonzero(within.all(axis=1))


def find_candidates(centerline: Centerline, config: HarrisCandidates | CrossingCandidates) -> Candidates:
    """Find the points of the centerline where roads may meet; near ones are merged.

    Parameters
    ----------
    centerline
    config
        Its kind decides what is looked for: Harris corners (as in the paper), or junctions of the centerline.
    """
    if isinstance(config, HarrisCandidates):
        return _harris(centerline, config)
    return _crossings(centerline, config)


def harris_corners(centerline: Centerline, config: HarrisCandidates) -> tuple[Int32Array, FloatArray]:
    """Return the pixels that are Harris corners, best first, and the scores of all pixels (paper, eq. 6)."""
    scores = harris_scores(centerline.image.words, centerline.rows, centerline.cols, config.block_px, config.k)
    minimum = config.min_score * scores.max() if scores.size else 0.0
    return local_maxima(centerline.rows, centerline.cols, scores, config.peak_px, minimum), scores


def _harris(centerline: Centerline, config: HarrisCandidates) -> Candidates:
    corners, _ = harris_corners(centerline, config)
    points = np.column_stack([centerline.rows[corners], centerline.cols[corners]]).astype(np.float64)
    positions, groups = merge_until_stable(points, config.merge_m / centerline.resolution_m)
    widths = centerline.widths(corners)
    mean_widths = np.array([widths[group].mean() for group in groups])
    return Candidates(positions, mean_widths, [points[group] for group in groups], are_junctions=False)


def merge_until_stable(positions: FloatArray, radius: float) -> tuple[FloatArray, list[list[int]]]:
    """Replace points by the average of those nearer than a radius, again until none is (paper, section III-C.1).

    Merging starts at the first of the (N, 2) positions, the best one. Returns the merged points, (M, 2), and for each
    which of the given ones it is the average of.
    """
    groups = [[i] for i in range(len(positions))]
    merged = [tuple(p) for p in positions.tolist()]
    i = 0
    while i < len(merged):
        r, c = merged[i]
        near = [j for j, (rj, cj) in enumerate(merged) if j != i and (rj - r) ** 2 + (cj - c) ** 2 < radius * radius]
        if not near:
            i += 1
            continue
        groups[i] = groups[i] + [member for j in near for member in groups[j]]
        merged[i] = tuple(positions[groups[i]].mean(axis=0).tolist())
        for j in reversed(near):
            del merged[j], groups[j]
        i = 0  # the average may have come near to a point passed before
    return np.array(merged, np.float64).reshape(-1, 2), groups


def _crossings(centerline: Centerline, config: CrossingCandidates) -> Candidates:
    junctions = np.flatnonzero(centerline.degrees >= 3).astype(np.int32)
    widths = centerline.widths(junctions)
    reach = np.minimum(widths * config.merge_widths, config.merge_max_m / centerline.resolution_m)
    # Two junctions are one where their halves of the line between them meet.
    near = skeleton.grow_from(centerline.rows, centerline.cols, centerline.neighbours, junctions, reach / 2)
    labels, count = skeleton.label_pieces(centerline.neighbours, near, junctions)
    pixels = np.array([centerline.rows[junctions], centerline.cols[junctions]], np.float64).T
    is_member = labels[junctions] == np.arange(count)[:, None]
    merged = [pixels[members] for members in is_member]
    positions = np.array([each.sum(axis=0) / len(each) for each in merged]).reshape(-1, 2)
    greatest = np.where(is_member, widths, 0.0).max(axis=1, initial=0.0)
    return Candidates(positions, greatest, merged, are_junctions=True)
