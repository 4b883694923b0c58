"""Scans labelled by networks whose right answer is known, in the forms of the family."""

import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

from interloc.arrays import Float32Array, UInt32Array
from interloc.errors import ConfigError, ModelError
from interloc.labelling.rangenet.labeller import Labeller, project
from interloc.labelling.rangenet.model import read_model
from tests.networks import CHANNELS, MEANS, ROAD_ID, SIDEWALK_ID, STDS, VEGETATION_ID, add_endless_loop, write_model

HEIGHT, WIDTH = 16, 128
ALL_ROWS: dict[str, Any] = {"height": HEIGHT, "width": WIDTH, "fov_up_deg": 30.0, "fov_down_deg": -60.0}


def street(seed: int = 0, count: int = 4000) -> Float32Array:
    """Flat ground 1.73 m below the sensor, and bushes on both sides."""
    generator = np.random.default_rng(seed)
    x, y = generator.uniform(-15, 15, (2, count))
    z = np.where(np.abs(y) < 7, -1.73, generator.uniform(-1.2, 1.5, count))
    return np.column_stack([x, y, z, generator.uniform(0, 1, count)]).astype(np.float32)


def truth(points: Float32Array, half_width_m: float = np.inf) -> UInt32Array:
    ground = np.where(np.abs(points[:, 1]) <= half_width_m, ROAD_ID, SIDEWALK_ID)
    return np.where(points[:, 2] < -1.5, ground, VEGETATION_ID).astype(np.uint32)


def visible(points: Float32Array) -> Float32Array:
    """Keep one point per pixel: those have the label of their pixel, whatever the post-processing."""
    index = project(points, HEIGHT, WIDTH, np.radians(30), np.radians(-60)).index
    return points[np.sort(index[index >= 0])]


FORMS: dict[str, dict[str, Any]] = {
    "logits": {},
    "arg-max": {"output": "argmax"},
    "arg-max, int32": {"output": "argmax_int32"},
    "open sizes": {"dynamic": True},
    "smaller heads": {"aux": (2, 4)},
    "smaller heads first": {"aux": (4, 2), "aux_first": True},
    "another head of the same size": {"aux": (1,)},
}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS.keys())
def test_every_form_gives_the_right_labels(tmp_path: Path, form: dict[str, Any]) -> None:
    folder = write_model(tmp_path / "model", **ALL_ROWS, knn=False, road_half_width_m=4.0, **form)
    points = visible(street())
    labels = Labeller(read_model(folder), threads=1).label(points)
    assert labels.dtype == np.uint32
    np.testing.assert_array_equal(labels, truth(points, 4.0))


def test_half_precision_is_right_away_from_borders(tmp_path: Path) -> None:
    model = read_model(write_model(tmp_path / "model", **ALL_ROWS, knn=False, half=True))
    points = visible(street())
    np.testing.assert_array_equal(Labeller(model, threads=1).label(points), truth(points))


