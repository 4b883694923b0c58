"""Each layer of the map, counted at the canvas: as many lines and signs as the files have features, where they lie."""

import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from interloc.geometry import lonlat_from_enu
from tests.app.street import LAT_DEG, LON_DEG
from tests.page.browsers import Browser, needs_page
from tests.page.canvas import NOTE_PATHS, Part, painted, pixels_per_metre, screen_of
from tests.page.canvas import Path as Painted
from tests.page.results import SCANS, Done, Scored, address_of, show, visit

pytestmark = needs_page

WIDE = {"width": 3000, "height": 480}  # the whole street at a scale at which its features lie apart
NEAR_PX = 1.5


@dataclass(frozen=True)
class Sheet:
    """The map with some layers on."""

    page: Any
    paths: list[Painted]

    @property
    def parts(self) -> list[Part]:
        return [part for path in self.paths for part in path.parts]

    def screen(self, features: list[dict[str, Any]]) -> np.ndarray:
        return screen_of(self.page, [feature["geometry"]["coordinates"] for feature in features])


@pytest.fixture
def sheet(browser: Browser, scored: Scored) -> Any:
    """Show the map with these layers only, and take down what is drawn."""
    page = browser.kept_page(NOTE_PATHS, WIDE)
    shown: list[Any] = []

    def draw(layers: str, *, zoom: float = 20.5, job: Scored = scored) -> Sheet:
        lon, lat = lonlat_from_enu(LAT_DEG, LON_DEG, np.array([[SCANS * 1.05, 0.0]]))[0]
        if shown != [zoom, job]:
            show(page, job, f"layers=zone&view={zoom}/{lat:.6f}/{lon:.6f}")
            shown[:] = [zoom, job]
        visit(page, job.server.address, re.sub(r"layers=[^&]*", f"layers={layers}", address_of(page).partition("#")[2]))
        return Sheet(page, painted(page))

    return draw


def assert_one_sign_each(found: np.ndarray, places: np.ndarray) -> None:
    """Signs and features are the same; those of features on one pixel of the canvas may be one."""
    assert len(places) > 0
    away = np.hypot(*(found[:, None] - places[None]).transpose(2, 0, 1))
    assert away.min(axis=1).max() < NEAR_PX  # no sign without its feature
    assert away.min(axis=0).max() < NEAR_PX  # no feature without its sign
    exact, shift = fit(found, places)
    own = exact.argmin(axis=1)
    assert exact.min(axis=1).max() < 0.02
    assert len({tuple(each) for each in np.round(found, 6).tolist()}) == len(found)  # none twice
    hidden = np.delete(places, own, axis=0)
    if len(hidden):  # only those that share their pixel with one that is drawn
        gaps = np.abs(hidden[:, None] - (found - shift)[None]).max(axis=2)
        assert gaps.min(axis=1).max() < 1.0


