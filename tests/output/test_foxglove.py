"""A recording for Foxglove, read back by the reader of MCAP with the schemas that the file holds."""

import json
from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_allclose

from interloc.output.foxglove import write_mcap
from tests.output.small import small_result, with_roads, write_folder

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
reader = pytest.importorskip("mcap.reader", reason="mcap is not installed")
descriptor_pb2, descriptor_pool, message_factory = (
    pytest.importorskip(f"google.protobuf.{each}", reason="protobuf is not installed")
    for each in ("descriptor_pb2", "descriptor_pool", "message_factory")
)


def read_back(path: Path) -> dict[str, list[tuple[str, int, Any]]]:
    """By topic: schema, time and message, decoded by nothing but the file itself."""
    found: dict[str, list[tuple[str, int, Any]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in reader.make_reader(file, validate_crcs=True).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            pool = descriptor_pool.DescriptorPool()
            for each in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                pool.Add(each)
            kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            decoded = kind.FromString(message.data)
            found.setdefault(channel.topic, []).append((schema.name, message.log_time, decoded))
    return found


def test_a_result_is_a_recording(tmp_path: Path) -> None:
    result = with_roads(small_result())
    folder = write_folder(tmp_path / "out", result, scored=False)
    topics = write_mcap(folder, tmp_path / "out.mcap")
    found = read_back(tmp_path / "out.mcap")
    assert sorted(found) == sorted(topics)
    kinds = {topic: messages[0][0] for topic, messages in found.items()}
    assert kinds == {
        "/interloc/intersections": "foxglove.GeoJSON",
        "/interloc/roads": "foxglove.GeoJSON",
        "/interloc/trajectory": "foxglove.GeoJSON",
        "/interloc/fix": "foxglove.LocationFix",
        "/interloc/scene": "foxglove.SceneUpdate",
    }
    ((_, _, geojson),) = found["/interloc/intersections"]
    assert json.loads(geojson.geojson) == json.loads((folder / "intersections.geojson").read_text())
    assert result.keyframes.lonlat is not None
    fixes = [(each.longitude, each.latitude) for _, _, each in found["/interloc/fix"]]
    assert_allclose(fixes, result.keyframes.lonlat, atol=1e-8)
    ((_, _, scene),) = found["/interloc/scene"]
    assert [each.id for each in scene.entities][:2] == ["track", "intersection 1"]
    assert len(scene.entities[1].lines) == len(result.intersections.bearings_deg[0])
    assert all(each.frame_id == "map" for each in scene.entities)


def test_metres_have_no_place_on_the_map(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "out", small_result(local=True), scored=False)
    assert write_mcap(folder, tmp_path / "out.mcap") == ["/interloc/scene"]
    assert list(read_back(tmp_path / "out.mcap")) == ["/interloc/scene"]
