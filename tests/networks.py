"""Networks whose right answer is known, written as folders of the RangeNet++ / lidar-bonnetal family.

The default network calls everything road that lies more than 1.5 m below the sensor, the rest vegetation. It computes
that from its normalised input, so a wrong normalisation, channel order or projection gives other labels.
"""

import copy
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import yaml
from onnx import TensorProto, helper, numpy_helper

from interloc.arrays import Float32Array

CHANNELS = ("range", "x", "y", "z", "remission")
MEANS = (12.12, 10.88, 0.23, -1.04, 0.21)
STDS = (12.32, 11.47, 6.91, 0.86, 0.16)

LEARNING_MAP_INV = dict(
    enumerate([0, 10, 11, 15, 18, 20, 30, 31, 32, 40, 44, 48, 49, 50, 51, 70, 71, 72, 80, 81])
)  # class of the network -> id of SemanticKITTI
CLASSES = len(LEARNING_MAP_INV)
ROAD, SIDEWALK, VEGETATION = 9, 11, 15
ROAD_ID, SIDEWALK_ID, VEGETATION_ID = (LEARNING_MAP_INV[c] for c in (ROAD, SIDEWALK, VEGETATION))

Edit = Callable[[dict[str, Any]], None]


def write_model(
    folder: Path,
    *,
    height: int = 64,
    width: int = 1024,
    fov_up_deg: float = 3.0,
    fov_down_deg: float = -25.0,
    knn: bool = True,
    search: int = 5,
    road_below_m: float = -1.5,
    road_half_width_m: float | None = None,
    edit_arch: Edit | None = None,
    edit_data: Edit | None = None,
    **graph: Any,
) -> Path:
    """Write model.onnx, arch_cfg.yaml and data_cfg.yaml; `edit_...` change the settings before they are written.

    Points lower than `road_below_m` in the frame of the sensor are road; where `road_half_width_m` is given, those
    farther than that to the left or right of the vehicle are sidewalk. `graph`: as in `road_graph`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    arch = arch_cfg(height, width, fov_up_deg, fov_down_deg, knn=knn, search=search)
    data = data_cfg()
    if edit_arch is not None:
        edit_arch(arch)
    if edit_data is not None:
        edit_data(data)
    (folder / "arch_cfg.yaml").write_text(yaml.safe_dump(arch))
    (folder / "data_cfg.yaml").write_text(yaml.safe_dump(data))
    onnx.save(road_graph(height, width, road_below_m, road_half_width_m, **graph), str(folder / "model.onnx"))
    return folder


def arch_cfg(
    height: int = 64,
    width: int = 1024,
    up_deg: float = 3.0,
    down_deg: float = -25.0,
    *,
    knn: bool = True,
    search: int = 5,
) -> dict[str, Any]:
    """Return what arch_cfg.yaml holds, as far as it matters for running a network."""
    return {
        "backbone": {"name": "darknet", "input_depth": {"range": True, "xyz": True, "remission": True}},
        "post": {
            "CRF": {"use": False, "params": False},
            "KNN": {"use": knn, "params": {"knn": 5, "search": search, "sigma": 1.0, "cutoff": 1.0}},
        },
        "dataset": {
            "labels": "kitti",
            "scans": "kitti",
            "max_points": 150000,
            "sensor": {
                "name": "HDL64",
                "type": "spherical",
                "fov_up": up_deg,
                "fov_down": down_deg,
                "img_prop": {"width": width, "height": height},
                "img_means": list(MEANS),
                "img_stds": list(STDS),
            },
        },
    }


def data_cfg() -> dict[str, Any]:
    """Return what data_cfg.yaml holds, as far as it matters for running a network."""
    learning_map = {id_: class_ for class_, id_ in LEARNING_MAP_INV.items()} | {1: 0, 60: ROAD, 252: 1}
    return {"name": "kitti", "learning_map": learning_map, "learning_map_inv": copy.copy(LEARNING_MAP_INV)}


def add_endless_loop(graph: onnx.ModelProto) -> None:
    """Put a loop that does not end before the output of a network."""
    output = graph.graph.output[0].name
    shape = [each.dim_value for each in graph.graph.output[0].type.tensor_type.shape.dim]
    for node in graph.graph.node:
        node.output[:] = ["looped" if name == output else name for name in node.output]
    goes_on = [_value(name, TensorProto.BOOL, []) for name in ("go", "go_on")]
    values = [_value(name, TensorProto.FLOAT, shape) for name in ("before", "after")]
    same = [helper.make_node("Identity", [a], [b]) for a, b in (("go", "go_on"), ("before", "after"))]
    inputs = [_value("round", TensorProto.INT64, []), goes_on[0], values[0]]
    body = helper.make_graph(same, "body", inputs, [goes_on[1], values[1]])
    graph.graph.initializer.append(numpy_helper.from_array(np.array(2**62), "rounds"))
    graph.graph.initializer.append(numpy_helper.from_array(np.array(True), "begin"))
    graph.graph.node.append(helper.make_node("Loop", ["rounds", "begin", "looped"], [output], body=body))


def road_graph(
    height: int,
    width: int,
    road_below_m: float = -1.5,
    road_half_width_m: float | None = None,
    *,
    channels: Sequence[str] = CHANNELS,
    output: str = "logits",
    dynamic: bool = False,
    aux: Sequence[int] = (),
    aux_first: bool = False,
    only_aux: int = 0,
    smooth: bool = False,
    half: bool = False,
    classes: int = CLASSES,
    bias: float = 0.0,
) -> onnx.ModelProto:
    """Build the network.

    `output`: logits, or the class itself: argmax (1, H, W), argmax_int32. `dynamic`: the graph does not say its sizes.
    `aux`: factors by which the outputs of further heads, always wrong, are smaller, `only_aux` that of the only output.
    `smooth`: the input is averaged over 3 x 3 pixels first. `half`: input and scores are float16. `bias` is added to
    all scores: `nan` makes a broken network.
    """
    sizes: dict[str, int | str] = {"N": 1, "1": 1, "C": len(channels), "K": classes, "H": height, "W": width}
    if dynamic:
        sizes |= {"N": "batch", "H": "height", "W": "width"}
    real = TensorProto.FLOAT16 if half else TensorProto.FLOAT
    inputs = [_value("scan", real, [sizes[axis] for axis in "NCHW"])]
    nodes: list[onnx.NodeProto] = []
    last = "scan"
    if half:
        nodes.append(helper.make_node("Cast", [last], ["single"], to=TensorProto.FLOAT))
        last = "single"
    constants: dict[str, Any] = {"bias": np.array(bias, np.float32)}

    if smooth:
        kernel = np.zeros((len(channels), len(channels), 3, 3), np.float32)
        kernel[range(len(channels)), range(len(channels))] = 1 / 9
        constants["average"] = kernel
        nodes.append(helper.make_node("Conv", [last, "average"], ["smooth"], pads=[1, 1, 1, 1]))
        last = "smooth"

    weights, offsets = _features(channels)
    constants |= {"w1": weights, "b1": offsets}
    constants["w2"], constants["b2"] = _scores(road_below_m, road_half_width_m, classes)
    nodes += [
        helper.make_node("Conv", [last, "w1", "b1"], ["linear"]),
        helper.make_node("Relu", ["linear"], ["features"]),
        helper.make_node("Conv", ["features", "w2", "b2"], ["raw_scores"]),
        helper.make_node("Add", ["raw_scores", "bias"], ["scores"]),
    ]
    last = "scores"

    more, outputs = _output(last, output, sizes, half=half)
    nodes += more
    others = []
    aux = (only_aux,) if only_aux else aux
    for number, factor in enumerate(aux):
        shape = [
            sizes["N"],
            classes,
            *((f"h{number}", f"w{number}") if dynamic else (height // factor, width // factor)),
        ]
        nodes += [
            helper.make_node("Neg", [last], [f"wrong{number}"]),
            helper.make_node(
                "AveragePool", [f"wrong{number}"], [f"aux{number}"], kernel_shape=[factor] * 2, strides=[factor] * 2
            ),
        ]
        others.append(_value(f"aux{number}", TensorProto.FLOAT, shape))
    initializers = [numpy_helper.from_array(array, name) for name, array in constants.items()]
    if only_aux:
        outputs = []
    found = helper.make_graph(nodes, "road", inputs, others + outputs if aux_first else outputs + others, initializers)
    model = helper.make_model(found, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    return model


def _features(channels: Sequence[str]) -> tuple[Float32Array, Float32Array]:
    """Weights (4, C, 1, 1) and offsets that give max(z, 0), max(-z, 0), max(y, 0) and max(-y, 0) in metres."""
    weights, offsets = np.zeros((4, len(channels), 1, 1), np.float32), np.zeros(4, np.float32)
    for feature, (name, sign) in enumerate([("z", 1), ("z", -1), ("y", 1), ("y", -1)]):
        if name in channels:
            weights[feature, list(channels).index(name)] = sign * STDS[CHANNELS.index(name)]
            offsets[feature] = sign * MEANS[CHANNELS.index(name)]
    return weights, offsets


def _scores(below_m: float, half_width_m: float | None, classes: int) -> tuple[Float32Array, Float32Array]:
    """Weights (K, 4, 1, 1) and offsets of the classes: road is positive where z < below_m, vegetation is zero."""
    weights, offsets = np.zeros((classes, 4, 1, 1), np.float32), np.full(classes, -1e6, np.float32)
    steep = 1000.0
    road, sidewalk, vegetation = (
        c if classes == CLASSES else rank for rank, c in enumerate((ROAD, SIDEWALK, VEGETATION))
    )
    weights[road, :2, 0, 0] = -steep, steep
    offsets[road], offsets[vegetation] = steep * below_m, 0
    if half_width_m is not None:
        weights[sidewalk, :, 0, 0] = -steep, steep, 1, 1  # road, and what |y| exceeds
        offsets[sidewalk] = steep * below_m - half_width_m
    return weights, offsets


def _output(
    last: str, form: str, sizes: dict[str, int | str], *, half: bool
) -> tuple[list[onnx.NodeProto], list[onnx.ValueInfoProto]]:
    """Return the nodes and the description of the output proper."""
    if form == "logits":
        real = TensorProto.FLOAT16 if half else TensorProto.FLOAT
        shape = [sizes[axis] for axis in "NKHW"]
        return [helper.make_node("Cast", [last], ["output"], to=real)], [_value("output", real, shape)]
    kind = TensorProto.INT32 if form == "argmax_int32" else TensorProto.INT64
    nodes = [
        helper.make_node("ArgMax", [last], ["best"], axis=1, keepdims=0),
        helper.make_node("Cast", ["best"], ["classes"], to=kind),
    ]
    return nodes, [_value("classes", kind, [sizes[axis] for axis in "NHW"])]


def _value(name: str, kind: int, shape: Sequence[int | str]) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, kind, list(shape))
