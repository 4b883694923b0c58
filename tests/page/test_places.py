"""Intersections looked at one by one: by list, by keys, by link; where they lead to; coordinates and distances."""

import math
import re
from typing import Any

import numpy as np
import pytest

from tests.page.browsers import copied_by, needs_page
from tests.page.canvas import painted, pixels_per_metre, screen_of
from tests.page.results import Done, Scored, address_of, show

pytestmark = needs_page


def popup_of(page: Any, title: str) -> Any:
    popup = page.locator(".leaflet-popup-content", has=page.get_by_role("heading", name=title))
    popup.wait_for()
    return popup


def signs(page: Any) -> list[np.ndarray]:
    """Middles of the signs of the intersections on the map: filled, or rings with a wide rim."""
    found = [path for path in painted(page) if path.styles[0][0] == "fill" or path.styles[0][2] > 5]
    return [part.middle for path in found for part in path.parts]


def test_the_list_is_a_queue_that_the_map_follows(page: Any, scored: Scored) -> None:
    wrong, right = (
        [each["properties"] | each["details"] for each in scored.intersections(kind)] for kind in ("wrong", "right")
    )
    assert wrong
    assert len(right) >= 2
    layers = "layers=right,wrong,unscored"
    show(page, scored, f"panel=result&{layers}")
    rows = page.locator(".intersections tbody tr.can")
    rows.first.wait_for()  # the panel may come after the map
    assert [int(each) for each in rows.locator("td:nth-child(2)").all_inner_texts()] == [
        each["id"] for each in [*wrong, *right]
    ]
    assert wrong[0]["reason"] in page.inner_text(".intersections tr.below >> nth=0")
    assert len(signs(page)) == len(wrong) + len(right)

    page.keyboard.press("n")
    popup = popup_of(page, f"Intersection {wrong[0]['id']}: wrong")
    assert wrong[0]["reason"].lower() in popup.inner_text().lower()
    assert f"intersection={wrong[0]['id']}" in address_of(page)
    page.locator(".intersections tr.is", has_text=wrong[0]["reason"]).wait_for()
    page.keyboard.press("p")
    last = right[-1]["id"]
    popup_of(page, f"Intersection {last}: right")
    link = address_of(page)

    page.locator("#panel-result .filter summary").click()
    page.get_by_label("Observations, at least").fill(str(max(each["observations"] for each in right)))
    best = [each for each in [*wrong, *right] if each["observations"] >= max(one["observations"] for one in right)]
    assert rows.count() == len(best) < len(wrong) + len(right)
    note = page.locator(".filter-note", has_text=f"{len(best)} of {len(wrong) + len(right)}")
    note.wait_for()
    filtered = address_of(page)
    page.keyboard.press("n")  # the field has the focus: it goes nowhere
    page.locator(".filter-note button").click()
    assert f"intersection={last}" in address_of(page)  # its details stay open
    popup_of(page, f"Intersection {last}: right")
    search = page.get_by_role("searchbox")
    search.fill(right[0]["uid"])
    assert rows.count() == 1
    search.press("Enter")
    popup_of(page, f"Intersection {right[0]['id']}: right")
    assert len(signs(page)) == 1
    page.locator(".leaflet-popup-close-button").last.click()  # the popup before may still fade
    assert "intersection=" not in address_of(page)

    show(page, scored, link.partition("#")[2])
    popup_of(page, f"Intersection {last}: right")
    show(page, scored, filtered.partition("#")[2])
    note.wait_for()
    least = page.get_by_label("Observations, at least").input_value()
    assert f"observations:{least}.." in filtered
    rows.first.wait_for()
    assert rows.count() == len(best)
    page.get_by_role("button", name="Export", exact=True).click()
    page.locator(".filter-note button").click()
    note.wait_for(state="hidden")
    assert "filter=" not in address_of(page)
    page.go_back()
    note.wait_for()
    node = scored.nodes("missed")[0]["properties"]
    show(page, scored, f"node={node['osm_id']}")
    popup = popup_of(page, "OSM intersection: missed")
    assert node["reason"].lower() in popup.inner_text().lower()
    assert f"node={node['osm_id']}" in address_of(page)


def test_a_place_leads_out_without_a_request(page: Any, scored: Scored) -> None:
    (feature, *_) = scored.intersections("right")
    lon, lat = feature["geometry"]["coordinates"]
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    show(page, scored, f"intersection={feature['properties']['uid']}")
    popup = popup_of(page, f"Intersection {feature['properties']['id']}: right")
    for name in ("OpenStreetMap", "iD", "JOSM", "Mapillary"):
        link = popup.locator("a", has_text=re.compile(f"^{name}$"))
        assert link.get_attribute("target") == "_blank"
        assert link.get_attribute("rel") == "noopener"
    assert f"/node/{feature['properties']['osm_id']}" in popup.locator(".why a").get_attribute("href")
    popup.locator("summary").click()
    coordinates = copied_by(popup.get_by_role("button", name="Copy coordinates"))
    assert [float(each) for each in coordinates.split(",")] == [round(lat, 7), round(lon, 7)]
    assert "has it as node" in copied_by(popup.get_by_role("button", name="Copy OSM note"))


def test_the_map_tells_coordinates_and_distances(page: Any, done: Done) -> None:
    features = done.features("intersections")
    places = [feature["geometry"]["coordinates"] for feature in features[:2]]
    lon, lat = np.mean(places, axis=0)
    show(page, done, f"view=18/{lat}/{lon}")
    a, b = screen_of(page, places)
    page.mouse.move(*a)
    told = [float(each) for each in page.locator(".coordinates").inner_text().split(",")]
    assert np.abs(np.array(told) - places[0][::-1]).max() < 1e-5
    page.keyboard.press("m")
    page.mouse.click(*a)
    page.mouse.click(*b)
    told_m = float(re.sub(r"[^\d.]", "", page.locator(".measured").inner_text()))
    assert told_m == pytest.approx(math.dist(a, b) / pixels_per_metre(page), abs=1)
    assert page.locator(".leaflet-popup").count() == 0
    page.keyboard.press("Escape")
    page.locator(".measured").wait_for(state="detached")
    page.mouse.click(*a)
    page.locator(".leaflet-popup").wait_for()
    assert page.get_by_role("button", name="Measure distances").get_attribute("aria-pressed") == "false"
