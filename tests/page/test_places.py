"""Intersections looked at one by one: by list, by keys, by link; where they lead to; coordinates."""

import re
from typing import Any

import numpy as np

from tests.page.browsers import needs_page
from tests.page.canvas import painted, screen_of
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

    search = page.get_by_role("searchbox")
    search.fill(right[0]["uid"])
    assert rows.count() == 1
    filtered = address_of(page)
    page.locator(
        ".intersections", has_text=f"1 of {len(wrong) + len(right)} intersections, here and on the map"
    ).wait_for()
    search.press("Enter")
    popup_of(page, f"Intersection {right[0]['id']}: right")
    assert len(signs(page)) == 1
    page.locator(".leaflet-popup-close-button").last.click()  # the popup before may still fade
    assert "intersection=" not in address_of(page)

    show(page, scored, link.partition("#")[2])
    popup_of(page, f"Intersection {last}: right")
    show(page, scored, filtered.partition("#")[2])
    rows.first.wait_for()
    assert rows.count() == 1
    page.get_by_role("button", name="Show all").click()
    assert rows.count() == len(wrong) + len(right)
    assert "filter=" not in address_of(page)
    node = scored.nodes("missed")[0]["properties"]
    show(page, scored, f"node={node['osm_id']}")
    popup = popup_of(page, "OSM intersection: missed")
    assert node["reason"].lower() in popup.inner_text().lower()
    assert f"node={node['osm_id']}" in address_of(page)


def test_a_place_leads_out_without_a_request(page: Any, scored: Scored) -> None:
    (feature, *_) = scored.intersections("right")
    show(page, scored, f"intersection={feature['properties']['uid']}")
    popup = popup_of(page, f"Intersection {feature['properties']['id']}: right")
    for name in ("OpenStreetMap", "iD"):
        link = popup.locator("a", has_text=re.compile(f"^{name}$"))
        assert link.get_attribute("target") == "_blank"
        assert link.get_attribute("rel") == "noopener"
    assert f"node={feature['properties']['osm_id']}" in link.get_attribute("href")
    assert f"/node/{feature['properties']['osm_id']}" in popup.locator(".why a").get_attribute("href")


def test_the_map_tells_coordinates(page: Any, done: Done) -> None:
    lon, lat = done.features("intersections")[0]["geometry"]["coordinates"]
    show(page, done, f"view=18/{lat}/{lon}")
    (a,) = screen_of(page, [(lon, lat)])
    page.mouse.move(*a)
    told = [float(each) for each in page.locator(".coordinates").inner_text().split(",")]
    assert np.abs(np.array(told) - [lat, lon]).max() < 1e-5