def test_ground_behind_a_pole_is_labelled_by_its_neighbours(tmp_path: Path) -> None:
    azimuth, pitch = np.meshgrid(
        np.pi - (np.arange(WIDTH) + 0.5) / WIDTH * 2 * np.pi,
        np.radians(30 - (np.arange(8, HEIGHT) + 0.5) / HEIGHT * 90),
    )
    rays = np.stack([np.cos(azimuth) * np.cos(pitch), np.sin(azimuth) * np.cos(pitch), np.sin(pitch)], axis=-1)
    ground = (rays * (-1.73 / rays[..., 2:])).reshape(-1, 3)
    pole = (rays * 0.8)[:, WIDTH // 4]
    points = np.concatenate([ground, pole])
    points = np.column_stack([points, np.zeros(len(points))]).astype(np.float32)
    for knn in (False, True):
        model = read_model(write_model(tmp_path / str(knn), **ALL_ROWS, knn=knn))
        labels = Labeller(model, threads=1).label(points)
        assert (labels[-len(pole) :] == VEGETATION_ID).all()
        assert (labels[: -len(pole)] != ROAD_ID).sum() == (0 if knn else len(pole))


@pytest.mark.parametrize("names", [("x", "y", "z"), ("z", "remission", "range", "y", "x"), ("z", "y")])
def test_listed_channels_are_given_in_their_order(tmp_path: Path, names: tuple[str, ...]) -> None:
    def list_channels(settings: dict[str, Any]) -> None:
        sensor = settings["dataset"]["sensor"]
        sensor["channels"] = list(names)
        sensor["img_means"] = [MEANS[CHANNELS.index(name)] for name in names]
        sensor["img_stds"] = [STDS[CHANNELS.index(name)] for name in names]

    folder = write_model(
        tmp_path / "m", **ALL_ROWS, knn=False, road_half_width_m=4.0, channels=names, edit_arch=list_channels
    )
    points = visible(street())
    np.testing.assert_array_equal(Labeller(read_model(folder), threads=1).label(points), truth(points, 4.0))


def test_network_that_averages_sees_empty_pixels_as_average_ground(tmp_path: Path) -> None:
    model = read_model(write_model(tmp_path / "m", **ALL_ROWS, knn=False, smooth=True, road_below_m=-1.45))
    points = street(count=1000)
    projection = project(points, HEIGHT, WIDTH, model.fov_up_rad, model.fov_down_rad)
    heights = np.where(projection.filled, points[projection.index, 2], MEANS[3])
    edges = np.pad(heights, 1, constant_values=MEANS[3])
    average = sum(edges[dy : dy + HEIGHT, dx : dx + WIDTH] for dy in range(3) for dx in range(3)) / 9
    expected = np.where(average < -1.45, ROAD_ID, VEGETATION_ID).reshape(-1)[projection.pixel]
    np.testing.assert_array_equal(Labeller(model, threads=1).label(points), expected)


def test_points_that_are_nowhere_are_unlabelled(tmp_path: Path) -> None:
    labeller = Labeller(read_model(write_model(tmp_path / "m", **ALL_ROWS)), threads=1)
    points = street(count=50)
    points[3] = np.nan
    points[7, :3] = 0
    points[9, 3] = np.nan  # remission only
    labels = labeller.label(points)
    assert labels[[3, 7]].tolist() == [0, 0]
    assert labels[9] != 0
    assert labeller.label(points[[3, 7]]).tolist() == [0, 0]
    assert labeller.label(points[:0]).shape == (0,)
    with pytest.raises(ModelError, match=r"\(5, 3\) are no scan; expected \(N, 4\)"):
        labeller.label(np.ones((5, 3), np.float32))


def test_other_types_and_strides_of_points_give_the_same(tmp_path: Path) -> None:
    labeller = Labeller(read_model(write_model(tmp_path / "m", **ALL_ROWS)), threads=1)
    points = street()
    expected = labeller.label(points)
    np.testing.assert_array_equal(labeller.label(np.asfortranarray(points)), expected)
    np.testing.assert_array_equal(labeller.label(points.astype(np.float64)), expected)  # type: ignore[arg-type]
    readonly = points.copy()
    readonly.flags.writeable = False
    np.testing.assert_array_equal(labeller.label(readonly), expected)


def test_labeller_travels_to_other_processes_without_its_network(tmp_path: Path) -> None:
    labeller = Labeller(read_model(write_model(tmp_path / "m", **ALL_ROWS)), threads=1)
    points = street()
    expected = labeller.label(points)
    sent = pickle.dumps(labeller)
    assert len(sent) < 10_000
    there = pickle.loads(sent)  # noqa: S301 - our own
    for _ in range(2):
        np.testing.assert_array_equal(there.label(points), expected)


def test_missing_provider_names_those_there_are(tmp_path: Path) -> None:
    model = read_model(write_model(tmp_path / "m", **ALL_ROWS))
    with pytest.raises(ConfigError, match=r"'tpu' is not available; this onnxruntime has .*cpu") as caught:
        Labeller(model, provider="tpu").load()
    assert caught.value.exit_code == 2
    with pytest.raises(ConfigError, match="at least 1"):
        Labeller(model, threads=0)


@pytest.mark.parametrize("module", ["onnxruntime", "yaml"])
def test_missing_packages_are_named_with_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str
) -> None:
    folder = write_model(tmp_path / "m", **ALL_ROWS)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ModelError, match=r'pip install "onnxruntime>='):
        read_model(folder)


@pytest.mark.parametrize("bias", [np.nan, -np.inf])
def test_scores_that_are_no_numbers_are_refused(tmp_path: Path, bias: float) -> None:
    model = read_model(write_model(tmp_path / "m", **ALL_ROWS, bias=bias))
    with pytest.raises(ModelError, match=r"are not numbers.*half precision"):
        Labeller(model, threads=1).label(street())


def test_classes_that_the_settings_do_not_know_are_refused(tmp_path: Path) -> None:
    def two_classes(settings: dict[str, Any]) -> None:
        settings["learning_map_inv"] = {0: 0, 1: 40}
        del settings["learning_map"]

    model = read_model(write_model(tmp_path / "m", **ALL_ROWS, output="argmax", edit_data=two_classes))
    with pytest.raises(ModelError, match=r"gives classes from .* to 15, but learning_map_inv .* from 0 to 1"):
        Labeller(model, threads=1).label(street())


def test_a_graph_that_does_not_end_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_model(tmp_path / "m", **ALL_ROWS)
    graph = onnx.load(folder / "model.onnx")
    add_endless_loop(graph)
    onnx.save(graph, folder / "model.onnx")
    monkeypatch.setattr("interloc.labelling.rangenet.graph._SCAN_LIMIT_S", 0.2)
    with pytest.raises(ModelError, match=r"took more than 0\.2 s for a range image"):
        Labeller(read_model(folder), threads=1).label(street())


def test_a_graph_that_went_away_is_reported(tmp_path: Path) -> None:
    model = read_model(write_model(tmp_path / "m", **ALL_ROWS))
    model.graph.unlink()
    with pytest.raises(ModelError, match=r"model\.onnx cannot be loaded"):
        Labeller(model).label(street())
