"""From the detections of all keyframes to a map: one point per physical intersection."""

from dataclasses import dataclass, replace

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.config import CalibrationConfig, FusionConfig
from interloc.geometry import enu_from_lonlat, lonlat_from_enu, rotate_2d, travelled, wrap_longitude
from interloc.mapping.branches import SeenBranches, fuse_branches
from interloc.mapping.clustering import assign, find_peaks, join_peaks, stand_for_two
from interloc.mapping.estimation import (
    SightingStats,
    densest_parts,
    fix_variance,
    junction_probability,
    members_of,
    position_std,
    robust_centres,
    scatter_variance,
    shape_covariance,
    summarize_sightings,
    visibility,
)
from interloc.results import DetectionTable, IntersectionTable, KeyframeTable, PositionParts

_MIN_BRANCHES = 3  # that all detections of an intersection saw together; two are a bend, or a mouth that was not seen


def fuse(
    keyframes: KeyframeTable,
    detections: DetectionTable,
    config: FusionConfig | None = None,
    calibration: CalibrationConfig | None = None,
) -> tuple[IntersectionTable, IntArray]:
    """Fuse the detections of a run into physical intersections, in the order of first sight.

    Returned beside them is the row of the intersection of each detection, (D,), -1 for none: no two of one keyframe
    share one. All keyframes take part, those without detections too: not seeing is an observation. With georeference
    detections are fused where their own fixes put them, else in W: there two passes whose poses drifted apart by more
    than `merge_radius_m` give two intersections. A calibration makes of the uncertainty a covariance that holds what
    all sightings share, and of the confidence a probability; without, they are the scatter and the rate of seeing.

    A detection that stands for two intersections at once belongs to none (`clustering.stand_for_two`), and its keyframe
    saw neither. Which detections belong together does not depend on how well each is known; in the position of an
    intersection each weighs the inverse of its variance: what was seen from afar, or in passing, is known worse.

    Rate of seeing: the keyframes within reach could have seen the intersection, each with a chance of 1 within
    `visible_radius_m` that falls to 0 at `visible_limit_m`. Of the sum of these chances, the part of the keyframes
    that did see it, with a Beta prior, is the rate of seeing; the mean score of its detections takes away up to
    `score_influence`. A false detection in one of twenty keyframes gets 0.07, a real one in two of two 0.6. It
    decides what is kept, and is the confidence where there is no calibration.
    """
    config = config or FusionConfig()
    scene = _Scene.of(keyframes, detections)
    scene = replace(scene, is_two=stand_for_two(scene.xy, scene.keyframe, radius_m=config.merge_radius_m))
    rows = np.flatnonzero(~scene.is_two)
    labels, clear = np.full(len(scene.xy), -1), scene.xy[rows]
    peaks = find_peaks(clear, bandwidth_m=config.bandwidth_m)
    labels[rows] = join_peaks(
        peaks, clear, scene.keyframe[rows], radius_m=config.merge_radius_m, together=config.together
    )
    centres = densest_parts(clear, labels[rows], int(labels.max(initial=-1)) + 1, scale_m=config.bandwidth_m)
    centres, labels = _reassign(scene, centres, labels, config)
    centres, labels = _reassign(scene, centres, labels, config)

    kept = _worth_keeping(scene, centres, labels, config)
    centres, labels = _reassign(scene, centres[kept], None, config)
    centres, labels = _in_order_of_sight(scene, centres, labels)
    table = _table(keyframes, detections, scene, centres, labels, config, calibration)
    sure = np.ones(len(table), dtype=np.bool_) if calibration is None else table.confidence >= config.min_confidence
    meets = np.array([len(each) >= _MIN_BRANCHES for each in table.bearings_deg], dtype=np.bool_)
    bends, sure = int((sure & ~meets).sum()), sure & meets
    if sure.all():
        return table, labels
    row = np.append(np.where(sure, np.cumsum(sure) - 1, -1), -1)  # the last one is picked by label -1
    labels = row[labels]
    table = _table(keyframes, detections, scene, centres[sure], labels, config, calibration)
    return replace(table, bends=bends), labels


def evidence(
    keyframes: KeyframeTable,
    detections: DetectionTable,
    intersections: IntersectionTable,
    config: FusionConfig | None = None,
) -> tuple[SightingStats, FloatArray]:
    """Return what a calibration is fitted to: the sightings of fused intersections, and their rates of seeing, (M,)."""
    config = config or FusionConfig()
    scene = _Scene.of(keyframes, detections)
    centres = intersections.world_xy
    if scene.origin_lonlat is not None and intersections.lonlat is not None:
        centres = enu_from_lonlat(scene.origin_lonlat[1], scene.origin_lonlat[0], intersections.lonlat)
    labels = detections.intersection
    return _sightings(keyframes, scene, centres, labels, config), _rate_of_seeing(scene, centres, labels, config)[0]


