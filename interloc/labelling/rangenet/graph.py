"""What a network's graph takes and gives, held against the settings beside it; and the network run by onnxruntime."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np

from interloc.arrays import BoolArray, Float32Array, UInt8Array
from interloc.errors import ConfigError, ModelError, install
from interloc.kernels.projection import best_classes

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
    """An input or an output, with its type as onnxruntime calls it; axes that the graph leaves open have size None."""

    name: str
    type: str
    shape: tuple[int | None, ...]

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
    """How to run a network, and what was assumed of it."""

    channels: tuple[str, ...]
    """Of the range image, in the order that the input wants."""
    image: GraphInput
    mask: GraphInput | None
    """Which pixels have a point, where the network asks for it."""
    outputs: tuple[str, ...]
    """Names of the outputs that can be the classes; the first that has the size of the image is used."""
    notes: tuple[str, ...] = ()


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
    """Find out how to feed a graph and which of its outputs to take."""
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
    height, width, channels = expected.height, expected.width, expected.channels[0]
    count = len(channels)
    return ModelError(
        f"{expected.graph} takes {', '.join(map(str, inputs)) or 'nothing'}; expected one image of float or float16, "
        f"(1, {count}, {height}, {width}) or (1, {height}, {width}, {count}), by {expected.arch}: "
        f"dataset.sensor.img_prop (height {height}, width {width}), dataset.sensor.channels ({', '.join(channels)}). "
        "Usual cause: arch_cfg.yaml of another model; fewer or other channels, which are listed there in the order of "
        "the network; a network that works on points; or an export that is quantised, for several scans at once, or "
        "with width before height."
    )


def _wrong_output(outputs: Sequence[Tensor], expected: Expected) -> ModelError:
    height, width, classes = expected.height, expected.width, expected.classes
    return ModelError(
        f"{expected.graph} gives {', '.join(map(str, outputs)) or 'nothing'}; expected scores (1, {classes}, {height}, "
        f"{width}) or (1, {height}, {width}, {classes}), or classes (1, {height}, {width}) as whole numbers, by the "
        f"{classes} classes of {expected.data}: learning_map_inv. Usual "
        "cause: settings of another model, a network without a class 0 for points without a class, or an export of a "
        "part of it."
    )


# The network


_DTYPES = {kind: np.dtype("float32" if kind == "tensor(float)" else kind[7:-1]) for kind in MASK_TYPES}
_TYPES = {dtype: kind for kind, dtype in _DTYPES.items()}
_SCAN_LIMIT_S = 600.0  # a loop in the graph may be endless


def describe_graph(path: Path) -> tuple[list[Tensor], list[Tensor]]:
    """Return the inputs and the outputs of a graph."""
    session = _open_session(path, "cpu", threads=1, optimise=False)
    inputs = [_tensor(each) for each in session.get_inputs()]
    return inputs, [_tensor(each) for each in session.get_outputs()]


class Network:
    """A loaded network, for one process: the graph of a file, fed by its form, on a provider and some threads."""

    def __init__(
        self, path: Path, form: GraphForm, *, height: int, width: int, classes: int, provider: str, threads: int
    ) -> None:
        self._path = path
        self._form = form
        self._sizes = {"N": 1, "1": 1, "K": classes, "H": height, "W": width}
        self._classes = classes
        self._session = _open_session(path, provider, threads=threads, optimise=True)
        self._outputs = list(form.outputs)

    def run(self, image: Float32Array, filled: BoolArray) -> UInt8Array:
        """Return the (H, W) classes of a normalised (C, H, W) image, given which of its (H, W) pixels have a point."""
        feed = {self._form.image.name: _laid_out(image, self._form.image)}
        if self._form.mask is not None:
            feed[self._form.mask.name] = _laid_out(filled[None], self._form.mask)
        options = _onnxruntime().RunOptions()
        limit = Timer(_SCAN_LIMIT_S, setattr, (options, "terminate", True))
        limit.daemon = True
        limit.start()
        try:
            outputs = self._outputs
            found = self._session.run(outputs, feed, options)
        except Exception as error:  # onnxruntime's errors have no common base
            if options.terminate:
                raise ModelError(
                    f"{self._path} took more than {_SCAN_LIMIT_S:g} s for a range image and was ended. "
                    "Usual cause: a loop in the graph that does not end, or a network for another device."
                ) from error
            raise ModelError(
                f"{self._path} failed on a range image: {_first_line(error)} "
                "Usual cause: sizes inside of the network that fit another image, or too little memory."
            ) from error
        finally:
            limit.cancel()
        for name, output in zip(outputs, found, strict=True):
            layout = output_layout(_TYPES.get(output.dtype, ""), output.shape, self._sizes)
            if layout is not None:
                self._outputs = [name]  # the others need not be fetched again
                return self._classes_of(output, layout)
        shapes = ", ".join(f"{name!r} {array.shape}" for name, array in zip(outputs, found, strict=True))
        raise ModelError(
            f"{self._path} gives {shapes} for an image of {self._sizes['H']} x {self._sizes['W']} pixels; expected "
            f"{self._classes} scores or one class per pixel. Usual cause: an export that lacks the last layers."
        )

    def _classes_of(self, output: Any, layout: str) -> UInt8Array:  # noqa: ANN401 - any type of number
        height, width = self._sizes["H"], self._sizes["W"]
        if "K" not in layout:
            lowest, highest = int(output.min()), int(output.max())
            if lowest < 0 or highest >= self._classes:
                raise ModelError(
                    f"{self._path} gives classes from {lowest} to {highest}, but learning_map_inv of data_cfg.yaml has "
                    f"those from 0 to {self._classes - 1}. Usual cause: data_cfg.yaml of another model, or a network "
                    "that gives ids instead of classes."
                )
            classes: UInt8Array = output.reshape(height, width).astype(np.uint8)
            return classes
        scores = output.reshape(self._classes, -1) if layout.endswith("KHW") else output.reshape(-1, self._classes).T
        best, bad = best_classes(np.ascontiguousarray(scores, dtype=np.float32))
        if bad:
            raise ModelError(
                f"{self._path}: {bad:,} scores of a range image are not numbers. Usual cause: an export in half "
                "precision that overflows; export it in single precision, and compare the labels of both."
            )
        return best.reshape(height, width)


def _laid_out(image: Any, form: GraphInput) -> Any:  # noqa: ANN401 - any type of number
    """Bring an image (C, H, W) into the order of axes and the type of an input."""
    array = image.transpose(1, 2, 0) if form.layout.endswith(("HWC", "HW1")) else image
    if form.layout == "HW":
        array = array[0]
    if form.layout in {"NCHW", "NHWC", "N1HW", "NHW1"}:
        array = array[None]
    return np.ascontiguousarray(array, dtype=_DTYPES[form.type])


def _tensor(value: Any) -> Tensor:  # noqa: ANN401 - onnxruntime's NodeArg
    sizes = tuple(size if isinstance(size, int) and size >= 0 else None for size in value.shape or ())
    return Tensor(value.name, value.type, sizes)


def _onnxruntime() -> Any:  # noqa: ANN401 - a module without types
    try:
        return importlib.import_module("onnxruntime")
    except ImportError as error:
        raise ModelError(f"labels by a network need onnxruntime, which is not installed: {install('label')}") from error


def _open_session(path: Path, provider: str, *, threads: int, optimise: bool) -> Any:  # noqa: ANN401 - onnxruntime's
    runtime = _onnxruntime()
    chosen = _provider(provider)
    options = runtime.SessionOptions()
    options.log_severity_level = 4  # what goes wrong comes as an exception as well
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    if not optimise:
        options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_DISABLE_ALL
    try:
        session = runtime.InferenceSession(str(path), options, providers=[chosen])
    except Exception as error:  # onnxruntime's errors have no common base
        raise ModelError(
            f"{path} cannot be loaded by onnxruntime {runtime.__version__}: {_first_line(error)} Usual cause: a file "
            "that was not copied to the end, one with weights in a second file that is missing, or an export for a "
            "newer version of ONNX."
        ) from error
    if chosen not in session.get_providers():
        raise ConfigError(
            f"provider {provider!r} is installed but does not start; found only {', '.join(session.get_providers())}. "
            "Usual cause: no such device, or drivers and libraries (CUDA, cuDNN) of other versions than onnxruntime's."
        )
    return session


def _provider(choice: str) -> str:
    """Return the full name of a provider that runs networks on this machine."""
    names = [str(name) for name in _onnxruntime().get_available_providers()]
    short = {name.removesuffix("ExecutionProvider").lower(): name for name in names}
    short.pop("azure", None)  # it asks a remote service
    found = short.get(choice.lower().removesuffix("executionprovider"))
    if found is None:
        raise ConfigError(
            f"provider {choice!r} is not available; this onnxruntime has {', '.join(short)}. "
            "Usual cause: onnxruntime without that device: cuda comes with the package onnxruntime-gpu instead."
        )
    return found


def _first_line(error: BaseException) -> str:
    """Return the begin of an error's text, as a sentence."""
    text = " ".join(str(error).split())[:300].rstrip(".") or type(error).__name__
    return f"{text}."
