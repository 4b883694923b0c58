"""Models: what is read from their files, what is refused, in words, and what of the packages is asked for."""

import math
import os
import pickle
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from numpy.typing import ArrayLike

from interloc.errors import ModelError
from interloc.labelling import ModelDescription, networks
from interloc.labelling.networks import describe_networks, remission_scale
from interloc.labelling.rangenet.model import KnnSettings, read_model
from tests.networks import LEARNING_MAP_INV, write_model

SMALL: dict[str, Any] = {"height": 16, "width": 128}


def changed(path: str, value: Any) -> Any:
    """Return an edit that sets a field such as post.KNN.use; None takes it away."""

    def edit(settings: dict[str, Any]) -> None:
        *parents, last = path.split(".")
        for name in parents:
            settings = settings[name]
        if value is None:
            del settings[last]
        else:
            settings[last] = value

    return edit


def refusal(folder: Path) -> str:
    with pytest.raises(ModelError) as caught:
        read_model(folder)
    assert (caught.value.exit_code, caught.value.http_status) == (1, 422)
    return str(caught.value)


def test_published_settings_are_understood(tmp_path: Path) -> None:
    model = read_model(write_model(tmp_path / "darknet53", **SMALL, search=7))
    assert model.name == "darknet53"
    assert (model.height, model.width) == (16, 128)
    assert math.degrees(model.fov_up_rad) == pytest.approx(3)
    assert math.degrees(model.fov_down_rad) == pytest.approx(25)
    assert model.channels == ("range", "x", "y", "z", "remission")
    assert model.means == (12.12, 10.88, 0.23, -1.04, 0.21)
    assert model.stds == (12.32, 11.47, 6.91, 0.86, 0.16)
    assert model.class_ids == tuple(LEARNING_MAP_INV.values())
    assert model.knn == KnnSettings(neighbours=5, search=7, sigma=1.0, cutoff=1.0)
    assert model.first_class == 1
    assert pickle.loads(pickle.dumps(model)) == model  # noqa: S301 - our own
    assert model.form.notes == ()


def test_without_knn_there_is_no_post_processing(tmp_path: Path) -> None:
    assert read_model(write_model(tmp_path / "none", **SMALL, edit_arch=changed("post", None))).knn is None


def test_class_0_votes_only_where_it_is_not_ignored(tmp_path: Path) -> None:
    for ignored, first in ((True, 1), (False, 0)):
        edit = changed("learning_ignore", {0: ignored, 1: False})
        assert read_model(write_model(tmp_path / str(ignored), **SMALL, edit_data=edit)).first_class == first


def test_use_of_one_of_several_outputs_is_told(tmp_path: Path) -> None:
    model = read_model(write_model(tmp_path / "m", **SMALL, aux=(2, 4), aux_first=True))
    assert model.form.outputs == ("output",)
    assert "several outputs; 'output'" in model.form.notes[0]
    assert "'aux1' tensor(float) (1, 20, 4, 32)" in model.form.notes[0]


def test_numbers_may_be_written_as_yaml_reads_words(tmp_path: Path) -> None:
    folder = write_model(tmp_path / "m", **SMALL, edit_arch=changed("post.KNN.params.cutoff", "5e-1"))
    knn = read_model(folder).knn
    assert knn.cutoff == 0.5


