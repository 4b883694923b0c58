"""Fits uncertainty and confidence: `tests/performance/calibrate.py -o OUT --kitti DIR --twins DIR --drive DRIVE MAP`.

From the project's folder, with PYTHONPATH=. there. Prints the settings `calibration.*` of the preset, and how true they
are on drives that they were not fitted to. What is true is the map: a node of policy `drive` assigned to an
intersection, one to one, within 10 m; in drives over drawn maps (drawn_NN) the point where the axes of the roads meet,
where that was read. What nodes are off themselves is a term of its own, one number per drive. For twins (`interloc
benchmark twins --keep`) the nodes are true by construction.

Drives go together by their maps (00.osm.gz): those of one sequence share their junctions, so a sequence is either
fitted to or held out, in all its seeds. Simulated and recorded drives have the same weight in all. Three fits are made:
to the sequences of --fit; to all but one sequence, for each in turn (cross-validation); and to all. Detections are kept
in OUT as long as the settings stay the same, so a second fit takes seconds: for other drives or another program, take
another folder.
"""

from __future__ import annotations

import argparse
import json
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import click
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.config import PRESETS, CalibrationConfig, DetectorConfig
from interloc.drive import Drive
from interloc.evaluation.evaluate import evaluate
from interloc.geometry import enu_from_lonlat
from interloc.lab.cases import FolderCase, TwinCase
from interloc.lab.measure import MislabelledDrive, parse_level
from interloc.lab.places import BOUND_95
from interloc.mapping import estimation
from interloc.mapping.fusion import evidence, fuse
from interloc.osm.reader import read_osm
from interloc.pipeline import detect
from interloc.results import DriveResult

Case = FolderCase | TwinCase

FITTED = ("line_std_m", "unclear_line_std_m", "coarse_line_std_m", "shape_limit_m")
WEIGHTS = ("log_odds", "log_odds_seen", "log_odds_per_doubling")
START = PRESETS["default"].calibration or CalibrationConfig()
MIN_PLACES = 5  # fewer say nothing of their map
_RESAMPLES, _BINS = 1000, 10
_LOG_SPREAD = 1.0
"""Of the prior of each standard deviation, about its start: weak, for sets that say nothing of one of them."""
_WEIGHTS, _WEIGHT_SPREADS = np.array([0.0, 6.0, 0.0]), np.array([10.0, 1.0, 10.0])
"""Of the prior of each weight. A place that one of twenty keyframes saw is hardly a junction; the data hold few."""


@dataclass(frozen=True)
class Places:
    """The N intersections of a drive with what is known and what is true of them.

    `sequence` is the name of its map; `error` leads east and north to what is true of an intersection (NaN for none):
    its node, or, where `from_axes`, the place where the axes of its roads meet. `counts`: in the relevant zone of a
    keyframe; `kept`: part of the map; `map_std_m`: what the nodes of the map are off, east and north.
    """

    sequence: str
    kind: str
    sightings: estimation.SightingStats
    seen: FloatArray
    bearings_deg: list[FloatArray]
    error: FloatArray
    from_axes: BoolArray
    counts: BoolArray
    kept: BoolArray
    map_std_m: float = 0.0

    @property
    def right(self) -> BoolArray:
        """(N,) bool, whether it has a node."""
        return np.isfinite(self.error[:, 0])

    def covariances(self, calibration: CalibrationConfig) -> FloatArray:
        """Return the (N, 2, 2) covariances of the errors, those of the map among them."""
        shape = estimation.shape_covariance(self.sightings, self.bearings_deg, calibration)
        own = estimation.fix_variance(self.sightings, calibration) + estimation.scatter_variance(self.sightings)
        variance = own + np.where(self.from_axes, 0.0, self.map_std_m**2)
        return shape + variance[:, None, None] * np.eye(2)

    def misfit(self, calibration: CalibrationConfig) -> float:
        """Return minus the log likelihood of the errors, but for a constant."""
        determinants = np.linalg.det(self.covariances(calibration)[self.right])
        return 0.5 * float(np.sum(np.log(determinants)) + np.sum(self.squared(calibration)))

    def by_axes(self) -> Places:
        """Leave out what is known of the nodes."""
        error = np.where(self.from_axes[:, None], self.error, np.nan)
        return replace(self, kind=f"{self.kind}, axes", error=error, counts=np.zeros_like(self.counts))

    def with_map_std(self) -> Places:
        """Tell the error of the map from that of the intersections, by largest likelihood with the present settings."""
        trials = [replace(self, map_std_m=float(std_m)) for std_m in np.arange(0.0, 10.0, 0.1)]
        by_nodes = self.right & ~self.from_axes
        return min(trials, key=lambda trial: trial.misfit(START)) if by_nodes.sum() >= MIN_PLACES else self

    def squared(self, calibration: CalibrationConfig) -> FloatArray:
        """Return the normalised squared errors of the right ones."""
        covariance, error = self.covariances(calibration)[self.right], self.error[self.right]
        squared: FloatArray = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
        return squared

    def confidence(self, calibration: CalibrationConfig) -> FloatArray:
        """Return the (N,) probabilities."""
        return estimation.junction_probability(self.seen, self.sightings, self.bearings_deg, calibration)