@dataclass(frozen=True)
class _Scene:
    """Detections and keyframes in one metric plane: east and north of the middle of the drive, or W."""

    xy: FloatArray
    """(D, 2) float64."""
    weight: FloatArray
    score: FloatArray
    """(D,) float64."""
    keyframe: IntArray
    """(D,) int64."""
    keyframe_xy: FloatArray
    """(K, 2) float64."""
    travelled_m: FloatArray
    """(K,) float64: distance driven up to each keyframe."""
    origin_lonlat: FloatArray | None
    """(2,) float64 or None: origin of the plane, degrees; None in W."""
    is_two: BoolArray
    """(D,) bool: whether a detection stands for two intersections at once, and so for neither."""

    @classmethod
    def of(cls, keyframes: KeyframeTable, detections: DetectionTable) -> "_Scene":
        origin = None
        xy, keyframe_xy = detections.world_xy, keyframes.world_xy
        if keyframes.lonlat is not None and detections.lonlat is not None and len(keyframes):
            origin = _middle(keyframes.lonlat)
            xy, keyframe_xy = (
                enu_from_lonlat(origin[1], origin[0], each) for each in (detections.lonlat, keyframes.lonlat)
            )
        return cls(
            xy=xy,
            weight=detections.position_std_m**-2,
            score=detections.score,
            keyframe=detections.keyframe,
            keyframe_xy=keyframe_xy,
            travelled_m=travelled(keyframes.world_xy),
            origin_lonlat=origin,
            is_two=np.zeros(len(xy), dtype=np.bool_),
        )


def _middle(lonlat: FloatArray) -> FloatArray:
    """Return the mean place of a drive, (2,) degrees, also of one across the date line."""
    turned = wrap_longitude(lonlat[:, 0] - lonlat[0, 0])
    return np.array([lonlat[0, 0] + turned.mean(), lonlat[:, 1].mean()])


def _reassign(
    scene: _Scene, centres: FloatArray, labels: IntArray | None, config: FusionConfig
) -> tuple[FloatArray, IntArray]:
    """Move the centres to their members, then assign the detections anew; centres left without any are dropped."""
    if labels is None:
        labels = _assigned(scene, centres, config)
    centres = robust_centres(scene.xy, scene.weight, labels, centres, scale_m=config.bandwidth_m)
    labels = _assigned(scene, centres, config)
    used, rows = np.unique(labels[labels >= 0], return_inverse=True)
    labels[labels >= 0] = rows.reshape(-1)
    return centres[used], labels


def _assigned(scene: _Scene, centres: FloatArray, config: FusionConfig) -> IntArray:
    labels = assign(scene.xy, scene.keyframe, centres, radius_m=config.merge_radius_m)
    labels[scene.is_two] = -1
    return labels


