"""Models: folders that hold a network and the settings that it was trained with."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

from interloc.errors import ModelError
from interloc.files import reason_of
from interloc.labelling.graph import Expected, GraphForm, match_graph
from interloc.labelling.neighbours import KnnSettings
from interloc.labelling.network import describe_graph
from interloc.labelling.projection import CHANNELS
from interloc.labelling.settings import FLAG, WORDS, SettingsFile, number, numbers, read_settings, table, whole

GRAPH, ARCH, DATA = "model.onnx", "arch_cfg.yaml", "data_cfg.yaml"

MAX_HEIGHT, MAX_WIDTH, MAX_PIXELS = 1024, 16384, 1 << 22
MAX_CLASSES = 256
MAX_SEARCH = 31
MAX_GRAPH_BYTES = 2 << 30
MAX_MODELS = 1000
"""Sub-folders that are looked at."""

PUBLISHED = ("range", "x", "y", "z", "remission")
"""Order of the channels, and of their means and standard deviations, where the settings name none."""

_SYNONYMS = {"depth": "range", "intensity": "remission", "reflectivity": "remission", "signal": "remission"}
_CHANNEL_FIELDS = ("dataset.sensor.channels", "dataset.sensor.input_channels", "input_channels")
_MAX_ID = 65535
_SAMPLES, _SAMPLE_BYTES = 16, 64 * 1024


@dataclass(frozen=True)
class Model:
    """A network with everything that is needed to label scans by it; small, and made to be sent to other processes."""

    folder: Path
    identity: str
    """The same for the same files, whatever their names and places."""
    height: int
    width: int
    """Of the range image, pixels."""
    fov_up_rad: float
    fov_down_rad: float
    """Its upper and lower edge, radians above and below the horizon, both >= 0."""
    means: tuple[float, ...]
    stds: tuple[float, ...]
    """Of the channels in the order of `form.channels`."""
    class_ids: tuple[int, ...]
    """Label id of every class of the network."""
    first_class: int
    """Lower classes get no vote among neighbours: 1, or 0 where data_cfg.yaml says that class 0 is not ignored."""
    knn: KnnSettings | None
    """Of the post-processing; None where there is none."""
    form: GraphForm
    """How to run the network."""
    notes: tuple[str, ...] = ()
    """What was assumed."""

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.resolve().name

    @property
    def graph(self) -> Path:
        """File of the network."""
        return self.folder / GRAPH


@dataclass(frozen=True)
class ModelDescription:
    """A model in a list: what can be told without loading its network."""

    name: str
    """Of the folder."""
    problem: str | None = None
    """Why it cannot be used; everything else is then as far as it is known."""
    bytes: int | None = None
    """Size of the network on disk."""
    height: int | None = None
    width: int | None = None
    classes: int | None = None
    """Of the range image, and how many classes there are."""
    identity: str | None = None
    """As `Model.identity`."""


@dataclass(frozen=True)
class _Sensor:
    """The image, of arch_cfg.yaml."""

    height: int
    width: int
    fov_up_rad: float
    fov_down_rad: float


def read_model(folder: str | Path) -> Model:
    """Read a model as the RangeNet++ / lidar-bonnetal family publishes it, and check that its files fit together.

    Parameters
    ----------
    folder
        Holds `model.onnx`, `arch_cfg.yaml` (sensor, image, normalisation, post-processing) and `data_cfg.yaml`
        (classes). Where the input of the network is not range, x, y, z, remission, arch_cfg.yaml lists its channels
        under ``dataset.sensor.channels``; `img_means` and `img_stds` are then in that order.

    Raises
    ------
    ModelError
        A file is missing, damaged or too large, a field is missing or has no meaning, the graph does not fit the
        settings, or onnxruntime or PyYAML is not installed. Names the file, the field, what the graph has and what was
        expected.
    """
    folder = Path(folder)
    _check_files(folder)
    arch, data = read_settings(folder / ARCH), read_settings(folder / DATA)
    sensor = _read_sensor(arch)
    class_ids, notes = _read_classes(data)
    knn = _read_knn(arch, sensor)
    listed = _listed_channels(arch)
    expected = Expected(
        arch=str(arch.path),
        data=str(data.path),
        graph=str(folder / GRAPH),
        height=sensor.height,
        width=sensor.width,
        classes=len(class_ids),
        channels=(listed,) if listed else _usual_channels(arch),
    )
    means = _read_statistics(arch, "dataset.sensor.img_means", listed, lowest=-1e6)
    stds = _read_statistics(arch, "dataset.sensor.img_stds", listed, lowest=1e-6)
    form = match_graph(*describe_graph(folder / GRAPH), expected)
    for channel in form.channels:
        for field, values in (("img_means", means), ("img_stds", stds)):
            if channel not in values:
                raise arch.fault(f"dataset.sensor.{field}", f"has no value for the channel {channel}.")
    return Model(
        folder=folder,
        identity=_identity(folder),
        height=sensor.height,
        width=sensor.width,
        fov_up_rad=sensor.fov_up_rad,
        fov_down_rad=sensor.fov_down_rad,
        means=tuple(means[channel] for channel in form.channels),
        stds=tuple(stds[channel] for channel in form.channels),
        class_ids=class_ids,
        first_class=1 if data.read("learning_ignore.0", FLAG, default=True) else 0,
        knn=knn,
        form=form,
        notes=notes + form.notes,
    )


def describe_models(folder: str | Path) -> list[ModelDescription]:
    """List the models of a folder, sorted by name, without loading their networks.

    Parameters
    ----------
    folder
        Its sub-folders that hold any of the three files of a model are listed, broken ones with the reason.

    Returns
    -------
    list of ModelDescription
        Whether a graph fits its settings is found out by `read_model`, which takes a second or more.

    Raises
    ------
    ModelError
        The folder cannot be read.
    """
    folder = Path(folder)
    try:
        names = sorted(entry.name for entry in folder.iterdir() if entry.is_dir() and not entry.name.startswith("."))
    except OSError as error:
        raise ModelError(f"{folder}, the folder of the models, cannot be read: {reason_of(error)}.") from error
    candidates = [folder / name for name in names[:MAX_MODELS]]
    return [_describe(each) for each in candidates if any((each / name).exists() for name in (GRAPH, ARCH, DATA))]


def _describe(folder: Path) -> ModelDescription:
    try:
        _check_files(folder)
        arch, data = read_settings(folder / ARCH), read_settings(folder / DATA)
        sensor, (class_ids, _) = _read_sensor(arch), _read_classes(data)
        _read_knn(arch, sensor)
        return ModelDescription(
            name=folder.name,
            bytes=sum(path.stat().st_size for path in _graph_files(folder)),
            height=sensor.height,
            width=sensor.width,
            classes=len(class_ids),
            identity=_identity(folder),
        )
    except ModelError as error:
        return ModelDescription(folder.name, problem=str(error))
    except OSError as error:
        return ModelDescription(folder.name, problem=f"{folder} cannot be read: {reason_of(error)}.")


def _check_files(folder: Path) -> None:
    """Raise ModelError where the folder or its network is not there."""
    if not folder.is_dir():
        raise ModelError(
            f"{folder} is not a folder. A model is a folder with {GRAPH}, {ARCH} and {DATA}, as the RangeNet++ / "
            "lidar-bonnetal family publishes it."
        )
    graph = folder / GRAPH
    if not graph.is_file():
        others = sorted(path.name for path in folder.iterdir() if path.suffix in {".onnx", ".pth", ".pt", ".trt"})[:3]
        hint = (
            f" It holds {', '.join(others)}: rename the network, or export it as ONNX."
            if others
            else " Usual cause: published weights that are not exported to ONNX yet, or the folder above."
        )
        raise ModelError(f"{graph} is missing or not a file; expected {GRAPH}, {ARCH} and {DATA} in a folder.{hint}")
    size = graph.stat().st_size
    if not 0 < size <= MAX_GRAPH_BYTES:
        raise ModelError(f"{graph} has {size:,} bytes; expected a network of at most {MAX_GRAPH_BYTES >> 30} GB.")


def _graph_files(folder: Path) -> list[Path]:
    """Return the network and the files of weights that may lie beside it (model.onnx.data)."""
    return sorted(path for path in folder.iterdir() if path.name.startswith(GRAPH) and path.is_file())


def _read_sensor(arch: SettingsFile) -> _Sensor:
    height = arch.read("dataset.sensor.img_prop.height", whole(1, MAX_HEIGHT))
    width = arch.read("dataset.sensor.img_prop.width", whole(1, MAX_WIDTH))
    if height * width > MAX_PIXELS:
        raise arch.fault(
            "dataset.sensor.img_prop", f"{height} x {width} pixels are more than the {MAX_PIXELS:,} that are possible."
        )
    up, down = (arch.read(f"dataset.sensor.fov_{side}", number(-90, 90)) for side in ("up", "down"))
    up, down = abs(up), abs(down)
    if up + down < 0.1:
        raise arch.fault(
            "dataset.sensor.fov_up",
            f"fov_up {up:g} and fov_down {down:g} leave no field of view; expected degrees, as in 3 and -25.",
        )
    return _Sensor(height, width, math.radians(up), math.radians(down))


def _read_knn(arch: SettingsFile, sensor: _Sensor) -> KnnSettings | None:
    if not arch.read("post.KNN.use", FLAG, default=False):
        return None
    params = "post.KNN.params"
    search = arch.read(f"{params}.search", whole(1, MAX_SEARCH))
    if search % 2 == 0 or search > sensor.width:
        raise arch.fault(
            f"{params}.search", f"found {search}; expected an odd number of pixels, no wider than the image."
        )
    return KnnSettings(
        neighbours=arch.read(f"{params}.knn", whole(1, search * search)),
        search=search,
        sigma=arch.read(f"{params}.sigma", number(1e-3, 1e3)),
        cutoff=arch.read(f"{params}.cutoff", number(0.0, 1e6)),
    )


def _listed_channels(arch: SettingsFile) -> tuple[str, ...]:
    """Return the channels that the settings list; nothing where they list none."""
    for field in _CHANNEL_FIELDS:
        if arch.find(field) is not None and not isinstance(
            arch.find(field), int
        ):  # a number would be that of the laser beams
            names = tuple(_SYNONYMS.get(word.lower(), word.lower()) for word in arch.read(field, WORDS))
            unknown = [name for name in names if name not in CHANNELS]
            if unknown or not names or len(set(names)) < len(names):
                raise arch.fault(
                    field,
                    f"found {', '.join(names)[:200] or 'nothing'}; expected some of {', '.join(CHANNELS)}, each once.",
                )
            return names
    return ()


def _usual_channels(arch: SettingsFile) -> tuple[tuple[str, ...], ...]:
    """Return the five channels of the family, and those that the network is said to use where these are fewer.

    Networks of the family are given all five and pick theirs; some exports start after that.
    """
    groups = {"range": ("range",), "xyz": ("x", "y", "z"), "remission": ("remission",)}
    used = tuple(
        name
        for group, names in groups.items()
        if arch.read(f"backbone.input_depth.{group}", FLAG, default=True)
        for name in names
    )
    return (PUBLISHED,) if used in {PUBLISHED, ()} else (PUBLISHED, used)


def _read_statistics(arch: SettingsFile, field: str, listed: tuple[str, ...], lowest: float) -> dict[str, float]:
    """Return the means or the standard deviations by channel."""
    values = arch.read(field, numbers(lowest, 1e6))
    neutral = {"mask": 0.0 if lowest < 0 else 1.0}
    measured = tuple(name for name in listed if name != "mask")
    for names in (listed, measured, PUBLISHED):
        if names and len(values) == len(names):
            return neutral | dict(zip(names, values, strict=True))
    raise arch.fault(
        field, f"found {len(values)} numbers; expected one per channel: {', '.join(measured or PUBLISHED)}."
    )


def _read_classes(data: SettingsFile) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Return the label id of every class, and what was assumed."""
    forward = data.read("learning_map", table(_MAX_ID, MAX_CLASSES - 1), {})
    if forward and data.find("learning_map_inv") is None:
        inverse: dict[int, int] = {}
        for label, class_ in sorted(forward.items()):
            inverse.setdefault(class_, label)
        note = f"{data.path}: no learning_map_inv; each class gets the lowest id that learning_map maps to it."
        notes: tuple[str, ...] = (note,)
    else:
        inverse, notes = data.read("learning_map_inv", table(MAX_CLASSES - 1, _MAX_ID)), ()
    missing = [class_ for class_ in range(max(inverse) + 1) if class_ not in inverse]
    if missing:
        raise data.fault(
            "learning_map_inv",
            f"class {missing[0]} is missing; expected an id for every class from 0 to {max(inverse)}. "
            "Usual cause: learning_map (id: class) under the name of its inverse (class: id).",
        )
    for class_, label in inverse.items():
        if forward.get(label, class_) != class_:
            raise data.fault(
                "learning_map_inv",
                f"gives class {class_} the id {label}, but learning_map gives id {label} the class {forward[label]}. "
                "Usual cause: one of the two tables is of another model.",
            )
    return tuple(inverse[class_] for class_ in range(len(inverse))), notes


def _identity(folder: Path) -> str:
    """Return a digest of the settings and of samples of the network: its begin, its end and between.

    Networks of hundreds of megabytes are not read whole for it: training changes weights everywhere.
    """
    digest = hashlib.sha256()
    for name in (ARCH, DATA):
        content = (folder / name).read_bytes()
        digest.update(len(content).to_bytes(8) + content)
    for path in _graph_files(folder):
        size = path.stat().st_size
        digest.update(size.to_bytes(8))
        with path.open("rb") as file:
            for sample in range(_SAMPLES):
                file.seek(max(size - _SAMPLE_BYTES, 0) * sample // (_SAMPLES - 1))
                digest.update(file.read(_SAMPLE_BYTES))
    return digest.hexdigest()