@contextmanager
def opened(case: Case, level: str, out: Path) -> Iterator[Drive]:
    """Give a drive, with label errors if the level says so."""
    with case.opened(out) as drive:
        r_fpr, r_fnr = parse_level(level)
        yield MislabelledDrive(drive, r_fpr, r_fnr, case.seed or 0) if r_fpr or r_fnr else drive


def detected(case: Case, name: str, level: str, config: DetectorConfig, out: Path) -> DriveResult:
    path = out / f"{name}_{level.replace('/', '-')}.pickle"
    mark = config.model_dump(mode="json", exclude={"fusion", "calibration"})
    if path.exists():
        known, result = pickle.loads(path.read_bytes())  # noqa: S301 - written by this program
        if known == mark:
            assert isinstance(result, DriveResult)
            return result
    click.echo(f"detects on {name}, label errors {level}")
    with opened(case, level, out) as drive:
        result = replace(detect(drive, config), road=())
    path.write_bytes(pickle.dumps((mark, result)))
    return result


def places_of(result: DriveResult, case: Case, kind: str, config: DetectorConfig) -> Places:
    """Fuse what was detected, also what is seen too rarely for the map, and ask the map."""
    generous = config.fusion.model_copy(update={"min_observations": 1, "min_confidence": 0.0})
    table, labels = fuse(result.keyframes, result.detections, generous)
    detections = replace(result.detections, intersection=labels)
    evaluation = evaluate(replace(result, detections=detections, intersections=table), read_osm(case.osm))
    node, nodes = evaluation.map_level.node, evaluation.nodes.lonlat
    error, from_axes = np.full((len(table), 2), np.nan), np.zeros(len(table), np.bool_)
    rows = np.flatnonzero(node >= 0)
    if len(rows) and table.lonlat is not None:
        lonlat = table.lonlat[rows]
        axes = (case.axes() or {}) if kind == "drawn" else {}
        ids = evaluation.nodes.osm_id[node[rows]].tolist()
        from_axes[rows] = [number in axes for number in ids]
        true = [axes.get(number, place) for number, place in zip(ids, nodes[node[rows]].tolist(), strict=True)]
        error[rows] = enu_from_lonlat(lonlat[:, 1], lonlat[:, 0], np.array(true))
    sightings, seen = evidence(result.keyframes, detections, table, config.fusion)
    kept = (table.confidence >= config.fusion.min_confidence) & (table.observations >= config.fusion.min_observations)
    counts = evaluation.map_level.counts
    name, bearings = case.osm.name[:2], table.bearings_deg
    return Places(name, kind, sightings, seen, bearings, error, from_axes, counts, kept).with_map_std()


def weights_of(drives: list[Places]) -> FloatArray:
    """Return the weight of the places of each drive: those of simulated and of recorded drives add up to the same."""
    simulated = np.array([each.kind.startswith("simulated") for each in drives])
    count = np.array([len(each.seen) for each in drives])
    weight = np.ones(len(drives))
    for these in (simulated, ~simulated):
        if simulated.any() and not simulated.all():
            weight[these] = count.sum() / 2.0 / count[these].sum()
    return weight


