"""Models: folders that hold a network and the settings that it was trained with; nothing in them is trusted."""

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

from pydantic import BeforeValidator, Field, StrictBool, StrictStr, TypeAdapter, ValidationError

from interloc.errors import ModelError, install
from interloc.files import reason_of
from interloc.labelling import ModelDescription
from interloc.labelling.rangenet.graph import Expected, GraphForm, describe_graph, match_graph

GRAPH, ARCH, DATA = "model.onnx", "arch_cfg.yaml", "data_cfg.yaml"

MAX_HEIGHT, MAX_WIDTH, MAX_PIXELS = 1024, 16384, 1 << 22
MAX_CLASSES = 256
MAX_SEARCH = 31
MAX_GRAPH_BYTES = 2 << 30

CHANNELS = ("range", "x", "y", "z", "remission", "mask")
"""What a network can be given, in the order of the range image; the mask is 1 where a pixel has a point."""

PUBLISHED = ("range", "x", "y", "z", "remission")
"""Order of the channels, and of their means and standard deviations, where the settings name none."""

_CHANNELS_FIELD = "dataset.sensor.channels"
_MAX_ID = 65535
_SAMPLES, _SAMPLE_BYTES = 16, 64 * 1024


@dataclass(frozen=True)
class KnnSettings:
    """How neighbours vote (``post.KNN.params`` of arch_cfg.yaml)."""

    neighbours: int = 5
    search: int = 5
    """Side of the window in which they are looked for, pixels, odd."""
    sigma: float = 1.0
    """Of the Gaussian that prefers pixels close by, pixels."""
    cutoff: float = 1.0
    """Neighbours whose weighted difference of range is larger do not vote, metres; 0 for no limit."""


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
    channels: tuple[str, ...]
    """Of the range image, in the order that the network wants."""
    means: tuple[float, ...]
    stds: tuple[float, ...]
    """Of the channels."""
    class_ids: tuple[int, ...]
    first_class: int
    """Lower classes get no vote among neighbours: 1, or 0 where data_cfg.yaml says that class 0 is not ignored."""
    knn: KnnSettings | None
    form: GraphForm

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.resolve().name

    @property
    def graph(self) -> Path:
        """File of the network."""
        return self.folder / GRAPH


def read_model(folder: str | Path) -> Model:
    """Read a model as the RangeNet++ / lidar-bonnetal family publishes it, and check that its files fit together.

    The folder holds `model.onnx`, `arch_cfg.yaml` (sensor, image, normalisation, post-processing) and `data_cfg.yaml`
    (classes). Where the input of the network is not range, x, y, z, remission, arch_cfg.yaml lists its channels under
    ``dataset.sensor.channels``; `img_means` and `img_stds` are then in that order.
    """
    folder = Path(folder)
    _check_files(folder)
    arch, data = read_settings(folder / ARCH), read_settings(folder / DATA)
    height, width, fov_up_rad, fov_down_rad = _read_sensor(arch)
    class_ids = _read_classes(data)
    knn = _read_knn(arch, width)
    listed = _listed_channels(arch)
    channels = listed or PUBLISHED
    files = (str(arch.path), str(data.path), str(folder / GRAPH))
    expected = Expected(*files, height, width, len(class_ids), channels)
    means = _read_statistics(arch, "dataset.sensor.img_means", listed, lowest=-1e6)
    stds = _read_statistics(arch, "dataset.sensor.img_stds", listed, lowest=1e-6)
    form = match_graph(*describe_graph(folder / GRAPH), expected)
    for channel in channels:
        for field, values in (("img_means", means), ("img_stds", stds)):
            if channel not in values:
                raise arch.fault(f"dataset.sensor.{field}", f"has no value for the channel {channel}.")
    return Model(
        folder=folder,
        identity=_identity(folder),
        height=height,
        width=width,
        fov_up_rad=fov_up_rad,
        fov_down_rad=fov_down_rad,
        channels=channels,
        means=tuple(means[channel] for channel in channels),
        stds=tuple(stds[channel] for channel in channels),
        class_ids=class_ids,
        first_class=1 if data.read("learning_ignore.0", FLAG, default=True) else 0,
        knn=knn,
        form=form,
    )


