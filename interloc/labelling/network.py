"""A network run by onnxruntime."""

from __future__ import annotations

import importlib
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np

from interloc.arrays import BoolArray, Float32Array, UInt8Array
from interloc.errors import ConfigError, ModelError, install
from interloc.kernels.projection import best_classes
from interloc.labelling.graph import GraphForm, GraphInput, Tensor, output_layout

_DTYPES = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(bool)": np.bool_,
    "tensor(int64)": np.int64,
    "tensor(int32)": np.int32,
    "tensor(int16)": np.int16,
    "tensor(uint16)": np.uint16,
    "tensor(int8)": np.int8,
    "tensor(uint8)": np.uint8,
}
_SUFFIX = "ExecutionProvider"
_SCAN_LIMIT_S = 600.0  # a loop in the graph may be endless
_TYPES = {np.dtype(dtype): name for name, dtype in _DTYPES.items()}


def available_providers() -> list[str]:
    """Return what can run networks here, as `provider` takes them: ["cpu"], ["cuda", "cpu"], ...

    Raises
    ------
    ModelError
        onnxruntime is not installed.
    """
    return [name.removesuffix(_SUFFIX).lower() for name in _providers()]


def describe_graph(path: Path) -> tuple[list[Tensor], list[Tensor]]:
    """Return the inputs and the outputs of a graph.

    Raises
    ------
    ModelError
        onnxruntime is not installed or cannot load the graph.
    """
    session = _open_session(path, "cpu", threads=1, optimise=False)
    inputs = [_tensor(each) for each in session.get_inputs()]
    return inputs, [_tensor(each) for each in session.get_outputs()]


class Network:
    """A loaded network, for one process.

    Parameters
    ----------
    path
        Of the graph.
    form
        How to feed it, from `match_graph`.
    height, width, classes : int
        Of the range image, and how many classes there are.
    provider : str
        What runs it: "cpu", "cuda", ...
    threads : int
        Processor threads for one scan.

    Raises
    ------
    ConfigError
        The provider is not installed or does not start.
    ModelError
        onnxruntime is not installed or cannot load the graph.
    """

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
        """Return the class of every pixel.

        Parameters
        ----------
        image : (C, H, W) float32
            Normalised, its channels in the order of the network.
        filled : (H, W) bool
            Which pixels have a point.

        Returns
        -------
        (H, W) uint8

        Raises
        ------
        ModelError
            The network fails, or what it gives is neither scores nor classes of this image.
        """
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


def _providers() -> list[str]:
    """Return the full names of what can run networks on this machine; one of onnxruntime's asks a remote service."""
    return [str(name) for name in _onnxruntime().get_available_providers() if name != "AzureExecutionProvider"]


def _provider(choice: str) -> str:
    """Return the full name of a provider.

    Raises
    ------
    ConfigError
        It is not installed.
    """
    for name in _providers():
        if choice.lower() in {name.lower(), name.removesuffix(_SUFFIX).lower()}:
            return name
    raise ConfigError(
        f"provider {choice!r} is not available; this onnxruntime has {', '.join(available_providers())}. "
        "Usual cause: onnxruntime without that device: cuda comes with the package onnxruntime-gpu instead."
    )


def _first_line(error: BaseException) -> str:
    """Return the begin of an error's text, as a sentence."""
    text = " ".join(str(error).split())[:300].rstrip(".") or type(error).__name__
    return f"{text}."