def fit(drives: list[Places]) -> CalibrationConfig:
    """Return the settings of largest posterior: errors are normal, outcomes Bernoulli."""

    def with_stds(logs: FloatArray) -> CalibrationConfig:
        return START.model_copy(update=dict(zip(FITTED, np.exp(logs).tolist(), strict=True)))

    def misfit_of_errors(logs: FloatArray) -> float:
        calibration = with_stds(logs)
        total = float(np.sum((logs - start) ** 2)) / 2 / _LOG_SPREAD**2
        for drive, w in zip(drives, weight, strict=True):
            total += w * drive.misfit(calibration)
        return total

    weight = weights_of(drives)
    start = np.log([getattr(START, name) for name in FITTED])
    found = minimize(misfit_of_errors, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3})
    calibration = with_stds(found.x)

    def probabilities(weights: FloatArray) -> FloatArray:
        trial = calibration.model_copy(update=dict(zip(WEIGHTS, weights.tolist(), strict=True)))
        return np.concatenate([each.confidence(trial) for each in drives])[counts]

    counts = np.concatenate([each.counts for each in drives])
    right = np.concatenate([each.right for each in drives])[counts]
    of_place = np.repeat(weight, [len(each.seen) for each in drives])[counts]

    def misfit_of_outcomes(weights: FloatArray) -> float:
        chance = np.where(right, probabilities(weights), 1.0 - probabilities(weights))
        prior = float(np.sum(((weights - _WEIGHTS) / _WEIGHT_SPREADS) ** 2)) / 2
        return prior - float(np.sum(of_place * np.log(np.maximum(chance, 1e-12))))

    weights = minimize(misfit_of_outcomes, np.ones(3), bounds=[(None, None), (0, None), (0, None)]).x
    return calibration.model_copy(update=dict(zip(WEIGHTS, weights.tolist(), strict=True)))


def calibration_error(confidence: FloatArray, right: BoolArray) -> float:
    """Return the expected calibration error over bins of equal width (Naeini et al. 2015; Guo et al. 2017)."""
    # Count times difference of the means is the sum of the differences; the bootstrap asks for this thousands of times.
    numbers = np.minimum((confidence * _BINS).astype(np.int64), _BINS - 1)
    return float(np.abs(np.bincount(numbers, confidence - right)).sum()) / len(confidence)


def told(value: float, drawn: ArrayLike, scale: float, digits: int) -> str:
    """Return a figure with the middle 95 % of what was drawn."""
    low, high = scale * np.percentile(drawn, (2.5, 97.5))
    return f"{scale * value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def reliability(drives: list[tuple[Places, CalibrationConfig]]) -> tuple[int, list[str]]:
    """Return how many places on the map are right, and how true what is said of places on the map is.

    That is the share within the ellipse of 95 %, the normalised squared error per degree of freedom (Bar-Shalom et al.
    2001, 5.4: 1 if true), and the calibration error, each with the interval of its bootstrap (places drawn anew, with
    replacement). Last, the calibration error of places whose confidence would be exactly true: whether each is right is
    drawn by its confidence (consistency resampling, Broecker and Smith 2007), as few do not fall out in the shares that
    they should. An error within that interval says nothing against the confidence.
    """

    def picks(count: int) -> IntArray:
        return np.random.default_rng(0).integers(0, count, (_RESAMPLES, count))

    squared = np.concatenate([each.squared(calibration)[each.kept[each.right]] for each, calibration in drives])
    shown = [each.kept & each.counts for each, _ in drives]
    confidence = np.concatenate([each.confidence(c)[rows] for (each, c), rows in zip(drives, shown, strict=True)])
    right = np.concatenate([each.right[rows] for (each, _), rows in zip(drives, shown, strict=True)])
    cells = ["-"] * 4
    if len(squared):
        rows, within = picks(len(squared)), squared <= BOUND_95
        cells[0] = told(within.mean(), within[rows].mean(axis=1), 100, 0)
        cells[1] = told(squared.mean() / 2, squared[rows].mean(axis=1) / 2, 1, 2)
    if len(confidence):
        errors = [calibration_error(confidence[rows], right[rows]) for rows in picks(len(confidence))]
        cells[2] = told(calibration_error(confidence, right), errors, 100, 1)
        drawn = np.random.default_rng(0).random((_RESAMPLES, len(confidence))) < confidence
        chance = [calibration_error(confidence, each) for each in drawn]
        cells[3] = told(float(np.mean(chance)), chance, 100, 1)
    return len(squared), cells