def describe(folder: Path) -> ModelDescription | None:
    """Tell what can be told of a model without loading its network; None where a folder holds no file of one.

    Whether a graph fits its settings is found out by `read_model`, which takes a second or more.
    """
    if not any((folder / name).exists() for name in (GRAPH, ARCH, DATA)):
        return None
    try:
        _check_files(folder)
        arch, data = read_settings(folder / ARCH), read_settings(folder / DATA)
        (height, width, *_), class_ids = _read_sensor(arch), _read_classes(data)
        _read_knn(arch, width)
        size = sum(path.stat().st_size for path in _graph_files(folder))
        identity = _identity(folder)
        return ModelDescription(folder.name, None, size, height, width, len(class_ids), identity)
    except ModelError as error:
        return ModelDescription(folder.name, problem=str(error))
    except OSError as error:
        return ModelDescription(folder.name, problem=f"{folder} cannot be read: {reason_of(error)}.")


def _check_files(folder: Path) -> None:
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


def _read_sensor(arch: "SettingsFile") -> tuple[int, int, float, float]:
    """Return height and width of the image in pixels, and its upper and lower edge in radians."""
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
    return height, width, math.radians(up), math.radians(down)


def _read_knn(arch: "SettingsFile", width: int) -> KnnSettings | None:
    if not arch.read("post.KNN.use", FLAG, default=False):
        return None
    params = "post.KNN.params"
    search = arch.read(f"{params}.search", whole(1, MAX_SEARCH))
    if search % 2 == 0 or search > width:
        raise arch.fault(
            f"{params}.search", f"found {search}; expected an odd number of pixels, no wider than the image."
        )
    return KnnSettings(
        neighbours=arch.read(f"{params}.knn", whole(1, search * search)),
        search=search,
        sigma=arch.read(f"{params}.sigma", number(1e-3, 1e3)),
        cutoff=arch.read(f"{params}.cutoff", number(0.0, 1e6)),
    )


def _listed_channels(arch: "SettingsFile") -> tuple[str, ...]:
    """Return the channels that the settings list; nothing where they list none."""
    if isinstance(arch.find(_CHANNELS_FIELD), int | None):  # a number would be that of the laser beams
        return ()
    names = tuple(word.lower() for word in arch.read(_CHANNELS_FIELD, WORDS))
    if not names or not set(names) <= set(CHANNELS) or len(set(names)) < len(names):
        raise arch.fault(
            _CHANNELS_FIELD,
            f"found {', '.join(names)[:200] or 'nothing'}; expected some of {', '.join(CHANNELS)}, each once.",
        )
    return names


def _read_statistics(arch: "SettingsFile", field: str, listed: tuple[str, ...], lowest: float) -> dict[str, float]:
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


def _read_classes(data: "SettingsFile") -> tuple[int, ...]:
    """Return the label id of every class."""
    forward = data.read("learning_map", table(_MAX_ID, MAX_CLASSES - 1), {})
    inverse = data.read("learning_map_inv", table(MAX_CLASSES - 1, _MAX_ID))
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
    return tuple(inverse[class_] for class_ in range(len(inverse)))


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


# Settings from YAML


MAX_BYTES = 64 * 1024
"""Of a file of settings; published ones have 3 to 6 KB."""

MAX_DEPTH = 20

T = TypeVar("T")


@dataclass(frozen=True)
class Kind(Generic[T]):
    """A type of pydantic, and how messages call it, and each part of it where it is a list or a table."""

    type: Any
    expected: str
    each: str = ""


def _no_flag(value: Any) -> Any:  # noqa: ANN401 - whatever the file says
    if isinstance(value, bool):
        raise ValueError("a flag is no number")  # noqa: TRY004 - pydantic turns it into its own error
    return value


@cache
def whole(lowest: int, highest: int) -> Kind[int]:
    """Return the kind of whole numbers within bounds."""
    bounded = Annotated[int, Field(ge=lowest, le=highest), BeforeValidator(_no_flag)]
    return Kind(bounded, f"a whole number from {lowest:,} to {highest:,}")


@cache
def number(lowest: float, highest: float) -> Kind[float]:
    """Return the kind of numbers within bounds; to YAML, 1e-3 is a word."""
    bounded = Annotated[float, Field(ge=lowest, le=highest, allow_inf_nan=False), BeforeValidator(_no_flag)]
    return Kind(bounded, f"a number from {lowest:g} to {highest:g}")


def numbers(lowest: float, highest: float) -> Kind[list[float]]:
    """Return the kind of lists of numbers within bounds."""
    each = number(lowest, highest)
    return Kind(list[each.type], "a list of numbers", each.expected)  # type: ignore[name-defined]


