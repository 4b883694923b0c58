"""What each rule and setting of the method gives: every one taken out alone, over drives that are split in two.

A rule or setting stays if it gains on the mean of the choosing drives by more than the interval over places; nothing is
chosen to reach a line. The reporting drives are measured once per candidate, and told whatever they say.
"""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray
from interloc.config import PAPER, DetectorConfig, flatten, with_settings
from interloc.errors import ConfigError
from interloc.evaluation.metrics import UNMATCHED
from interloc.lab.cases import Case, FolderCase, folder_cases, twin_cases
from interloc.lab.measure import Row
from interloc.lab.run import NamedConfig
from interloc.lab.tables import MISSING, Table, metres, one_decimal, table_of

NOTHING = "nothing"
_RESAMPLES = 1000
_OF_THE_MAP = ("fusion.", "calibration")  # have no effect on a detection


@dataclass(frozen=True)
class DriveSet:
    """The drives of one part of the split, apart by place."""

    sequences: tuple[str, ...]
    seeds: tuple[int, ...]
    """Of the twins of KITTI."""
    recorded: tuple[str, ...]
    """Folders of recorded drives; their last two characters name the map, if none (`map.osm`) lies in them."""

    def cases(self, kitti: Path, recorded: Path | None, *, keep: Path | None, max_scans: int | None) -> list[Case]:
        """Return the twins, and those of the recorded drives that are there."""
        found: list[Case] = [
            *twin_cases(kitti, self.sequences, seeds=self.seeds, keep=keep, max_scans=max_scans),
        ]
        for name in self.recorded if recorded is not None else ():
            assert recorded is not None
            if (path := recorded / name).is_dir():
                own = path / "map.osm"
                (case,) = folder_cases([path], [own if own.is_file() else kitti / "osm" / f"{name[-2:]}.osm.gz"])
                found.append(FolderCase(name, case.path, case.osm, case.options))
        return found


SETS = {
    "choosing": DriveSet(("00", "05", "06", "09"), (0, 1, 2), ("real_00", "real_05", "real_06", "drawn_00", "town")),
    "reporting": DriveSet(("02", "07", "08", "10"), (3, 4, 5), ("real_02", "real_07", "drawn_02", "kitti360_00")),
}
"""Real ground of a sequence is `real_NN`, a drive over a map drawn by people `drawn_NN`, the made-up town
`town` (`interloc simulate town`)."""


def taken_out(config: DetectorConfig, names: Sequence[str] = ()) -> list[NamedConfig]:
    """Return the preset, and the preset with each setting in which it differs from `paper` set back to that, alone.

    A section that `paper` leaves out counts as one setting, and so does `candidates`; `names` chooses among them.
    """
    plain = dict(flatten(PAPER.model_dump(mode="json")))
    back: dict[str, str] = {}
    for name, value in flatten(config.model_dump(mode="json", exclude={"preset"})):
        section = name.split(".", maxsplit=1)[0]
        if name.startswith(_OF_THE_MAP) or (name in plain and plain[name] == value):
            continue
        if section == "candidates":
            back[section] = f"candidates.kind={PAPER.candidates.kind}"
        elif name in plain:
            back[name] = f"{name}={json.dumps(plain[name])}"
        else:
            back[section] = f"{section}=null"
    if unknown := [name for name in names if name not in back]:
        raise ConfigError(f"--take-out {unknown[0]}: expected one of {', '.join(back)}")
    without = [
        NamedConfig(name, with_settings(config, [setting]))
        for name, setting in back.items()
        if not names or name in names
    ]
    return [NamedConfig(NOTHING, config), *without]


_ACE, _AXES, _F1 = range(3)


def _by_place(rows: Iterable[Row]) -> dict[tuple[str, int], FloatArray]:
    """Return detections, right, missed, error, detections near known axes and their error, by node of the map.

    A node is one place on all drives that pass it. Detections without a node are one place for each drive.
    """
    places: dict[tuple[str, int], FloatArray] = {}
    for row in rows:
        for place in row.places:
            key = (row.cell.drive if place.node == UNMATCHED else "", place.node)
            axes = (0.0, 0.0) if place.axes_error_m is None else (place.detections, place.axes_error_m)
            matched = 0 if place.node == UNMATCHED else place.detections
            counts = (place.detections, matched, place.right, place.missed, place.error_m, *axes)
            places[key] = places.get(key, np.zeros(len(counts))) + np.array(counts, np.float64)
    return places


def _figures(counts: FloatArray) -> FloatArray:
    """Return ACE, the same against the axes, and F1 at 5 m in percent, of (..., places, 7) counts; NaN for none."""
    detections, matched, right, missed, error, known, off = np.moveaxis(counts.sum(axis=-2), -1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.stack([error / matched, off / known, 200.0 * right / (right + detections + missed)], axis=-1)


def ablation_table(rows: Sequence[Row], configs: Sequence[NamedConfig], title: str) -> Table:
    """Return what changes without each setting, with the interval of a bootstrap over places."""
    base = _by_place(row for row in rows if row.cell.preset == configs[0].name)
    lines: dict[tuple[str, ...], Iterable[str]] = {}
    for config in configs:
        other = _by_place(row for row in rows if row.cell.preset == config.name)
        keys, nothing = sorted({*base, *other}), np.zeros(7)
        counts = np.array([[of.get(key, nothing) for key in keys] for of in (base, other)]).reshape(2, -1, 7)
        here = _figures(counts)
        drawn = np.random.default_rng(0).integers(0, max(len(keys), 1), (_RESAMPLES, len(keys)))
        spread = np.diff(_figures(counts[:, drawn]), axis=0)[0]
        cells = []
        for which, write in ((_ACE, metres), (_AXES, metres), (_F1, one_decimal)):
            cells.append(_written(here[1, which], write))
            if config is not configs[0]:
                cells[-1] += _change(here[1, which] - here[0, which], spread[:, which], write)
        lines[config.name,] = cells
    drives = len({(row.cell.drive, row.cell.seed) for row in rows})
    return table_of(
        f"{title}: each setting in which the preset differs from paper set back to that, alone",
        lines,
        ["ACE [m]", "error from the axes [m]", "F1@5 [%]"],
        (
            f"{drives} drives, {len(base)} places. In brackets: change and its interval (bootstrap over places, 95 %),",
            "* where that does not hold 0. ACE: from the nodes of OpenStreetMap. Axes: from where the axes of roads",
            "meet, where that is known: in simulated drives, and in those with axes.csv.",
        ),
        names=["taken out"],
    )


def _written(value: float, write: Callable[[float], str]) -> str:
    return write(value) if np.isfinite(value) else MISSING


def _change(change: float, drawn: FloatArray, write: Callable[[float], str]) -> str:
    if not np.isfinite(change):
        return ""
    low, high = np.nanpercentile(drawn, (2.5, 97.5))
    sign = "*" if low > 0 or high < 0 else " "
    return f" ({'+' if change >= 0 else ''}{write(change)}; {write(low)} to {write(high)}){sign}"
