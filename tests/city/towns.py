"""Drives whose truth is known, as the map of many drives takes them: no scans, no detector."""

import numpy as np

from interloc.arrays import FloatArray
from interloc.city.drives import Pass
from interloc.geometry import enu_from_lonlat, lonlat_from_enu

ORIGIN = (49.0, 8.4)  # latitude, longitude


def town(rng: np.random.Generator, count: int, spacing_m: float = 70.0) -> FloatArray:
    """Return intersections in the order of a tour, (count, 2) metres."""
    side = int(np.ceil(np.sqrt(count)))
    row, column = np.divmod(np.arange(count), side)
    column = np.where(row % 2 == 0, column, side - 1 - column)
    return np.stack([column, row], axis=-1) * spacing_m + rng.uniform(-15, 15, (count, 2))


def drive(
    nodes: FloatArray,
    name: str,
    *,
    seed: int = 0,
    bias_m: float | tuple[float, float] = 1.0,
    drifts: bool = False,
    noise_m: float = 0.5,
    seen: float = 1.0,
    start_s: float = np.nan,
) -> Pass:
    """Drive past intersections: an offset of the fixes, constant or drifting, and noise of each sighting."""
    rng = np.random.default_rng([seed, sum(name.encode())])
    along = np.cumsum(np.append(0.0, np.hypot(*np.diff(nodes, axis=0).T)))
    if isinstance(bias_m, tuple):
        offset, std = np.tile(bias_m, (len(nodes), 1)), 1.0
    elif drifts:  # an Ornstein-Uhlenbeck process
        kept = np.exp(-np.diff(along) / 1440.0)
        steps, std = rng.normal(0, bias_m, (len(nodes), 2)), bias_m
        for row, each in enumerate(kept, 1):
            steps[row] = each * steps[row - 1] + np.sqrt(1 - each**2) * steps[row]
        offset = steps
    else:
        offset, std = np.tile(rng.normal(0, bias_m, 2), (len(nodes), 1)), bias_m
    xy = nodes + offset + rng.normal(0, noise_m, nodes.shape)
    rows = np.flatnonzero(rng.random(len(nodes)) < seen)
    count = len(rows)
    return Pass(
        name=name,
        key=f"{name}-{seed}",
        lonlat=lonlat_from_enu(*ORIGIN, xy[rows]),
        fix_std_m=np.full(count, std),
        shape_cov_m2=np.zeros((count, 3)),
        scatter_std_m=np.full(count, np.sqrt(max(noise_m**2 - 0.09, 1e-4))),  # beside the usual noise of 0.3 m
        confidence=np.full(count, 0.9),
        observations=np.full(count, 10),
        number=rows + 1,
        along_m=along[rows],
        bearings_deg=tuple(np.array([0.0, 90.0, 180.0]) for _ in rows),
        widths_m=tuple(np.array([6.0, 5.0, np.nan]) for _ in rows),
        seen_s=start_s + along[rows, None] / 10.0 + np.array([0.0, 5.0]),
        track_lonlat=lonlat_from_enu(*ORIGIN, nodes + offset),
        track_along_m=along,
        span_s=start_s + np.array([0.0, along[-1] / 10.0]),
    )


def metres(lonlat: FloatArray) -> FloatArray:
    """Return east and north of the town, (N, 2) metres."""
    return enu_from_lonlat(*ORIGIN, lonlat)
