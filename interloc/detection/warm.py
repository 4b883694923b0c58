"""The kernels compiled ahead: the first run of a new installation spends most of its time on that, and only it."""

import logging
from functools import cache, lru_cache

import numpy as np

from interloc.arrays import Float32Array
from interloc.config import DetectorConfig
from interloc.detection.detector import Detector, locate
from interloc.detection.image import BinaryImage
from interloc.detection.occupancy import road_patch
from interloc.detection.scan import Scan
from interloc.kernels import bits
from interloc.kernels.ground import select_points

_log = logging.getLogger(__name__)


@lru_cache(maxsize=16)
def warm_up(config: DetectorConfig) -> None:
    """Have the kernels of the method ready in this process: compiled, or read where an earlier process compiled them.

    Does the method's steps once at a small crossing of roads; of no effect the second time.
    """
    _announce()
    few = config.model_copy(
        update={
            "keyframes": config.keyframes.model_copy(update={"window": 3, "lookahead": 1}),  # few for the first
            "bev": config.bev.model_copy(update={"min_points": 2}),
        }
    )
    select_points(np.zeros((1, 4), np.float32), np.zeros(1, np.uint32), np.zeros(1, np.uint8))
    bits.count_pixels(np.zeros((1, 1), np.uint64))
    detector = Detector(few)
    half_m = config.bev.size_m / 2
    # Two roads that cross, one of them with a lay-by, which leaves a spur.
    blocks = (-half_m, half_m, -4.0, 4.0), (-4.0, 4.0, -half_m, half_m), (15.0, 19.0, 4.0, 7.0)
    road = np.concatenate([_block(*each) for each in blocks])
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 3] = 2.5 * np.arange(4)
    scans = [Scan(number, pose, road, None, road[:10]) for number, pose in enumerate(poses)]
    for number, window in enumerate(detector.completed(scans)):
        steps = window.steps()
        locate(steps, window.keyframe, few)
        road_patch(number, steps.occupancy, steps.roi)


@cache
def are_cold() -> bool:
    """Return whether this machine had no compiled kernels when this process began, judged by a small one."""
    BinaryImage.empty(1, 1, 1.0).pixels()
    stats = getattr(bits.set_pixels, "stats", None)  # of numba; none where it is switched off
    return bool(stats is not None and stats.cache_misses)


@cache
def _announce() -> None:
    if are_cold():
        _log.info("compiling the kernels, once (20 s on a free core, up to two minutes on a busy machine)")


def _block(left: float, right: float, bottom: float, top: float) -> Float32Array:
    x, y = np.meshgrid(np.arange(left, right, 0.15), np.arange(bottom, top, 0.15))
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1).astype(np.float32)
