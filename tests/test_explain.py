"""The step pictures of one keyframe: a straight road along x, another across it at x = 40 m."""

import io
import json
import logging
import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from interloc.arrays import BoolArray, FloatArray, IntArray, UInt8Array
from interloc.config import PRESETS, DetectorConfig, preset, with_settings
from interloc.drive import Drive, Georeference, GroundPoints
from interloc.drives.open import open_drive
from interloc.errors import ConfigError
from interloc.explain import explain
from interloc.explain.evidence import ExplainedKeyframe, gather
from interloc.explain.figures import OVERLAYS, describe_overlays, draw_overlay
from interloc.geometry import enu_from_lonlat, lonlat_from_enu, rotate_2d
from interloc.osm.graph import RoadGraph
from interloc.pipeline import detect
from tests.localization.town import LAT_DEG, LON_DEG, graph_of
from tests.small_drives import level_poses
from tests.towns import town_drive

CROSSING = np.array([40.0, 0.0])
STEP_M = 2.5
NORTH_TURN_RAD = 0.3  # how W lies to the east


@dataclass(frozen=True)
class RoadDrive:
    """Points of two roads, 10 m wide, seen from a vehicle that drives along the first one; every other scan number."""

    scans: int = 30
    crossing: bool = True
    georeference: Georeference | None = None
    name: str = "a drive worth $5 or $10"

    @property
    def frames(self) -> IntArray:
        return 100 + 2 * np.arange(self.scans)

    @property
    def T_world_lidar(self) -> FloatArray:
        return level_poses(STEP_M * np.arange(self.scans))

    @property
    def times_s(self) -> None:
        return None

    def ground_points(self, index: int) -> GroundPoints:
        return points_of(index, crossing=self.crossing)


@cache
def points_of(index: int, *, crossing: bool) -> GroundPoints:
    """Return what a scan of a `RoadDrive` sees; nobody changes it."""
    random = np.random.default_rng(index)
    xy = random.uniform(-45.0, 45.0, (60_000, 2))
    xy[:, 0] += STEP_M * index
    is_road = np.abs(xy[:, 1]) < 5.0
    if crossing:
        is_road |= np.abs(xy[:, 0] - CROSSING[0]) < 5.0
    near = is_road | (np.abs(xy[:, 1]) < 7.0)
    xyz = np.column_stack([xy[:, 0] - STEP_M * index, xy[:, 1], np.full(len(xy), -1.7)]).astype(np.float32)
    return GroundPoints.split(xyz[near], is_road[near])


def small(preset: str = "default") -> DetectorConfig:
    return with_settings(PRESETS[preset], ["keyframes.window=6", "bev.min_points=1"])


def georeferenced(drive: RoadDrive) -> RoadDrive:
    lonlat = lonlat_from_enu(LAT_DEG, LON_DEG, rotate_2d(drive.T_world_lidar[:, :2, 3], NORTH_TURN_RAD))
    c, s = math.cos(NORTH_TURN_RAD), math.sin(NORTH_TURN_RAD)
    attitude = np.tile(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), (drive.scans, 1, 1))
    fixes = Georeference(lonlat[:, 1], lonlat[:, 0], np.zeros(drive.scans), attitude, "made up")
    return RoadDrive(drive.scans, drive.crossing, fixes)


def two_roads() -> RoadGraph:
    ends = np.array([CROSSING, [-200.0, 0.0], [200.0, 0.0], [40.0, -200.0], [40.0, 200.0], [40.0, 1000.0]])
    return graph_of(rotate_2d(ends, NORTH_TURN_RAD), [(0, 1), (0, 2), (0, 3), (0, 4), (4, 5)])


@pytest.fixture(scope="module")
def explained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    out = tmp_path_factory.mktemp("explain") / "steps"
    files = explain(georeferenced(RoadDrive()), 125, small(), out, graph=two_roads())
    return out, files


@pytest.fixture(scope="module")
def seen() -> dict[str, ExplainedKeyframe]:
    return {name: gather(RoadDrive(), 124, small(name)) for name in PRESETS}


def test_all_steps_are_on_one_sheet(explained: tuple[Path, list[Path]]) -> None:
    out, files = explained
    assert files == [out / "overview.png", out / "explain.json"]
    assert sorted(out.iterdir()) == sorted(files)
    picture = cv2.imread(str(files[0]))
    assert picture.shape == (942, 1680, 3)
    for row in (84, 526):  # a panel is so many pixels wide and high
        for column in (16, 432, 848):
            assert 0.01 < (picture[row : row + 400, column : column + 400] < 250).any(axis=2).mean() < 0.5


def test_a_cell_of_the_bev_image_is_seen_on_the_sheet(
    explained: tuple[Path, list[Path]], seen: dict[str, ExplainedKeyframe]
) -> None:
    picture = cv2.imread(str(explained[1][0]), cv2.IMREAD_GRAYSCALE)[84 : 84 + 400, 848 : 848 + 400]
    cells = along_world(seen["default"], seen["default"].steps.bev.to_array()).astype(np.uint8) * 255
    cells = cv2.resize(cells, (400, 400), interpolation=cv2.INTER_AREA)
    inner = np.s_[10:160, 10:160]  # beside the vehicle and the frame
    assert ((cells[inner] > 128) != (picture[inner] < 128)).mean() < 0.05  # the roads of the map are drawn on top


