"""What a network's graph takes and gives, held against the settings beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from interloc.errors import ModelError

IMAGE_LAYOUTS = ("NCHW", "NHWC", "CHW", "HWC")
MASK_LAYOUTS = ("NHW", "N1HW", "NHW1", "HW")
SCORE_LAYOUTS = ("NKHW", "NHWK", "KHW", "HWK")
CLASS_LAYOUTS = ("NHW", "N1HW", "NHW1", "HW", "1HW")
"""Axes: N scans (1), C channels, K classes, H rows, W columns."""

REAL_TYPES = ("tensor(float)", "tensor(float16)")
WHOLE_TYPES = ("tensor(int64)", "tensor(int32)", "tensor(uint8)", "tensor(int8)", "tensor(int16)", "tensor(uint16)")
MASK_TYPES = (*REAL_TYPES, "tensor(bool)", *WHOLE_TYPES)


@dataclass(frozen=True)
class Tensor:
    """An input or an output."""

    name: str
    type: str
    """As onnxruntime calls it: ``tensor(float)``."""
    shape: tuple[int | None, ...]
    """Size of each axis; None where the graph leaves it open."""

    def __str__(self) -> str:
        sizes = ", ".join("?" if size is None else str(size) for size in self.shape)
        return f"{self.name!r} {self.type} ({sizes})"


@dataclass(frozen=True)
class GraphInput:
    """How to feed an input: the order of its axes, and its type."""

    name: str
    layout: str
    type: str


@dataclass(frozen=True)
class GraphForm:
    """How to run a network."""

    channels: tuple[str, ...]
    """Of the range image, in the order that the input wants."""
    image: GraphInput
    mask: GraphInput | None
    """Which pixels have a point, where the network asks for it."""
    outputs: tuple[str, ...]
    """Names of the outputs that can be the classes; the first that has the size of the image is used."""
    notes: tuple[str, ...] = ()
    """What was assumed."""


@dataclass(frozen=True)
class Expected:
    """What the settings say about the graph, and where they say it."""

    arch: str
    data: str
    graph: str
    """The files, in messages."""
    height: int
    width: int
    classes: int
    channels: tuple[tuple[str, ...], ...]
    """The channels of the input; alternatives where the settings leave several."""

    def sizes(self, channels: int = 0) -> dict[str, int]:
        """Return the size of each axis."""
        return {"N": 1, "1": 1, "C": channels, "K": self.classes, "H": self.height, "W": self.width}


def layout_of(shape: Sequence[int | None], layouts: Sequence[str], sizes: dict[str, int]) -> str | None:
    """Return the first of the layouts that a shape fits; axes that are left open fit any size."""
    for layout in layouts:
        if len(shape) == len(layout) and all(
            found is None or found == sizes[axis] for found, axis in zip(shape, layout, strict=True)
        ):
            return layout
    return None


def output_layout(kind: str, shape: Sequence[int | None], sizes: dict[str, int]) -> str | None:
    """Return the layout of an output that gives scores (real) or classes (whole numbers); None where it is neither."""
    if kind in REAL_TYPES:
        return layout_of(shape, SCORE_LAYOUTS, sizes)
    return layout_of(shape, CLASS_LAYOUTS, sizes) if kind in WHOLE_TYPES else None


def match_graph(inputs: Sequence[Tensor], outputs: Sequence[Tensor], expected: Expected) -> GraphForm:
    """Find out how to feed a graph and which of its outputs to take.

    Raises
    ------
    ModelError
        The graph does not fit the settings: names the file and field, what the graph has and what was expected.
    """
    image, channels = _image_input(inputs, expected)
    mask = _mask_input([tensor for tensor in inputs if tensor.name != image.name], expected)
    fitting = [tensor for tensor in outputs if output_layout(tensor.type, tensor.shape, expected.sizes())]
    if not fitting:
        raise _wrong_output(outputs, expected)
    notes = []
    if len(outputs) > 1:
        others = ", ".join(str(tensor) for tensor in outputs if tensor != fitting[0])
        notes.append(f"the network has several outputs; {fitting[0]} is used, not {others}.")
    return GraphForm(channels, image, mask, tuple(tensor.name for tensor in fitting), tuple(notes))


def _image_input(inputs: Sequence[Tensor], expected: Expected) -> tuple[GraphInput, tuple[str, ...]]:
    for tensor in inputs:
        for channels in expected.channels:
            layout = layout_of(tensor.shape, IMAGE_LAYOUTS, expected.sizes(len(channels)))
            if layout and tensor.type in REAL_TYPES:
                return GraphInput(tensor.name, layout, tensor.type), channels
    raise _wrong_input(inputs, expected)


def _mask_input(others: Sequence[Tensor], expected: Expected) -> GraphInput | None:
    if not others:
        return None
    layout = layout_of(others[0].shape, MASK_LAYOUTS, expected.sizes())
    if len(others) > 1 or layout is None or others[0].type not in MASK_TYPES:
        raise ModelError(
            f"{expected.graph} wants more than a range image: {', '.join(str(tensor) for tensor in others)}. Beside it "
            f"only a mask of the pixels with a point can be given, (1, {expected.height}, {expected.width}) or "
            f"(1, 1, {expected.height}, {expected.width}). Usual cause: a network that works on points, or an export "
            "together with the post-processing."
        )
    return GraphInput(others[0].name, layout, others[0].type)


def _wrong_input(inputs: Sequence[Tensor], expected: Expected) -> ModelError:
    """Name the field that the input contradicts."""
    height, width, count = expected.height, expected.width, len(expected.channels[0])
    wanted = f"expected (1, {count}, {height}, {width}) or (1, {height}, {width}, {count}), float or float16"
    images = [tensor for tensor in inputs if len(tensor.shape) in {3, 4}]
    if not images:
        found = ", ".join(str(tensor) for tensor in inputs) or "nothing"
        return ModelError(
            f"{expected.graph} takes no image: its inputs are {found}; {wanted}. "
            "Usual cause: a network that works on points or voxels instead of range images."
        )
    tensor = images[0]
    if tensor.type not in REAL_TYPES:
        return ModelError(
            f"{expected.graph}: input {tensor} is not of real numbers; {wanted}. Usual cause: a quantised export."
        )
    if len(tensor.shape) == 4 and tensor.shape[0] not in {None, 1}:
        return ModelError(
            f"{expected.graph}: input {tensor} takes {tensor.shape[0]} scans at once; {wanted}. "
            "Usual cause: exported with the batch size of the training; export it with 1, or with a dynamic batch."
        )
    axes = tensor.shape[-3:]
    prefix = f"{expected.arch}: dataset.sensor"
    begin = f"but input {tensor} of {expected.graph}"
    channels = {len(each) for each in expected.channels}
    fits_size = layout_of(axes[1:], ("HW",), expected.sizes()) or layout_of(axes[:2], ("HW",), expected.sizes())
    if fits_size and not any(layout_of(axes, ("CHW", "HWC"), expected.sizes(n)) for n in channels):
        names = ", ".join(expected.channels[0])
        count_found = axes[0] if layout_of(axes[1:], ("HW",), expected.sizes()) else axes[2]
        return ModelError(
            f"{prefix}.channels: the settings give {count} ({names}), {begin} takes {count_found}; {wanted}. "
            "Usual cause: a network with fewer or other channels: list them there in its order, "
            "for example [x, y, z, remission, range]."
        )
    row_axis, column_axis = (0, 1) if axes[2] in channels and axes[0] not in channels else (1, 2)
    rows, columns = axes[row_axis], axes[column_axis]
    if (rows, columns) == (width, height):
        return ModelError(
            f"{prefix}.img_prop: height {height} and width {width}, {begin} has them the other way round; {wanted}. "
            "Usual cause: a network exported with width before height."
        )
    field, value = ("width", width) if columns not in {None, width} else ("height", height)
    return ModelError(
        f"{prefix}.img_prop.{field}: {value}, {begin} has another size; {wanted}. "
        "Usual cause: arch_cfg.yaml of another model, or an export with another size of image."
    )


def _wrong_output(outputs: Sequence[Tensor], expected: Expected) -> ModelError:
    """Name the field that the outputs contradict."""
    height, width, classes = expected.height, expected.width, expected.classes
    found = ", ".join(str(tensor) for tensor in outputs) or "none"
    wanted = (
        f"expected scores (1, {classes}, {height}, {width}) or (1, {height}, {width}, {classes}), "
        f"or classes (1, {height}, {width}) as whole numbers"
    )
    for tensor in outputs:
        for layout in SCORE_LAYOUTS:
            if tensor.type in REAL_TYPES and len(tensor.shape) == len(layout):
                count = tensor.shape[layout.index("K")]
                if count is not None and layout_of(tensor.shape, [layout], expected.sizes() | {"K": count}):
                    return ModelError(
                        f"{expected.data}: learning_map_inv: {classes} classes (0 to {classes - 1}), but output "
                        f"{tensor} of {expected.graph} has {count}; {wanted}. Usual cause: data_cfg.yaml of another "
                        "model, or a network trained without a class 0 for points without a class."
                    )
    return ModelError(
        f"{expected.graph}: its outputs are {found}; {wanted}. Usual cause: an export of a part of the network only, "
        f"or arch_cfg.yaml (dataset.sensor.img_prop) of another model."
    )