def table(highest_key: int, highest_value: int) -> Kind[dict[int, int]]:
    """Return the kind of tables from whole numbers to whole numbers, both from 0 on."""
    key, value = whole(0, highest_key), whole(0, highest_value)
    rows = Annotated[dict[key.type, value.type], Field(min_length=1)]  # type: ignore[name-defined]
    return Kind(rows, "a table of ids (0: 0, 1: 10, ...)", value.expected)


FLAG: Kind[bool] = Kind(StrictBool, "true or false")
WORDS: Kind[list[str]] = Kind(list[StrictStr], "a list of words", "a word")


@dataclass(frozen=True)
class SettingsFile:
    """What stands in a YAML file, asked for field by field."""

    path: Path
    values: dict[Any, Any]

    def find(self, field: str) -> Any:  # noqa: ANN401 - whatever the file says
        """Return what stands in a field such as ``post.KNN.use``; None where it is missing or empty."""
        value: Any = self.values
        for name in field.split("."):
            value = value.get(int(name) if name.isdigit() else name) if isinstance(value, dict) else None
        return value

    def read(self, field: str, kind: Kind[T], default: T | None = None) -> T:
        """Return a field of a kind."""
        value = self.find(field)
        if value is None and default is not None:
            return default
        if value is None:
            raise self.fault(
                field,
                f"is missing; expected {kind.expected}. Usual cause: a file of another kind "
                "(arch_cfg.yaml describes the sensor and the image, data_cfg.yaml the classes).",
            )
        try:
            found: T = TypeAdapter(kind.type).validate_python(value)
        except ValidationError as error:
            wrong = error.errors(include_url=False)[0]
            at, expected = wrong["loc"], kind.each if wrong["loc"] else kind.expected
            if at:
                field += ", a key" if at[-1] == "[key]" else f"[{at[0]}]"
            raise self.fault(field, f"{_shown(wrong['input'])}; expected {expected}.") from None
        return found

    def fault(self, field: str, message: str) -> ModelError:
        """Return the error to raise about a field: what was found, what was expected, the usual mistake."""
        return ModelError(f"{self.path}: {field}: {message}")


def read_settings(path: Path) -> SettingsFile:
    """Read a YAML file of settings."""
    try:
        import yaml  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise ModelError(f"labels by a network need PyYAML, which is not installed: {install('label')}") from error

    data = _read_bytes(path)
    try:
        _check_structure(path, yaml.parse(data, yaml.SafeLoader), yaml)
        values = yaml.safe_load(data)
    except (yaml.YAMLError, ValueError, OverflowError, TypeError, AttributeError, KeyError, IndexError) as error:
        raise ModelError(f"{path} is not YAML that can be read: {' '.join(str(error).split())[:300]}") from None
    if not isinstance(values, dict):
        raise ModelError(f"{path}: expected a table of settings (name: value); {_shown(values)}.")
    return SettingsFile(path, values)


def _check_structure(path: Path, events: Iterator[Any], yaml: Any) -> None:  # noqa: ANN401 - a module without types
    """Refuse, before anything is made of it, what could unfold or take very long."""
    depth = 0
    for event in events:
        if isinstance(event, yaml.events.AliasEvent):
            raise ModelError(f"{path} uses aliases (*name), which can unfold without bounds. Write the values out.")
        depth += isinstance(event, yaml.events.CollectionStartEvent) - isinstance(event, yaml.events.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise ModelError(f"{path} is nested more than {MAX_DEPTH} deep, which no file of settings is.")


def _read_bytes(path: Path) -> bytes:
    try:
        if path.exists() and not path.is_file():
            raise ModelError(f"{path} is a folder, pipe or device; a file of settings was expected.")
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise ModelError(
            f"{path} is missing. A model is a folder with model.onnx, arch_cfg.yaml and data_cfg.yaml, as the "
            "RangeNet++ / lidar-bonnetal family publishes it."
        ) from None
    except OSError as error:
        raise ModelError(f"{path} cannot be read: {reason_of(error)}.") from error
    if len(data) > MAX_BYTES:
        raise ModelError(f"{path} is larger than {MAX_BYTES // 1024} KB; settings of a model have a few KB.")
    return data


def _shown(value: object) -> str:
    """Return a value as messages show it, shortened."""
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > 64:
        return "a number of many digits"
    is_long = isinstance(value, list | dict) and len(value) > 8
    text = f"{type(value).__name__} of {len(value)}" if is_long else repr(value)  # type: ignore[arg-type]
    return f"found {text if len(text) <= 60 else text[:57] + '...'}"