def test_the_record_tells_what_was_done(explained: tuple[Path, list[Path]]) -> None:
    told = json.loads((explained[0] / "explain.json").read_text())
    assert (told["frame_asked"], told["frame"], told["keyframe"]) == (125, 124, 12)
    assert told["keyframes_in_drive"] == 30
    assert told["window"]["frames"] == list(range(112, 137, 2))
    assert told["min_points"] == 1
    assert told["cells"]["bev"] > told["cells"]["centerline"] > 0
    (candidate,) = [c for c in told["candidates"] if c["kept"]]
    assert candidate["branches"] == 4
    assert candidate["why_not"] is None
    (detection,) = told["detections"]
    assert detection["candidate"] == candidate["number"]
    assert math.dist((detection["world_x_m"], detection["world_y_m"]), CROSSING) < 0.5
    assert detection["x_m"] == pytest.approx(detection["world_x_m"] - 12 * STEP_M)  # the vehicle looks along x
    assert sorted(round(angle / 90) % 4 for angle in detection["branch_angles_deg"]) == [0, 1, 2, 3]


def test_the_map_is_laid_over_the_pictures_by_the_fix_of_the_keyframe(explained: tuple[Path, list[Path]]) -> None:
    truth = json.loads((explained[0] / "explain.json").read_text())["ground_truth"]
    (node,) = truth["nodes"]
    assert (truth["policy"], node["osm_id"]) == ("drive", "1")
    assert math.dist((node["world_x_m"], node["world_y_m"]), CROSSING) < 0.01


@pytest.mark.parametrize("preset", list(PRESETS))
def test_every_detection_belongs_to_one_candidate(seen: dict[str, ExplainedKeyframe], preset: str) -> None:
    evidence = seen[preset]
    shown = sorted(i for verdict in evidence.candidates for i in verdict.detections)
    assert shown == list(range(len(evidence.steps.junctions)))
    assert len(shown) >= 1
    for verdict in evidence.candidates:
        assert verdict.is_kept == (verdict.why_not is None)
        assert verdict.merged.mean(axis=0) == pytest.approx(verdict.position)


def test_a_rejected_candidate_says_why() -> None:
    config = with_settings(small(), ["branches.min_branches=5", "branches.min_reach_m=200", "branches.margin_m=0"])
    verdict = gather(RoadDrive(), 124, config).candidates[0]
    assert verdict.why_not.startswith("0 branches, 5 needed; 4 too short (")
    assert verdict.why_not.endswith(" of 200 m)")


def test_a_candidate_at_the_border_says_so() -> None:
    config = with_settings(small(), ["branches.margin_m=25", "bev.turn=false"])
    found = gather(RoadDrive(), 100, config).candidates
    (verdict,) = [v for v in found if sum(piece.is_branch for piece in v.pieces) >= 3]
    distance, _, rest = verdict.why_not.partition(" m ")
    assert float(distance) == pytest.approx(60.0 - CROSSING[0], abs=1.0)
    assert rest == "from the border, 25 m needed"


def test_the_end_of_the_drive_cuts_the_window_short() -> None:
    evidence = gather(RoadDrive(), 158, small())
    assert evidence.keyframe.frame == 158
    assert [scan.age for scan in evidence.window] == list(range(-6, 1))


@pytest.mark.parametrize("frame", [99, 159, -1])
def test_a_scan_that_the_drive_does_not_have_is_refused(tmp_path: Path, frame: int) -> None:
    with pytest.raises(ConfigError, match="scans 100 to 158"):
        explain(RoadDrive(), frame, small(), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_road_without_intersection_or_georeference_has_all_pictures_in_the_place_of_earlier_ones(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "out").mkdir()
    for name in ("explain.json", "overview.png"):
        (tmp_path / "out" / name).write_text("{}")
    with caplog.at_level(logging.WARNING):
        files = explain(RoadDrive(8, crossing=False), 106, small("paper"), str(tmp_path / "out"), graph=two_roads())
    assert "without georeference" in caplog.text
    assert all(path.stat().st_size > 100 for path in files)
    told = json.loads((tmp_path / "out" / "explain.json").read_text())
    assert (told["frame"], told["ground_truth"], told["detections"]) == (106, None, [])
    assert all(candidate["why_not"] for candidate in told["candidates"])


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


def along_world(evidence: ExplainedKeyframe, image: UInt8Array) -> BoolArray:
    """Return an image of the method, which may be turned, along the axes of W."""
    pixel = np.mgrid[: len(image), : len(image)].astype(np.float64)
    cells = np.rint(evidence.roi.image(replace(evidence.roi, turn_rad=0.0).world(*pixel))).astype(int)
    return np.pad(image, 1)[tuple(np.moveaxis(np.clip(cells, -1, len(image)) + 1, -1, 0))] > 0


def test_bev_and_occupancy_are_the_images_of_the_method(evidence: ExplainedKeyframe) -> None:
    assert bool(evidence.roi.turn_rad) == (evidence.config.preset == "default")
    bev, occupancy = evidence.steps.bev.to_array(), evidence.steps.occupancy.to_array()
    assert np.array_equal(draw(evidence, "bev")[..., 3] > 0, along_world(evidence, bev))
    assert np.array_equal(draw(evidence, "occupancy")[..., 3] > 0, along_world(evidence, bev | occupancy))


def test_the_centerline_is_drawn_on_its_own_cells(evidence: ExplainedKeyframe) -> None:
    picture = draw(evidence, "centerline")[..., 3] > 0
    scale = len(picture) // evidence.roi.size
    cells = picture.reshape(evidence.roi.size, scale, evidence.roi.size, scale).any(axis=(1, 3))
    line = along_world(evidence, evidence.steps.centerline.image.to_array())
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