SENSOR = "dataset.sensor"


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        (f"{SENSOR}.fov_up", None, "is missing; expected a number from -90 to 90"),
        (f"{SENSOR}.fov_up", "three", "found 'three'; expected a number"),
        (f"{SENSOR}.fov_down", -250, "found -250"),
        (f"{SENSOR}.fov_down", True, "found True"),
        (f"{SENSOR}.img_prop.width", 10**9, "expected a whole number from 1 to 16,384"),
        (f"{SENSOR}.img_prop.width", 10**1000, "a number of many digits"),
        (f"{SENSOR}.img_prop.height", 16.5, "found 16.5"),
        (f"{SENSOR}.img_prop", {"height": 1024, "width": 16384}, "more than the 4,194,304"),
        (f"{SENSOR}.img_prop", "big", "img_prop.height: is missing"),
        (f"{SENSOR}.img_means", [1, 2, 3], "found 3 numbers; expected one per channel: range, x, y, z, remission"),
        (f"{SENSOR}.img_means", 5, "expected a list of numbers"),
        (f"{SENSOR}.img_means", [1, 2, 3, 4, float("inf")], "img_means[4]: found inf"),
        (f"{SENSOR}.img_stds", [1, 1, 1, 0, 1], "img_stds[3]: found 0"),
        (f"{SENSOR}.channels", ["x", "height"], "found x, height; expected some of range, x, y, z, remission"),
        (f"{SENSOR}.channels", ["x", "x"], "each once"),
        (f"{SENSOR}.channels", [1, 2], "channels[0]: found 1; expected a word"),
        (f"{SENSOR}.channels", ["x", "y", "z"], "dataset.sensor.channels (x, y, z)"),
        ("post.KNN.use", "yes please", "found 'yes please'; expected true or false"),
        ("post.KNN.params.search", 4, "found 4; expected an odd number"),
        ("post.KNN.params.knn", 26, "expected a whole number from 1 to 25"),
        ("post.KNN.params.sigma", 0, "found 0"),
        ("post.KNN.params", False, "search: is missing"),
    ],
)
def test_wrong_field_of_the_sensor_is_named(tmp_path: Path, field: str, value: Any, words: str) -> None:
    folder = write_model(tmp_path / "m", **SMALL, edit_arch=changed(field, value))
    message = refusal(folder)
    assert words in message
    assert "arch_cfg.yaml" in message
    assert field in message


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (None, "learning_map_inv: is missing"),
        ([0, 10], "expected a table of ids"),
        ({0: 0, 2: 10}, "class 1 is missing; expected an id for every class from 0 to 2"),
        ({0: 0, 1: 70000}, "learning_map_inv[1]: found 70000; expected a whole number from 0 to 65,535"),
        ({0: 0, 300: 1}, "a key: found 300"),
        ({0: 0, "road": 40}, "a key: found 'road'"),
    ],
)
def test_wrong_table_of_classes_is_named(tmp_path: Path, table: Any, words: str) -> None:
    def edit(settings: dict[str, Any]) -> None:
        del settings["learning_map"]
        changed("learning_map_inv", table)(settings)

    message = refusal(write_model(tmp_path / "m", **SMALL, edit_data=edit))
    assert words in message
    assert "data_cfg.yaml" in message


def test_tables_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    edit = changed("learning_map_inv", LEARNING_MAP_INV | {9: 48, 11: 40})
    message = refusal(write_model(tmp_path / "m", **SMALL, edit_data=edit))
    assert "gives class 9 the id 48, but learning_map gives id 48 the class 11" in message


@pytest.mark.parametrize(
    ("graph", "edit", "words"),
    [
        ({}, changed(f"{SENSOR}.img_prop.width", 64), "takes 'scan' tensor(float) (1, 5, 16, 128); expected one image"),
        ({}, changed(f"{SENSOR}.img_prop.height", 64), "dataset.sensor.img_prop (height 64, width 128)"),
        ({"channels": ("x", "y", "z")}, None, "dataset.sensor.channels (range, x, y, z, remission)"),
        ({"classes": 19}, None, "gives 'output' tensor(float) (1, 19, 16, 128); expected scores (1, 20, 16, 128)"),
    ],
)
def test_graph_that_does_not_fit_is_refused(tmp_path: Path, graph: dict[str, Any], edit: Any, words: str) -> None:
    assert words in refusal(write_model(tmp_path / "m", **SMALL, edit_arch=edit, **graph))


def test_output_of_another_size_is_refused(tmp_path: Path) -> None:
    folder = write_model(tmp_path / "m", **SMALL, dynamic=True)
    other = write_model(tmp_path / "other", **SMALL, only_aux=4)
    (folder / "model.onnx").write_bytes((other / "model.onnx").read_bytes())
    message = refusal(folder)
    assert "gives 'aux0' tensor(float) (1, 20, 4, 32); expected scores (1, 20, 16, 128)" in message