def _rate_of_seeing(
    scene: _Scene, centres: FloatArray, labels: IntArray, config: FusionConfig
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the rate of seeing each centre, as it is and lowered by low scores, and the keyframes in reach, (M,)."""
    count, keyframes = len(centres), len(scene.keyframe_xy)
    centre, keyframe, chance = visibility(
        centres, scene.keyframe_xy, certain_m=config.visible_radius_m, limit_m=config.visible_limit_m
    )
    inside = labels >= 0
    did = np.isin(centre * keyframes + keyframe, labels[inside] * keyframes + scene.keyframe[inside])
    possible = np.bincount(centre, chance, count)
    seen = np.bincount(centre, chance * did, count)
    rate = (config.prior_seen + seen) / (config.prior_seen + config.prior_missed + possible)
    total = np.bincount(labels[inside], scene.weight[inside], count)
    score = np.bincount(labels[inside], scene.weight[inside] * scene.score[inside], count) / np.maximum(total, 1e-12)
    lowered = rate * (1.0 - config.score_influence * (1.0 - score))
    return rate, lowered, np.bincount(centre[chance > 0], minlength=count)


def _worth_keeping(scene: _Scene, centres: FloatArray, labels: IntArray, config: FusionConfig) -> BoolArray:
    _, confidence, in_reach = _rate_of_seeing(scene, centres, labels, config)
    observations = np.bincount(labels[labels >= 0], minlength=len(centres))
    enough = observations >= np.minimum(config.min_observations, np.maximum(in_reach, 1))
    return enough & (confidence >= config.min_confidence)


def _in_order_of_sight(scene: _Scene, centres: FloatArray, labels: IntArray) -> tuple[FloatArray, IntArray]:
    """Sort centres by the first keyframe that saw them; in one keyframe, by their detections."""
    first = [(int(scene.keyframe[rows].min()), int(rows[0])) for _, rows in members_of(labels, len(centres))]
    order = np.array(sorted(range(len(centres)), key=first.__getitem__), dtype=np.int64)
    place = np.empty(len(centres) + 1, dtype=np.int64)
    place[order] = np.arange(len(centres))
    place[-1] = -1  # picked by label -1
    return centres[order], place[labels]


def _table(
    keyframes: KeyframeTable,
    detections: DetectionTable,
    scene: _Scene,
    centres: FloatArray,
    labels: IntArray,
    config: FusionConfig,
    calibration: CalibrationConfig | None,
) -> IntersectionTable:
    groups = [rows for _, rows in members_of(labels, len(centres))]
    first = np.array([scene.keyframe[rows].min() for rows in groups], dtype=np.int64)
    last = np.array([scene.keyframe[rows].max() for rows in groups], dtype=np.int64)
    rows = np.flatnonzero(labels >= 0)
    bearings, widths = fuse_branches(
        SeenBranches.of(
            [detections.bearings_deg[row] for row in rows],
            [detections.widths_m[row] for row in rows],
            labels[rows],
            scene.weight[rows],
        ),
        spread_deg=config.branch_spread_deg,
        separation_deg=config.branch_separation_deg,
        support=config.branch_support,
    ).lists()
    sightings = _sightings(keyframes, scene, centres, labels, config)
    rate, confidence, _ = _rate_of_seeing(scene, centres, labels, config)
    origin = scene.origin_lonlat  # none in a run without keyframes
    lonlat = np.zeros((0, 2)) if origin is None else lonlat_from_enu(origin[1], origin[0], centres)
    if calibration is None:
        std = position_std(sightings, prior_std_m=config.prior_std_m)
        covariance = std[:, None, None] ** 2 * np.eye(2)
        parts = PositionParts.unknown(len(centres))
    else:
        shape = shape_covariance(sightings, bearings, calibration)
        no_fix = np.zeros(len(centres))
        fix_var = no_fix if scene.origin_lonlat is None else fix_variance(sightings, calibration)
        scatter_var = scatter_variance(sightings)
        parts = PositionParts(np.sqrt(fix_var), shape[:, [0, 0, 1], [0, 1, 1]], np.sqrt(scatter_var))
        covariance = shape + (fix_var + scatter_var)[:, None, None] * np.eye(2)
        doubt = _doubtful_share(keyframes, scene, labels, len(centres))
        confidence = junction_probability(rate, sightings, bearings, calibration, doubt)
        std = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2.0)
    return IntersectionTable(
        id=np.arange(1, len(centres) + 1, dtype=np.int64),
        world_xy=_in_world(keyframes, scene, centres, first),
        lonlat=None if keyframes.lonlat is None else lonlat,
        position_std_m=std,
        observations=np.array([len(rows) for rows in groups], dtype=np.int64),
        confidence=confidence,
        bearings_deg=bearings,
        widths_m=widths,
        first_frame=keyframes.frame[first],
        last_frame=keyframes.frame[last],
        position_cov_m2=covariance[:, [0, 0, 1], [0, 1, 1]],
        parts=parts,
    )


def _doubtful_share(keyframes: KeyframeTable, scene: _Scene, labels: IntArray, count: int) -> FloatArray:
    """Return which share of the sightings of each centre comes from keyframes whose labels may be wrong, (M,)."""
    if keyframes.is_doubtful is None:
        return np.zeros(count)
    rows = np.flatnonzero(labels >= 0)
    total = np.bincount(labels[rows], scene.weight[rows], count)
    doubtful = np.bincount(labels[rows], scene.weight[rows] * keyframes.is_doubtful[scene.keyframe[rows]], count)
    return doubtful / np.maximum(total, 1e-12)


def _sightings(
    keyframes: KeyframeTable, scene: _Scene, centres: FloatArray, labels: IntArray, config: FusionConfig
) -> SightingStats:
    fix_std = np.full(len(keyframes), np.nan) if keyframes.position_std_m is None else keyframes.position_std_m
    return summarize_sightings(
        scene.xy,
        scene.weight,
        labels,
        scene.travelled_m[scene.keyframe],
        centres,
        score=scene.score,
        fix_std_m=fix_std[scene.keyframe],
        correlation_m=config.correlation_length_m,
        clip_m=2.0 * config.bandwidth_m,
    )


def _in_world(keyframes: KeyframeTable, scene: _Scene, centres: FloatArray, first: IntArray) -> FloatArray:
    """Return the centres in W; with georeference as seen from the keyframe that saw them first (W drifts)."""
    if scene.origin_lonlat is None or keyframes.enu_yaw_rad is None:
        return centres.copy()
    turn = keyframes.world_yaw_rad[first] - keyframes.enu_yaw_rad[first]
    return keyframes.world_xy[first] + rotate_2d(centres - scene.keyframe_xy[first], turn)
