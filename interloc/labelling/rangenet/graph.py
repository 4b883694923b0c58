"""What a network's graph takes and gives, held against the settings beside it; and the network run by onnxruntime."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np

from interloc.arrays import Float32Array, UInt8Array
from interloc.errors import ConfigError, ModelError, install
from interloc.kernels.projection import best_classes

REAL_TYPES = ("tensor(float)", "tensor(float16)")
WHOLE_TYPES = ("tensor(int64)", "tensor(int32)", "tensor(uint8)", "tensor(int8)", "tensor(int16)", "tensor(uint16)")


@dataclass(frozen=True)
class Tensor:
    """An input or an output, with its type as onnxruntime calls it; axes that the graph leaves open have size None."""

    name: str
    type: str
    shape: tuple[int | None, ...]

    def __str__(self) -> str:
        sizes = ", ".join("?" if size is None else str(size) for size in self.shape)
        return f"{self.name!r} {self.type} ({sizes})"

    def fits(self, *sizes: int) -> bool:
        """Return whether it has, or may have, these sizes."""
        return len(self.shape) == len(sizes) and all(a in {None, b} for a, b in zip(self.shape, sizes, strict=True))


@dataclass(frozen=True)
class GraphForm:
    """How to run a network, and what was assumed of it."""

    image: str
    """Name of the input."""
    is_half: bool
    """Whether it takes float16."""
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
    channels: tuple[str, ...]
    """Of the input, in its order."""

    def is_answer(self, tensor: Tensor) -> bool:
        """Return whether a tensor gives scores (real) or classes (whole numbers) of all pixels."""
        if tensor.type in REAL_TYPES:
            return tensor.fits(1, self.classes, self.height, self.width)
        return tensor.type in WHOLE_TYPES and tensor.fits(1, self.height, self.width)


def match_graph(inputs: Sequence[Tensor], outputs: Sequence[Tensor], expected: Expected) -> GraphForm:
    """Find out how to feed a graph and which of its outputs to take."""
    height, width, classes, channels = expected.height, expected.width, expected.classes, expected.channels
    image = inputs[0] if len(inputs) == 1 else None
    if image is None or image.type not in REAL_TYPES or not image.fits(1, len(channels), height, width):
        raise ModelError(
            f"{expected.graph} takes {', '.join(map(str, inputs)) or 'nothing'}; expected one image of float or "
            f"float16, (1, {len(channels)}, {height}, {width}), by {expected.arch}: dataset.sensor.img_prop (height "
            f"{height}, width {width}), dataset.sensor.channels ({', '.join(channels)}). Usual cause: arch_cfg.yaml of "
            "another model; fewer or other channels, which are listed there in the order of the network; a network "
            "that works on points or wants a mask; or an export that is quantised, for several scans at once, or with "
            "another order of axes."
        )
    fitting = [tensor for tensor in outputs if expected.is_answer(tensor)]
    if not fitting:
        raise ModelError(
            f"{expected.graph} gives {', '.join(map(str, outputs)) or 'nothing'}; expected scores (1, {classes}, "
            f"{height}, {width}), or classes (1, {height}, {width}) as whole numbers, by the {classes} classes of "
            f"{expected.data}: learning_map_inv. Usual cause: settings of another model, a network without a class 0 "
            "for points without a class, or an export of a part of it, or with another order of axes."
        )
    notes = []
    if len(outputs) > 1:
        others = ", ".join(str(tensor) for tensor in outputs if tensor != fitting[0])
        notes.append(f"the network has several outputs; {fitting[0]} is used, not {others}.")
    is_half = image.type == "tensor(float16)"
    return GraphForm(image.name, is_half, tuple(tensor.name for tensor in fitting), tuple(notes))


# The network


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
        self._height, self._width, self._classes = height, width, classes
        self._session = _open_session(path, provider, threads=threads, optimise=True)
        self._outputs = list(form.outputs)

    def run(self, image: Float32Array) -> UInt8Array:
        """Return the (H, W) classes of a normalised (C, H, W) image."""
        feed = {self._form.image: np.ascontiguousarray(image[None], np.float16 if self._form.is_half else np.float32)}
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
        size = (self._height, self._width)
        for name, output in zip(outputs, found, strict=True):
            is_real = output.dtype.kind == "f"
            if output.shape == ((1, self._classes, *size) if is_real else (1, *size)):
                self._outputs = [name]  # the others need not be fetched again
                return self._best_of(output) if is_real else self._classes_of(output)
        shapes = ", ".join(f"{name!r} {array.shape}" for name, array in zip(outputs, found, strict=True))
        raise ModelError(
            f"{self._path} gives {shapes} for an image of {self._height} x {self._width} pixels; expected "
            f"{self._classes} scores or one class per pixel. Usual cause: an export that lacks the last layers."
        )

    def _classes_of(self, output: Any) -> UInt8Array:  # noqa: ANN401 - any type of number
        lowest, highest = int(output.min()), int(output.max())
        if lowest < 0 or highest >= self._classes:
            raise ModelError(
                f"{self._path} gives classes from {lowest} to {highest}, but learning_map_inv of data_cfg.yaml has "
                f"those from 0 to {self._classes - 1}. Usual cause: data_cfg.yaml of another model, or a network "
                "that gives ids instead of classes."
            )
        classes: UInt8Array = output[0].astype(np.uint8)
        return classes

    def _best_of(self, output: Any) -> UInt8Array:  # noqa: ANN401 - of half or single precision
        scores = output.reshape(self._classes, -1)
        best, bad = best_classes(np.ascontiguousarray(scores, dtype=np.float32))
        if bad:
            raise ModelError(
                f"{self._path}: {bad:,} scores of a range image are not numbers. Usual cause: an export in half "
                "precision that overflows; export it in single precision, and compare the labels of both."
            )
        return best.reshape(self._height, self._width)


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