def fit(found: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances from each sign to each place, and the shift of the canvas against the pixels of the world."""
    shifts = [found[0] - place for place in places if math.dist(found[0], place) < NEAR_PX]
    every = [np.hypot(*(found[:, None] - shift - places[None]).transpose(2, 0, 1)) for shift in shifts]
    best = min(range(len(every)), key=lambda row: float(every[row].min(axis=1).max()))
    return every[best], shifts[best]


def assert_ink(parts: list[Part]) -> None:
    """What was traced is to be seen."""
    inks = [part.ink for part in parts if part.ink is not None]
    assert len(inks) > 0
    assert min(inks) > 40


def is_same(drawn: np.ndarray, expected: np.ndarray) -> bool:
    return drawn.shape == expected.shape and bool(np.abs(drawn - expected).max() < NEAR_PX)


def test_each_feature_has_its_sign_and_nothing_else_is_drawn(sheet: Any, scored: Scored) -> None:
    assert sheet("zone").parts == []
    (line,) = scored.features("trajectory")
    drawn = sheet("track")
    (part,) = drawn.parts
    assert is_same(part.points, screen_of(drawn.page, line["geometry"]["coordinates"]))
    assert_ink([part])
    layers = {
        "keyframes": scored.features("keyframes"),
        **{kind: scored.detections(kind.upper()) for kind in ("tp", "fp")},
        **{kind: scored.nodes(kind) for kind in ("found", "missed")},
        **{kind: scored.intersections(kind) for kind in ("right", "wrong")},
        "outside": scored.nodes("outside"),
    }
    for layer, features in layers.items():
        drawn = sheet(layer, zoom={"outside": 19, "right": 18, "wrong": 18}.get(layer, 20.5))
        signs, *glyphs = drawn.paths
        assert len(glyphs) == (layer in {"right", "wrong", "missed"}), layer
        found = np.array([part.middle for part in signs.parts])
        if layer == "fp":  # a cross has two lines
            assert np.abs(found[::2] - found[1::2]).max() < 1e-6
            found = found[::2]
        assert_one_sign_each(found, drawn.screen(features))
        if layer in {"keyframes", "tp", "right", "wrong", "missed"}:  # full ones; the others are outlines
            assert {kind for path in drawn.paths for kind, _, _ in path.styles} >= {"fill"}, layer
        assert_ink(drawn.parts)


def test_intersections_are_drawn_with_all_that_is_known_of_them(sheet: Any, scored: Scored) -> None:
    """Near by a sign is a ring, in which the detections lie; an ellipse for the uncertainty, a ray for each branch."""
    drawn = sheet("right")
    (rings,) = drawn.paths
    assert {kind for kind, _, _ in rings.styles} == {"stroke"}
    assert_one_sign_each(np.array([part.middle for part in rings.parts]), drawn.screen(scored.intersections("right")))

    features = scored.features("intersections")
    drawn = sheet("uncertainty")
    assert_one_sign_each(np.array([part.middle for part in drawn.parts]), drawn.screen(features))
    for feature, place in zip(features, drawn.screen(features), strict=True):
        east, both, north = feature["details"]["position_cov_m2"]
        longest = np.linalg.eigvalsh([[east, both], [both, north]])[1]
        radius = math.sqrt(-2 * math.log(0.05) * longest) * pixels_per_metre(drawn.page)
        assert radius > 2, "too small to be drawn at this scale"
        (part,) = [part for part in drawn.parts if math.dist(part.middle, place) < NEAR_PX]
        assert part.radius == pytest.approx(radius, rel=0.01)
    assert_ink(drawn.parts)

    drawn = sheet("branches")
    assert len(drawn.parts) == sum(feature["properties"]["branch_count"] for feature in features) > 0
    assert_ink(drawn.parts)
    places = drawn.screen(features)
    bearings: dict[int, list[float]] = {}
    for part in drawn.parts:
        start, end = part.points
        angle = math.degrees(math.atan2(end[0] - start[0], start[1] - end[1])) % 360
        own = int(np.hypot(*(places - start).T).argmin())
        assert math.dist(places[own], start) < 14  # at its ring
        bearings.setdefault(own, []).append(angle)
    for row, feature in enumerate(features):
        assert sorted(bearings[row]) == pytest.approx(
            sorted(each % 360 for each in feature["properties"]["branch_bearings_deg"]), abs=0.1
        )


def test_each_road_is_drawn_along_all_its_points(sheet: Any, scored: Scored) -> None:
    roads = scored.features("osm_roads")
    assert len({road["properties"]["highway"] for road in roads}) >= 3
    drawn = sheet("roads")
    lines = [screen_of(drawn.page, road["geometry"]["coordinates"]) for road in roads]
    for line in lines:
        assert any(is_same(part.points, line) for part in drawn.parts)
    for part in drawn.parts:
        assert any(is_same(part.points, line) for line in lines)
    # Roads of cars have a casing below, in each class: as many lines of its colour as of the roads'.
    colours: dict[str, int] = {}
    for path in drawn.paths:
        ((_, colour, _),) = path.styles
        colours[colour] = colours.get(colour, 0) + len(path.parts)
    driven = [road["properties"]["highway"] for road in roads if road["properties"]["is_drivable"]]
    by_class = [driven.count(each) for each in set(driven)]
    others = [len(roads) - len(driven)] if len(driven) < len(roads) else []
    assert sorted(colours.values()) == sorted([*by_class, *by_class, *others])
    assert_ink(drawn.parts)


def test_forced_colours_leave_the_map_its_own(browser: Browser, done: Done) -> None:
    page = browser.new_context(forced_colors="active").new_page()
    page.add_init_script(NOTE_PATHS)
    show(page, done, "panel=result")
    assert len({colour for path in painted(page) for _, colour, _ in path.styles}) > 2