def test_folders_that_are_no_models_are_refused(tmp_path: Path) -> None:
    assert "is not a folder" in refusal(tmp_path / "nowhere")
    (tmp_path / "weights").mkdir()
    assert "not exported to ONNX" in refusal(tmp_path / "weights")
    (tmp_path / "weights" / "SalsaNext.onnx").touch()
    assert "It holds SalsaNext.onnx: rename" in refusal(tmp_path / "weights")
    (tmp_path / "weights" / "model.onnx").touch()
    assert "has 0 bytes" in refusal(tmp_path / "weights")
    (tmp_path / "weights" / "model.onnx").write_bytes(b"\x08")
    assert "arch_cfg.yaml is missing" in refusal(tmp_path / "weights")


def test_damaged_graph_is_refused(tmp_path: Path) -> None:
    folder = write_model(tmp_path / "m", **SMALL)
    whole = (folder / "model.onnx").read_bytes()
    for content in (whole[: len(whole) // 2], b"not a network", bytes(1000)):
        (folder / "model.onnx").write_bytes(content)
        assert "cannot be loaded by onnxruntime" in refusal(folder)


def test_weights_outside_of_the_folder_are_not_read(tmp_path: Path) -> None:
    folder = write_model(tmp_path / "m", **SMALL)
    other = tmp_path / "secret"
    other.write_bytes(bytes(1 << 16))
    (folder / "model.onnx.data").symlink_to(other)
    for place in ("../secret", str(other), "model.onnx.data"):
        graph = onnx.load(write_model(folder, **SMALL) / "model.onnx")
        weights = graph.graph.initializer[0]
        size = len(onnx.numpy_helper.to_array(weights).tobytes())
        onnx.external_data_helper.set_external_data(weights, place, length=size)
        weights.ClearField("raw_data")
        weights.ClearField("float_data")
        (folder / "model.onnx").write_bytes(graph.SerializeToString())
        assert "xternal data path" in refusal(folder)


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{b}: &{b} [*{a},*{a},*{a},*{a},*{a},*{a},*{a},*{a},*{a}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize("name", ["arch_cfg.yaml", "data_cfg.yaml"])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (BOMB.encode(), "uses aliases"),
        (b"a: " + b"[" * 20000, "nested more than 20 deep"),
        (b"a: " + b"[" * 300 + b"]" * 300, "nested more than 20 deep"),
        (b"- " * 30000, "nested more than 20 deep"),
        (b"x" * 100_000, "larger than 64 KB"),
        (b"a: 'unfinished", "not YAML"),
        (b"\xff\xfe\x00\x00\xff", "not YAML"),
        (b"\x00\x01", "not YAML"),
        (b"- 1\n- 2\n", "expected a table of settings (name: value); found [1, 2]"),
        (b"", "expected a table of settings"),
        (b"a: !!python/object/apply:os.system ['touch /tmp/hacked']", "not YAML"),
        (b"a: 2026-99-99", "not YAML"),
        (b"a: 1" + b"0" * 5000, "not YAML"),
        (b"? [1, 2]\n: 3", "not YAML"),
    ],
    ids=range(14),
)
def test_hostile_settings_are_refused_quickly(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    folder = write_model(tmp_path / "m", **SMALL)
    (folder / name).write_bytes(content)
    began = time.monotonic()
    message = refusal(folder)
    assert words in message
    assert name in message
    assert len(message) < 1000
    assert time.monotonic() - began < 20  # seconds; takes hours where bounds are missing


def test_pipes_are_not_waited_for(tmp_path: Path) -> None:
    folder = write_model(tmp_path / "m", **SMALL)
    (folder / "arch_cfg.yaml").unlink()
    os.mkfifo(folder / "arch_cfg.yaml")
    assert "pipe or device" in refusal(folder)


def test_models_of_a_folder_are_listed_with_those_that_are_broken(tmp_path: Path) -> None:
    good = write_model(tmp_path / "b-good", **SMALL)
    write_model(tmp_path / "a-broken", **SMALL, edit_arch=changed(f"{SENSOR}.fov_up", None))
    (tmp_path / "c-empty").mkdir()
    (tmp_path / "d-half").mkdir()
    (tmp_path / "d-half" / "data_cfg.yaml").touch()
    (tmp_path / "notes.txt").touch()
    (tmp_path / ".hidden").mkdir()
    broken, listed, half = describe_networks(tmp_path)
    assert listed == ModelDescription(
        name="b-good",
        bytes=(good / "model.onnx").stat().st_size,
        height=16,
        width=128,
        classes=20,
        identity=read_model(good).identity,
    )
    assert (broken.name, half.name) == ("a-broken", "d-half")
    assert "fov_up: is missing" in (broken.problem or "")
    assert "model.onnx is missing" in (half.problem or "")
    with pytest.raises(ModelError, match="cannot be read: no such file"):
        describe_networks(tmp_path / "nowhere")


def test_identity_is_that_of_the_content(tmp_path: Path) -> None:
    first, again = write_model(tmp_path / "1", **SMALL), write_model(tmp_path / "2", **SMALL)
    other = write_model(tmp_path / "3", **SMALL, road_below_m=-1.6)
    settings = write_model(tmp_path / "4", **SMALL, search=7)
    identities = [read_model(folder).identity for folder in (first, again, other, settings)]
    assert identities[0] == identities[1]
    assert len(set(identities)) == 3


ROOT = Path(__file__).parents[2]
EXAMPLE = re.compile(r"^## A network of your own$.*?^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.fixture(params=["all_road_network", "nowhere"])
def package(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Install the package of docs/library.md, or one that is damaged."""
    found = EXAMPLE.search((ROOT / "docs/library.md").read_text())
    (tmp_path / "all_road_network.py").write_text(found[1])
    about = tmp_path / "all_road-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: all_road\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[interloc.networks]\nall_road = {request.param}\n")
    monkeypatch.syspath_prepend(tmp_path)
    networks._installed_kinds.cache_clear()
    yield request.param
    networks._installed_kinds.cache_clear()


def test_a_network_of_another_package(package: str, tmp_path: Path) -> None:
    models = tmp_path / "models"
    for name in ("ours", "theirs", "none"):
        (models / name).mkdir(parents=True)
    (models / "theirs/all_road.txt").touch()
    (models / "ours/arch_cfg.yaml").touch()
    if package == "nowhere":
        with pytest.raises(ModelError, match="networks of the kind all_road: nowhere cannot be loaded"):
            networks.open_network(models / "theirs")
        return
    ours, theirs = networks.describe_networks(models)
    assert "model.onnx is missing" in str(ours.problem)
    assert (theirs.name, theirs.problem) == ("theirs", None)
    assert networks.open_network(models / "theirs").label(np.zeros((3, 4), np.float32)).tolist() == [40] * 3
    with pytest.raises(ModelError, match=r"model\.onnx is missing"):
        networks.open_network(models / "none")


SPREAD = np.random.default_rng(0).uniform(0, 1, 5000)


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        *((highest * SPREAD, 1.0) for highest in (0.3, 1.0, 1.2)),
        *((highest * SPREAD, 255.0) for highest in (20.0, 255.0)),
        (3000.0 * SPREAD, 65535.0),
        (np.concatenate([[1e9, np.nan, np.inf], np.full(5000, 0.3)]), 1.0),  # single wrong values do not matter
        *((none, 1.0) for none in ([], [0.0, 0.0], [np.nan])),
        (np.arange(256, dtype=np.uint8), 255.0),
        (np.arange(0, 60000, 10, dtype=np.uint16), 65535.0),
    ],
)
def test_smallest_scale_that_holds_the_values(values: ArrayLike, scale: float) -> None:
    assert remission_scale(values) == scale  # type: ignore[arg-type]
