"""How the error of a map of many drives falls with their number, on towns whose truth is known, without a detector.

    python tests/performance/city.py --seeds 100

Prints for constant and drifting offsets and 1 to 16 drives: error along each axis, that which the offset and noise of
so many drives allow (sqrt((bias^2 + noise^2) / N)), and the share of the places within their ellipses of 95 %.
"""

import argparse
import sys

import numpy as np

from interloc.city.citymap import merge
from tests.city.towns import drive, metres, town

_BIAS_M, _NOISE_M = 1.0, 0.5


def measure(seed: int, drives: int, *, drifts: bool) -> tuple[float, float, int]:
    """Return the mean squared error along each axis, the share of the ellipses that hold, and places too many."""
    nodes = town(np.random.default_rng(seed), 40)
    kinds = {"bias_m": _BIAS_M, "noise_m": _NOISE_M, "seen": 0.9, "drifts": drifts}
    places = merge([drive(nodes, f"d{i}", seed=1000 * seed + i, **kinds) for i in range(drives)]).places
    xy = metres(places.lonlat)
    error = xy - nodes[np.argmin(np.hypot(*(xy[:, None] - nodes[None]).transpose(2, 0, 1)), axis=1)]
    held = np.sum(error**2, axis=1) < 5.991 * places.position_std_m**2
    return float(np.mean(error**2)), float(np.mean(held)), max(0, int(places.is_shown.sum()) - len(nodes))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    seeds = parser.parse_args().seeds
    for drifts in (False, True):
        for drives in (1, 2, 4, 8, 16):
            squares, held, more = zip(*(measure(seed, drives, drifts=drifts) for seed in range(seeds)), strict=True)
            error, law = np.sqrt(np.mean(squares)), np.hypot(_BIAS_M, _NOISE_M) / np.sqrt(drives)
            sys.stdout.write(
                f"{'drifting' if drifts else 'constant'} {drives:2d} drives: {error:.3f} m, law {law:.3f} m, "
                f"ratio {error / law:.2f}, ellipses hold {np.mean(held):.1%}, too many {sum(more)}\n"
            )


if __name__ == "__main__":
    main()
