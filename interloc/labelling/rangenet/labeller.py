"""Labels of a scan by a network, in four steps: its range image, the network, votes of neighbours, and ids."""

from dataclasses import dataclass
from pathlib import Path
from threading import Lock

import numpy as np

from interloc.arrays import BoolArray, Float32Array, Int32Array, UInt8Array, UInt32Array
from interloc.errors import ConfigError, ModelError
from interloc.kernels.neighbours import vote_of_neighbours
from interloc.kernels.projection import fill_image, normalise_image, project_points
from interloc.labelling.rangenet.graph import Network
from interloc.labelling.rangenet.model import CHANNELS, KnnSettings, Model, read_model
from interloc.processes import cores


class Labeller:
    """Gives every point of a scan a label, as a `ScanLabeller`.

    The network is loaded when the first scan comes: a labeller that is sent to another process loads its own there.
    Several threads may label at the same time.
    """

    def __init__(self, model: Model, provider: str = "cpu", threads: int | None = None) -> None:
        if threads is not None and threads < 1:
            raise ConfigError(f"threads: {threads}; a network needs at least 1.")
        self.model = model
        self.name, self.identity, self.notes = model.name, model.identity, model.form.notes
        self._provider = provider
        self._threads = threads
        self._ids = np.array(model.class_ids, np.uint32)
        self._network: Network | None = None
        self._lock = Lock()

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
        network, model = self._loaded(), self.model
        projection = project(points, model.height, model.width, model.fov_up_rad, model.fov_down_rad)  # III-A
        if not projection.filled.any():
            return np.full(len(points), self._ids[0], np.uint32)
        image = fill_image(points, projection.index, projection.depth)
        channels = np.array([CHANNELS.index(name) for name in model.channels], np.int32)
        means, stds = np.array(model.means, np.float32), np.array(model.stds, np.float32)
        # Empty pixels are zero *after* the normalisation, as in training: before it they would be far below any.
        given = normalise_image(image, projection.index, channels, means, stds)
        classes = network.run(given)  # III-B
        if model.knn is None:
            found = by_pixel(classes, projection)
        else:
            found = vote(classes, projection, model.knn, first_class=model.first_class)  # III-D
        return self._ids[found]

    def _loaded(self) -> Network:
        with self._lock:
            if self._network is None:
                model = self.model
                self._network = Network(
                    model.graph,
                    model.form,
                    height=model.height,
                    width=model.width,
                    classes=len(model.class_ids),
                    provider=self._provider,
                    threads=self._threads or cores(),
                )
            return self._network

    def __getstate__(self) -> dict[str, object]:
        return self.__dict__ | {"_network": None, "_lock": None}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state | {"_lock": Lock()})


def open_labeller(folder: Path, provider: str, threads: int | None) -> Labeller:
    """Read the model of a folder; its network is loaded when it is needed."""
    return Labeller(read_model(folder), provider, threads)


# The range image


@dataclass(frozen=True)
class Projection:
    """Which point is seen in which pixel."""

    index: Int32Array
    """(H, W) int32: row of the nearest point of each pixel; -1 in empty pixels."""
    pixel: Int32Array
    """(N,) int32: pixel of each point, row * W + column; -1 for points without one."""
    depth: Float32Array
    """(N,) float32: distance of each point from the sensor, metres; -1 for points without a pixel."""

    @property
    def filled(self) -> BoolArray:
        """(H, W) bool, true where a pixel has a point."""
        return self.index >= 0


def project(points: Float32Array, height: int, width: int, fov_up_rad: float, fov_down_rad: float) -> Projection:
    """Project an (N, 4) scan onto a sphere around the sensor (RangeNet++, section III-A).

    Points that are not finite, or at the origin, get no pixel. The edges of the image lie above and below the horizon;
    as in the published code their signs do not matter, and points outside go to the first or last row.
    """
    index, pixel, depth = project_points(points, height, width, abs(fov_up_rad), abs(fov_down_rad))
    return Projection(index, pixel, depth)


def window_weights(search: int, sigma: float) -> Float32Array:
    """Return the (search, search) float32 factors of differences of range: 1 less a Gaussian of sum 1."""
    away = np.arange(search) - search // 2
    gaussian = np.exp(-(away**2) / (2 * sigma**2))
    window = np.outer(gaussian, gaussian)
    weights: Float32Array = (1 - window / window.sum()).astype(np.float32)
    return weights


def vote(classes: UInt8Array, projection: Projection, settings: KnnSettings, *, first_class: int = 1) -> UInt8Array:
    """Let the nearest neighbours of every point in the range image vote on its class (RangeNet++, section III-D).

    Points behind the nearest one of their pixel would else inherit its class: the wall behind a pole would be pole.
    Classes below `first_class` have no vote: 1 where class 0 means "no class", as published. Points without a pixel get
    class 0. What differs from the published code stands at `interloc.kernels.neighbours.vote_of_neighbours`.
    """
    weights = window_weights(settings.search, settings.sigma)
    cutoff = np.float32(settings.cutoff)
    limit = float(np.nextafter(cutoff, np.float32(np.inf))) if cutoff > 0 else np.inf
    seen = (projection.index, projection.pixel, projection.depth)
    return vote_of_neighbours(classes, *seen, weights, settings.neighbours, limit, first_class)


def by_pixel(classes: UInt8Array, projection: Projection) -> UInt8Array:
    """Return the (N,) uint8 class of the pixel of every point; 0 for points without a pixel."""
    found: UInt8Array = classes.reshape(-1)[projection.pixel]
    return np.where(projection.pixel < 0, np.uint8(0), found)
