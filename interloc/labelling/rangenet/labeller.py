"""Labels of a scan by a network, in four steps."""

from __future__ import annotations

import os
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from interloc.arrays import Float32Array, UInt32Array
from interloc.errors import ConfigError, ModelError
from interloc.labelling.rangenet.graph import Network
from interloc.labelling.rangenet.image import by_pixel, normalise, project, range_image, vote
from interloc.labelling.rangenet.model import Model, read_model
from interloc.processes import cores
from interloc.stopwatch import Stopwatch

_inherited: list[Network] = []
"""Networks of a parent process, kept for ever: freeing one would wait for its threads, which only the parent has."""


class Labeller:
    """Gives every point of a scan a label, as a `ScanLabeller`.

    The network is loaded when the first scan comes, once per process: a labeller that is sent to another process, or
    inherited by a forked one, loads its own there. Several threads may label at the same time.

    Attributes
    ----------
    model : Model
    stopwatch : Stopwatch
        Time spent on "projection", "network" and "neighbours" in this process, summed over its threads; loading the
        network does not count.
    """

    def __init__(self, model: Model, provider: str = "cpu", threads: int | None = None) -> None:
        if threads is not None and threads < 1:
            raise ConfigError(f"threads: {threads}; a network needs at least 1.")
        self.model = model
        self.stopwatch = Stopwatch()
        self._provider = provider
        self._threads = threads
        self._ids = np.array(model.class_ids, np.uint32)
        self._network: Network | None = None
        self._process = 0
        self._lock = Lock()

    @property
    def name(self) -> str:
        """Name of the network."""
        return self.model.name

    @property
    def identity(self) -> str:
        """The same for the same files of a model."""
        return self.model.identity

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed of the network."""
        return self.model.notes

    def load(self) -> None:
        """Load the network, where this process has not done so yet: to have what is wrong with it reported early."""
        self._loaded()

    def label(self, points: Float32Array) -> UInt32Array:
        """Label a scan of (N, 4) points: x (ahead), y (left), z (up) in L, metres, and remission from 0 to 1.

        Points that are not finite get the label of class 0. The (N,) ids are those of `learning_map_inv` of
        data_cfg.yaml: those of SemanticKITTI for networks trained on it.
        """
        if points.ndim != 2 or points.shape[1] != 4:
            raise ModelError(f"points of shape {points.shape} are no scan; expected (N, 4): x, y, z and remission.")
        points = np.ascontiguousarray(points, np.float32)
        network, model, stopwatch = self._loaded(), self.model, Stopwatch()
        projection = project(points, model.height, model.width, model.fov_up_rad, model.fov_down_rad)  # III-A
        if not projection.filled.any():
            return np.full(len(points), self._ids[0], np.uint32)
        image = range_image(points, projection)
        given = normalise(image, projection, model.form.channels, model.means, model.stds)
        stopwatch.lap("projection")
        classes = network.run(given, projection.filled)  # III-B
        stopwatch.lap("network")
        if model.knn is None:
            found = by_pixel(classes, projection)
        else:
            found = vote(classes, projection, model.knn, first_class=model.first_class)  # III-D
        labels: UInt32Array = self._ids[found]
        stopwatch.lap("neighbours")
        with self._lock:
            self.stopwatch.add(stopwatch.seconds)
        return labels

    def _loaded(self) -> Network:
        with self._lock:
            if self._network is None or self._process != os.getpid():
                model = self.model
                if self._network is not None:
                    _inherited.append(self._network)
                self._network = Network(
                    model.graph,
                    model.form,
                    height=model.height,
                    width=model.width,
                    classes=len(model.class_ids),
                    provider=self._provider,
                    threads=self._threads or cores(),
                )
                self._process = os.getpid()
            return self._network

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_network": None, "_lock": None, "stopwatch": Stopwatch()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {"_lock": Lock()})


def open_labeller(folder: Path, provider: str, threads: int | None) -> Labeller:
    """Read the model of a folder; its network is loaded when it is needed."""
    return Labeller(read_model(folder), provider, threads)