def say(title: str, drives: list[tuple[Places, CalibrationConfig]]) -> None:
    """Print how true the settings are on some drives, by their kinds."""
    heads = "places  within 95 %          squared per dimension  calibration error      by chance"
    drives = [*drives, *((each.by_axes(), calibration) for each, calibration in drives if each.from_axes.any())]
    click.echo(f"\n{title}\n  {'':28s} {heads}")
    for kind in sorted({each.kind for each, _ in drives}):
        count, cells = reliability([pair for pair in drives if pair[0].kind == kind])
        click.echo(f"  {kind:28s} {count:6d}  {cells[0]:20s} {cells[1]:22s} {cells[2]:22s} {cells[3]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True, help="Folder that keeps the detections.")
    parser.add_argument("--kitti", type=Path, help="Folder with oxts/, poses_suma/, osm/, ... of the twins.")
    parser.add_argument("--twins", type=Path, help="Folder that keeps the twins.")
    parser.add_argument("--sequences", nargs="*", default=["00", "02", "05", "06", "07", "08", "09", "10"])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--levels", nargs="*", default=["0/0"], help="Label errors of simulated drives, as 20/20.")
    parser.add_argument("--drive", nargs=2, type=Path, action="append", default=[], metavar=("DRIVE", "MAP"))
    parser.add_argument("--fit", nargs="*", default=["00", "05", "06", "09"], help="Sequences to fit to.")
    parser.add_argument("--preset", default="default")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    config = PRESETS[given.preset]
    cases: list[tuple[str, Case]] = []
    if given.kitti is not None:
        twins = [
            TwinCase(given.kitti, n, seed, keep=given.twins) for n in given.sequences for seed in range(given.seeds)
        ]
        cases += [(f"{twin.name}_seed{twin.seed}", twin) for twin in twins]
    cases += [("_".join(path.parts[-2:]), FolderCase(path.name, path, osm)) for path, osm in given.drive]
    drives = []
    for name, case in cases:
        simulated = isinstance(case, TwinCase) or (case.path / "simulation.json").exists()
        for level in given.levels if simulated else ["0/0"]:
            told = "drawn" if case.name.startswith("drawn") else "recorded"
            kind = told if not simulated else f"simulated {level}" if level != "0/0" else "simulated"
            drives.append(places_of(detected(case, name, level, config, given.out), case, kind, config))

    for part, are_fitted in (("fitted to", True), ("the others", False)):
        say(f"as it is: sequences {part}", [(d, START) for d in drives if (d.sequence in given.fit) == are_fitted])
    chosen = fit([each for each in drives if each.sequence in given.fit])
    say(f"fitted to {' '.join(given.fit)}: the same", [(d, chosen) for d in drives if d.sequence in given.fit])
    say("  the others", [(d, chosen) for d in drives if d.sequence not in given.fit])
    without = {name: fit([d for d in drives if d.sequence != name]) for name in {d.sequence for d in drives}}
    say("fitted to all other sequences", [(d, without[d.sequence]) for d in drives])
    total = fit(drives)
    say("fitted to all", [(d, total) for d in drives])
    shown = partial(json.dumps, indent=1)
    names = [*FITTED, *WEIGHTS]
    click.echo(f"\nfitted to {' '.join(given.fit)}: {shown({name: round(getattr(chosen, name), 2) for name in names})}")
    click.echo(f"fitted to all: {shown({name: round(getattr(total, name), 2) for name in names})}")


if __name__ == "__main__":
    main()
