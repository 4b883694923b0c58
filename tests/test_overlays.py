"""The overlays of a keyframe: what they show lies where the map says, pixel for pixel."""

import io

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from interloc.arrays import FloatArray, UInt8Array
from interloc.config import DetectorConfig, preset
from interloc.drive import Drive
from interloc.drives.open import open_drive
from interloc.explain.evidence import ExplainedKeyframe, gather
from interloc.explain.figures import OVERLAYS, describe_overlays, draw_overlay
from interloc.geometry import enu_from_lonlat
from interloc.pipeline import detect
from tests.towns import town_drive

FRAME = 30


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """The beginning of the small town, as far as behind its first two junctions."""
    return open_drive(town_drive(tmp_path_factory))


@pytest.fixture(scope="module", params=["default", "paper"])
def config(request: pytest.FixtureRequest) -> DetectorConfig:
    return preset(request.param)


@pytest.fixture(scope="module")
def evidence(drive: Drive, config: DetectorConfig) -> ExplainedKeyframe:
    return gather(drive, FRAME, config)


def draw(evidence: ExplainedKeyframe, layer: str) -> UInt8Array:
    """Draw a layer and read it back: rows, columns, red green blue alpha."""
    picture = np.array(Image.open(io.BytesIO(draw_overlay(evidence, layer))).convert("RGBA"))
    assert picture.shape[0] == picture.shape[1]
    assert picture.shape[0] % evidence.roi.size == 0
    assert picture.shape[2] == 4
    return picture


def test_bev_and_occupancy_are_the_images_of_the_method(evidence: ExplainedKeyframe) -> None:
    assert np.array_equal(draw(evidence, "bev")[..., 3] > 0, evidence.steps.bev.to_array() > 0)
    shown = (evidence.steps.bev.to_array() | evidence.steps.occupancy.to_array()) > 0
    assert np.array_equal(draw(evidence, "occupancy")[..., 3] > 0, shown)


def test_the_centerline_is_drawn_on_its_own_cells(evidence: ExplainedKeyframe) -> None:
    picture = draw(evidence, "centerline")[..., 3] > 0
    scale = len(picture) // evidence.roi.size
    cells = picture.reshape(evidence.roi.size, scale, evidence.roi.size, scale).any(axis=(1, 3))
    line = evidence.steps.centerline.image.to_array() > 0
    assert cells[line].all()
    near = cv2.dilate(draw(evidence, "occupancy")[..., 3], np.ones((3, 3), np.uint8)) > 0
    assert near[cells].all()


def test_overlays_are_transparent_and_the_sheet_is_not(evidence: ExplainedKeyframe) -> None:
    for layer in OVERLAYS:
        alpha = draw(evidence, layer)[..., 3]
        assert set(np.unique(alpha)) == ({255} if layer == "all" else {0, 255})


def test_marks_lie_at_candidates_and_detections(evidence: ExplainedKeyframe) -> None:
    told = describe_overlays(evidence, "town", None)
    assert len(told["detections"]) > 0
    for layer, table in (("candidates", "candidates"), ("branches", "detections")):
        picture = draw(evidence, layer)
        (left, top), metre = told["corners_world_m"][0], len(picture) / (told["size_px"] * told["resolution_m"])
        for row in told[table]:
            column, line = (row["world_x_m"] - left) * metre, (top - row["world_y_m"]) * metre
            assert picture[int(line), int(column), 3] == 255


def test_corners_and_detections_lie_where_the_result_has_them(
    drive: Drive, config: DetectorConfig, evidence: ExplainedKeyframe
) -> None:
    told = describe_overlays(evidence, "town", drive.georeference)
    result = detect(drive, config)
    row = int(np.flatnonzero(result.keyframes.frame == evidence.keyframe.frame)[0])
    mine = result.detections.keyframe == row
    assert_allclose(
        sorted(d["lonlat"] for d in told["detections"]), sorted(result.detections.lonlat[mine].tolist()), atol=2e-9
    )
    side = told["size_px"] * told["resolution_m"]
    fix = drive.georeference.lat_deg[evidence.index], drive.georeference.lon_deg[evidence.index]
    enu = enu_from_lonlat(*fix, np.array(told["corners_lonlat"]))
    assert_allclose(np.hypot(*(np.roll(enu, -1, axis=0) - enu).T), side, atol=1e-2)  # 7 decimals of a degree
    # Clockwise from the upper left, as an image has its corners; the vehicle is in the middle, within a cell.
    assert _turns_right(enu)
    assert_allclose(enu.mean(axis=0), 0.0, atol=told["resolution_m"])
    assert_allclose(np.mean(told["corners_world_m"], axis=0), evidence.vehicle, atol=told["resolution_m"])


def _turns_right(corners: FloatArray) -> bool:
    first, second = corners[1] - corners[0], corners[2] - corners[1]
    return bool(first[0] * second[1] - first[1] * second[0] < 0)


def test_without_georeference_there_are_no_longitudes(evidence: ExplainedKeyframe) -> None:
    told = describe_overlays(evidence, "town", None)
    assert told["corners_lonlat"] is None
    assert {row["lonlat"] for row in told["candidates"] + told["detections"]} == {None}
