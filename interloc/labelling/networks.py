"""Networks that label scans, of any kind: this package brings one, others come by the entry point group below.

An entry point is named as its kind of network, and leads to a module (or object) with two functions, as
`interloc.labelling.rangenet` has them::

    describe(folder: Path) -> ModelDescription | None                  # None: it holds a network of another kind
    open_labeller(folder: Path, provider: str, threads: int | None) -> ScanLabeller
"""

from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from interloc.arrays import Float32Array, UInt32Array
from interloc.errors import ModelError
from interloc.files import reason_of
from interloc.labelling import ModelDescription

GROUP = "interloc.networks"
MAX_MODELS = 1000


class ScanLabeller(Protocol):
    """A network that labels scans; it can be sent to other processes, and several threads may use it."""

    @property
    def name(self) -> str:
        """Name of the network."""

    @property
    def identity(self) -> str:
        """The same for networks that give the same labels."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed of it."""

    def load(self) -> None:
        """Load the network now: to have what is wrong with it reported early."""

    def label(self, points: Float32Array) -> UInt32Array:
        """Return the (N,) ids of SemanticKITTI of (N, 4) points: x y z in L, metres, and remission from 0 to 1."""


def open_network(folder: str | Path, provider: str = "cpu", threads: int | None = None) -> ScanLabeller:
    """Open the network of a folder; `provider` runs it: "cpu", or "cuda" and others where they are installed.

    A scan takes so many processor threads, or all cores; 1 is best where several scans are labelled at the same time. A
    `ModelError` names the file, the field, what was found and what was expected.
    """
    folder = Path(folder)
    kind = next((kind for kind in _installed_kinds() if kind.describe(folder) is not None), _own_kind())
    labeller: ScanLabeller = kind.open_labeller(folder, provider, threads)
    return labeller


def describe_networks(folder: str | Path) -> list[ModelDescription]:
    """List the networks in the sub-folders of a folder, by name; broken ones with the reason."""
    folder = Path(folder)
    try:
        names = sorted(entry.name for entry in folder.iterdir() if entry.is_dir() and not entry.name.startswith("."))
    except OSError as error:
        raise ModelError(f"{folder}, the folder of the models, cannot be read: {reason_of(error)}.") from error
    kinds = (*_installed_kinds(), _own_kind())
    described = ((kind.describe(folder / name) for kind in kinds) for name in names[:MAX_MODELS])
    return [found for each in described if (found := next(filter(None, each), None)) is not None]


@cache
def _installed_kinds() -> tuple[Any, ...]:
    """Load what other packages bring."""
    kinds = []
    for point in entry_points(group=GROUP):
        try:
            kinds.append(point.load())
        except (ImportError, AttributeError) as error:
            raise ModelError(f"networks of the kind {point.name}: {point.value} cannot be loaded: {error}.") from error
    return tuple(kinds)


def _own_kind() -> Any:  # noqa: ANN401 - a module, as those that other packages bring
    from interloc.labelling import rangenet  # noqa: PLC0415 - slow to import

    return rangenet


def remission_scale(values: ArrayLike) -> float:
    """Guess what remission has to be divided by: 1, 255 or 65535, the smallest that holds all but the brightest 0.1 %.

    A network of the family that is given 0..255 instead of 0..1 finds no road at all. It is to be decided once per
    drive, from some of its scans, because a single scan may be dark. The scales are [0, 1] (KITTI, SemanticKITTI,
    KITTI-360), 8 bits (Velodyne, Hesai, RoboSense, Livox, nuScenes) and 16 bits (Ouster's signal, LAS). Values of the
    first may exceed 1 by half: no sensor of 8 bits is that dark. It is 1 too where remission is missing: no finite
    values, or only zeros.
    """
    array = np.asarray(values, dtype=np.float64).ravel()
    array = array[np.isfinite(array)]
    if not array.size:
        return 1.0
    high = float(np.quantile(array, 0.999, method="lower"))  # single values may be wrong
    if high <= 1.5:
        return 1.0
    return 255.0 if high <= 255.0 else 65535.0
