"""From all sightings of an intersection: its position with uncertainty, how often it was seen, its branches."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.config import CalibrationConfig
from interloc.geometry import near_pairs

_LINES_LIMIT_M = 30.0
"""Standard deviation of a place that no line fixes, for the confidence: lines that meet nowhere."""

_ROUNDS = 30
_CONVERGED_M = 1e-4


def robust_centres(
    xy: FloatArray, weight: FloatArray, labels: IntArray, start: FloatArray, *, scale_m: float
) -> FloatArray:
    """Move each of (M, 2) centres, metres, to the middle of the bulk of its members; one without members stays.

    `labels` names the centre of each of (D, 2) detections with positive weights, -1 for none. Iteratively reweighted
    least squares with Welsch weights exp(-d^2 / 2 scale^2): a member counts 0.6 of one in the middle at `scale_m`, 0.01
    at three times that. They redescend: where detections jump between two places the heavier one wins, instead of a
    compromise at which there is nothing.
    """
    inside = labels >= 0
    xy, weight, labels = xy[inside], weight[inside], labels[inside]
    centres = start.copy()
    for _ in range(_ROUNDS):
        pull = weight * np.exp(-0.5 * np.sum((xy - centres[labels]) ** 2, axis=1) / scale_m**2)
        total = np.bincount(labels, pull, len(centres))
        held = total > 0
        moved = centres.copy()
        for axis in (0, 1):
            moved[held, axis] = np.bincount(labels, pull * xy[:, axis], len(centres))[held] / total[held]
        step = float(np.abs(moved - centres).max(initial=0.0))
        centres = moved
        if step < _CONVERGED_M:
            break
    return centres


def densest_parts(xy: FloatArray, labels: IntArray, count: int, *, scale_m: float) -> FloatArray:
    """Return for each of `count` groups the mean of its densest part: (count, 2), where `robust_centres` starts.

    The densest part is the cell of a grid of 1 `scale_m` with the most points in its 3 x 3 neighbourhood.
    """
    cells = np.floor(xy / scale_m).astype(np.int64)
    keys, cell = np.unique(np.column_stack([labels, cells]), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    mass = np.bincount(cell)
    row_of = {tuple(key): row for row, key in enumerate(keys.tolist())}
    best = np.full(count, -1.0)
    start = np.zeros((count, 2))
    sums = np.stack([np.bincount(cell, xy[:, axis]) for axis in (0, 1)], axis=-1)
    for label, x, y in keys.tolist():
        rows = [row_of[key] for dx in (-1, 0, 1) for dy in (-1, 0, 1) if (key := (label, x + dx, y + dy)) in row_of]
        total = float(mass[rows].sum())
        if total > best[label]:
            best[label] = total
            start[label] = sums[rows].sum(axis=0) / total
    return start


@dataclass(frozen=True)
class SightingStats:
    """What the sightings of each of M intersections say about it together.

    Neighbouring keyframes see the intersection through nearly the same scans, so their errors agree, and 40 sightings
    of one pass are not 40 measurements. Two windows share the part r = max(0, 1 - d / correlation_m) of their scans
    when d metres of driving lie between them; taking r as the correlation of their errors, n sightings with weights w
    are worth n_eff = (sum w)^2 / sum_ij w_i w_j r_ij independent ones: about 1.5 per pass, however dense the keyframes.
    """

    independent: FloatArray
    """(M,) float64: n_eff: number of independent sightings that they are worth, 0 without any."""
    scatter_m2: FloatArray
    """(M,) float64: s^2: weighted mean of the squared distances from the centre, half of it: the variance along each
    axis."""
    score: FloatArray
    """(M,) float64: weighted mean of their scores, 0..1."""
    fix_var_m2: FloatArray
    """(M,) float64: weighted mean variance of the fixes that placed them along each axis, NaN where any is unknown."""
    usual_score: float
    """Median score of all detections of the drive: it is low where its labels are coarse. 1 without any."""


def summarize_sightings(
    xy: FloatArray, weight: FloatArray, labels: IntArray, travelled_m: FloatArray, centres: FloatArray, *,
    score: FloatArray, fix_std_m: FloatArray, correlation_m: float, clip_m: float
) -> SightingStats:  # fmt: skip
    """Sum up the sightings of each centre, given as in `robust_centres`.

    `travelled_m`, (D,), is the distance driven up to the keyframe of each detection, `fix_std_m` one sigma of the fix
    of its keyframe, NaN where that is unknown. After `correlation_m` the windows of two keyframes have no scan of the
    intersection in common. Distances count as no more than `clip_m`: such members do not move the centre either.
    """
    count = len(centres)
    independent, scatter, mean_score, fix_var = (np.zeros(count) for _ in range(4))
    for label, rows in members_of(labels, count):
        order = rows[np.argsort(travelled_m[rows], kind="stable")]
        w = weight[order] / weight[order].sum()
        independent[label] = 1.0 / float(w @ _shared(travelled_m[order], w, correlation_m))
        squared = np.minimum(np.sum((xy[order] - centres[label]) ** 2, axis=1), clip_m**2)
        scatter[label] = 0.5 * float(w @ squared)
        mean_score[label] = float(w @ score[order])
        fix_var[label] = float(w @ fix_std_m[order] ** 2)
    return SightingStats(independent, scatter, mean_score, fix_var, float(np.median(score)) if len(score) else 1.0)


def position_std(sightings: SightingStats, *, prior_std_m: float) -> FloatArray:
    """Estimate the one-sigma uncertainty, (M,) metres, of each centre from the scatter of its sightings alone.

    The scatter s^2 within sightings that are worth n_eff independent ones underestimates the variance by 1 - 1 / n_eff,
    and says nothing at all for n_eff = 1. Hence the posterior with a prior, the typical error of one independent
    sighting, worth two (scaled inverse chi-squared): variance = (n_eff s^2 + 2 prior^2) / (n_eff + 1), and the
    variance of the centre is that over n_eff. What all sightings share, it does not hold: `shape_covariance` does.
    """
    n_eff = np.where(sightings.independent > 0, sightings.independent, 1.0)
    variance = (n_eff * sightings.scatter_m2 + 2.0 * prior_std_m**2) / (n_eff + 1.0)
    return np.where(sightings.independent > 0, np.sqrt(variance / n_eff), prior_std_m)


def shape_covariance(
    sightings: SightingStats,
    bearings_deg: Sequence[FloatArray],
    calibration: CalibrationConfig,
    *,
    limit_m: float | None = None,
) -> FloatArray:
    """Estimate the part of the covariance of each position that all drives share: that of its shape, (M, 2, 2).

    An intersection is where the lines of its branches meet, whose bearings are clockwise from +y of the plane. With a
    standard deviation sigma of each line across itself, weighted least squares give the covariance
    (sum n n^T / sigma^2)^-1 over the normals n of the branches (Foerstner and Wrobel, Photogrammetric Computer Vision,
    4.1.2): along the bisector of an acute pair it is largest. Where the score is low the lines pass the point widely,
    and where those of most detections are, the labels are coarse, so that lines lean together even where they meet:
    sigma^2 = line_std_m^2 + (unclear_line_std_m (1 - score))^2 + (coarse_line_std_m (1 - usual score))^2. The candidate
    bounds it: + I / limit_m^2 in the inverse, by default the `shape_limit_m` of the calibration. All sightings share
    it, since all see the same kerbs: more of them, or of drives, do not make it smaller.
    """
    limit_m = limit_m or calibration.shape_limit_m
    covariance = np.zeros((len(bearings_deg), 2, 2))
    coarse_m = calibration.coarse_line_std_m * (1.0 - sightings.usual_score)
    for row, bearings in enumerate(bearings_deg):
        angle = np.radians(bearings)
        normals = np.stack([np.cos(angle), -np.sin(angle)], axis=-1)
        unclear_m = calibration.unclear_line_std_m * (1.0 - sightings.score[row])
        line_var = calibration.line_std_m**2 + unclear_m**2 + coarse_m**2
        covariance[row] = np.linalg.inv(normals.T @ normals / line_var + np.eye(2) / limit_m**2)
    return covariance


def scatter_variance(sightings: SightingStats) -> FloatArray:
    """Return what the scatter between the sightings leaves to each position, (M,) square metres: s^2 / n_eff."""
    return sightings.scatter_m2 / np.maximum(sightings.independent, 1.0)


def fix_variance(sightings: SightingStats, calibration: CalibrationConfig) -> FloatArray:
    """Return the variance of the georeference at each intersection along each axis, (M,), which all sightings share."""
    return np.where(np.isfinite(sightings.fix_var_m2), sightings.fix_var_m2, calibration.fix_std_m**2)


def junction_probability(
    seen: FloatArray,
    sightings: SightingStats,
    bearings_deg: Sequence[FloatArray],
    calibration: CalibrationConfig,
    doubtful_share: FloatArray | float = 0.0,
) -> FloatArray:
    """Estimate the probability, (M,), that a road junction lies within 10 m of each intersection.

    A logistic function of the share of the keyframes in reach that saw it, with which it rises, and of the logarithm of
    the standard deviation that lines and scatter leave to the position, without the limit of the candidate, with which
    it falls: lines that meet in no point, or at an acute angle, are often no junction. `doubtful_share` is that of the
    sightings from keyframes whose labels, made by geometry, may be wrong.
    """
    shape = shape_covariance(sightings, bearings_deg, calibration, limit_m=_LINES_LIMIT_M)
    doublings = 0.5 * np.log2(np.trace(shape, axis1=1, axis2=2) / 2.0 + scatter_variance(sightings))  # of 1 m
    odds = calibration.log_odds + calibration.log_odds_seen * seen - calibration.log_odds_per_doubling * doublings
    odds -= calibration.log_odds_doubtful * doubtful_share
    probability: FloatArray = 1.0 / (1.0 + np.exp(-np.clip(odds, -500.0, 500.0)))
    return probability


def _shared(place: FloatArray, w: FloatArray, length: float) -> FloatArray:
    """Return sum_j w_j max(0, 1 - |place_i - place_j| / length) for ascending places, in O(n log n)."""
    sum_w = np.concatenate([[0.0], np.cumsum(w)])
    sum_wp = np.concatenate([[0.0], np.cumsum(w * place)])
    here = np.arange(len(place))
    first = np.searchsorted(place, place - length, side="left")
    last = np.searchsorted(place, place + length, side="right")
    before = (sum_w[here] - sum_w[first]) * (1.0 - place / length) + (sum_wp[here] - sum_wp[first]) / length
    after = (sum_w[last] - sum_w[here]) * (1.0 + place / length) - (sum_wp[last] - sum_wp[here]) / length
    result: FloatArray = before + after
    return result


def visibility(
    centres: FloatArray, keyframe_xy: FloatArray, *, certain_m: float, limit_m: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return which keyframes could have seen which centres, (P,) each, with the probability of that.

    Places are (M, 2) and (K, 2) metres in one plane. Nearer than `certain_m` an intersection should be seen, further
    than `limit_m` not; linear between.
    """
    if not len(centres) or not len(keyframe_xy):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0)
    centre, keyframe = near_pairs(centres, keyframe_xy, limit_m)
    distance = np.hypot(*(centres[centre] - keyframe_xy[keyframe]).T)
    return centre, keyframe, np.clip((limit_m - distance) / (limit_m - certain_m), 0.0, 1.0)


def members_of(labels: IntArray, count: int) -> list[tuple[int, IntArray]]:
    """Return (label, rows) of each label of 0..count-1 that has any, rows ascending."""
    order = np.argsort(labels, kind="stable")
    bounds = np.searchsorted(labels[order], np.arange(count + 1))
    return [(k, order[bounds[k] : bounds[k + 1]]) for k in range(count) if bounds[k] < bounds[k + 1]]
