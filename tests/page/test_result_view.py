"""Results on the page, in a real browser against a real server: what is seen must be what the files say."""

import math
import re
from typing import Any

import numpy as np
import pytest

from interloc.config import DetectorConfig
from tests.app.processes import API
from tests.page.browsers import Browser, needs_page
from tests.page.canvas import painted, pixels_per_metre, screen_of
from tests.page.results import SCANS, Done, Scored, address_of, show

pytestmark = needs_page


def on_screen(page: Any, lon: float, lat: float) -> tuple[float, float]:
    """Where a place must be on the screen."""
    ((x, y),) = screen_of(page, (lon, lat)).tolist()
    return x, y


def test_counts_of_the_legend_are_those_of_the_files(page: Any, done: Done) -> None:
    show(page, done, "panel=result")
    outcomes = [feature["properties"]["outcome"] for feature in done.features("matches")]
    nodes = [feature["properties"]["outcome"] for feature in done.features("osm_nodes")]
    fused = [feature["properties"]["outcome"] for feature in done.features("intersections")]
    expected = {
        "Right": fused.count("right"),
        "Wrong": fused.count("wrong"),
        "Not counted": fused.count("not_counted"),
        "Not scored": fused.count("unscored"),
        "True": outcomes.count("TP"),
        "False": len(done.features("detections")) - outcomes.count("TP"),
        "Found": nodes.count("found"),
        "Missed": nodes.count("missed"),
        "Keyframes": SCANS,
    }
    legend = page.inner_text(".legend")
    for name, count in expected.items():
        shown = re.search(rf"^{name}\s+([\d,]+)$", legend, re.MULTILINE)
        assert int(shown[1].replace(",", "") if shown else 0) == count, name


def test_seen_area_and_picture_lie_where_the_server_says(page: Any, done: Done) -> None:
    frame = SCANS // 2
    view = done.server.client.get(f"{API}/jobs/{done.job}/keyframes/{frame}/bev").raise_for_status().json()
    lon, lat = (sum(corner[i] for corner in view["corners_lonlat"]) / 4 for i in (0, 1))
    show(page, done, f"frame={frame}&drawer=1&view=18/{lat}/{lon}")
    page.wait_for_selector(".turned-image >> nth=1")
    corners = [on_screen(page, *corner) for corner in view["corners_lonlat"]]
    for selector, tolerance in ((".turned-image", 1.0), ("path.roi", 2.0)):  # the picture is cut at whole cells
        box = page.locator(selector).first.bounding_box()
        found = (box["x"], box["y"], box["x"] + box["width"], box["y"] + box["height"])
        xs, ys = zip(*corners, strict=True)
        assert found == pytest.approx((min(xs), min(ys), max(xs), max(ys)), abs=tolerance), selector
    sides = [math.dist(corners[0], corners[1]), math.dist(corners[1], corners[2])]
    assert sides == pytest.approx([DetectorConfig().bev.size_m * pixels_per_metre(page)] * 2, rel=0.01)
    page.wait_for_selector("#drawer figure img:not(.waiting) >> nth=5")
    turn = page.evaluate("document.documentElement.style.getPropertyValue('--turned')")
    (x, y), (to_x, to_y) = corners[:2]  # pictures lie as the map does
    assert float(re.findall(r"rotate\((\S+)rad", turn)[0]) == pytest.approx(math.atan2(to_y - y, to_x - x), abs=0.01)


def test_details_stay_while_the_drive_plays_and_lead_to_their_keyframe(page: Any, done: Done) -> None:
    feature = done.features("intersections")[0]
    place = feature["properties"] | feature["details"]
    show(page, done, f"intersection={place['id']}")
    popup = page.locator(".leaflet-popup-content")
    popup.wait_for()
    popup.get_by_role("button", name="Look inside").click()
    title = page.locator("#drawer h2")
    title.wait_for()
    assert place["first_frame"] <= int(title.inner_text().split()[-1]) <= place["last_frame"]
    page.locator("#strip").get_by_role("button", name="Look inside").click()
    page.locator("#drawer").wait_for(state="hidden")
    before = popup.bounding_box()
    page.get_by_label("Speed").select_option("60")
    page.get_by_role("button", name="Play").click()
    page.get_by_role("button", name="Pause").wait_for()
    page.get_by_role("button", name="Play").wait_for()  # it has come to the end
    assert popup.bounding_box() == before


def test_the_report_tells_the_figures_and_leads_to_the_map(page: Any, done: Done) -> None:
    report = done.report()
    show(page, done, "panel=result")
    rows = page.locator(".osm-nodes tbody tr.can")
    rows.first.wait_for(state="attached")  # the panel may come after the map
    page.locator("#panel-result details").evaluate_all("(all) => all.forEach((each) => (each.open = true))")
    text = page.inner_text("#panel-result").replace("\u00a0", " ")
    assert f"{report['ace_m']:.2f} m" in text
    assert f"{100 * report['precision']['5.0']:.1f} %" in text
    assert f"{report['nodes_found']} of {report['nodes_in_zone']}" in text
    level = report["map_level"]
    assert f"{level['true']} of {level['intersections_in_zone']}" in text
    assert rows.count() == len(report["nodes"])
    ids = page.locator(".osm-nodes tr.below .number").all_inner_texts()
    assert sorted(ids) == sorted(node["osm_id"] for node in report["nodes"])
    rows.nth(1).focus()
    page.keyboard.press("Enter")
    popup = page.locator(".leaflet-popup-content")
    popup.wait_for()
    assert str(ids[1]) in popup.inner_text()
    page.locator(".osm-nodes tbody tr.below.is", has_text=str(ids[1])).wait_for()


def test_keys_choose_tabs_and_keyframes_play_and_list_themselves(page: Any, done: Done) -> None:
    show(page, done, "panel=result")
    page.locator("#tab-result").focus()
    page.keyboard.press("ArrowRight")
    assert page.evaluate("document.activeElement.id") == "tab-map"
    page.keyboard.press("ArrowLeft")
    page.get_by_role("slider", name="Keyframe").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    page.keyboard.press(".")
    page.keyboard.press(",")
    page.keyboard.press(",")
    assert re.search(r"frame=1(&|$)", address_of(page))
    assert "Scan 1" in page.inner_text(".timeline-label")
    page.keyboard.press("Space")
    page.get_by_role("button", name="Pause").wait_for()
    page.keyboard.press("Space")
    page.get_by_role("button", name="Play").wait_for()
    page.locator("#tab-result").focus()
    page.keyboard.press("Space")  # which presses the tab
    assert page.get_by_role("button", name="Pause").count() == 0
    page.keyboard.press("?")
    assert "Previous keyframe" in page.get_by_role("dialog", name="Keyboard shortcuts").inner_text()
    page.keyboard.press("Escape")
    page.locator("dialog").wait_for(state="detached")


def test_a_link_shows_the_same_again(page: Any, done: Done) -> None:
    show(page, done, "panel=export&frame=12")
    page.locator("#layer-tp").uncheck()
    link = address_of(page)
    page.goto("about:blank")
    page.goto(link)
    page.wait_for_selector(".legend:visible")
    assert address_of(page) == link
    assert not page.locator("#layer-tp").is_checked()
    assert page.locator("#layer-fp, #layer-roads").first.is_checked()
    assert "Scan 12" in page.inner_text(".timeline-label")
    page.get_by_role("button", name="Result", exact=True).click()
    page.go_back()
    page.locator("#panel-export").wait_for()


def test_where_else_a_drive_fits_the_map_is_a_layer(browser: Browser, done: Done) -> None:
    page = browser.new_page()
    track = done.features("trajectory")[0]
    view = done.server.client.get(f"{API}/jobs/{done.job}/view").json()
    page.route("**/view", lambda route: route.fulfill(json=view | {"places": {"features": [track, track, track]}}))
    show(page, done, "panel=result")
    assert page.locator(".legend label", has_text="Next best places").inner_text().split()[-1] == "2"


def test_the_road_seen_by_lidar_lies_where_the_server_says(page: Any, done: Done) -> None:
    view = done.server.client.get(f"{API}/jobs/{done.job}/road").raise_for_status().json()
    west, south, east, north = view["bounds_lonlat"]
    show(page, done, f"view=18/{(south + north) / 2}/{(west + east) / 2}")
    picture = page.locator("img.road-surface")
    picture.wait_for()
    box = picture.bounding_box()
    left, top = on_screen(page, west, north)
    right, bottom = on_screen(page, east, south)
    found = (box["x"], box["y"], box["x"] + box["width"], box["y"] + box["height"])
    assert found == pytest.approx((left, top, right, bottom), abs=1.5)
    page.locator("#layer-surface").uncheck()
    picture.wait_for(state="detached")
    assert "surface" not in address_of(page).split("layers=")[1]
    show(page, done, "view=1.5/0/80", done.local_job)
    picture.wait_for()


def test_without_georeference_the_map_is_in_metres(page: Any, done: Done) -> None:
    show(page, done, "panel=result&view=1.5/5/80", done.local_job)
    page.locator("#panel-result").get_by_text("no georeference").wait_for()
    assert "no georeference" in page.inner_text(".leaflet-control-attribution")
    assert page.locator("#layer-tiles").count() == 0
    files = done.server.client.get(f"{API}/jobs/{done.local_job}/files/intersections.local.json").json()["features"]
    assert re.search(rf"Intersections\s+{len(files)}\b", page.inner_text(".legend"))
    zoom, y, x = (float(each) for each in re.search(r"view=([^&]+)", address_of(page))[1].split("/"))
    box = page.locator("#map").bounding_box()
    for feature in files:
        east, north = feature["geometry"]["coordinates"]
        scale = 2**zoom
        page.mouse.move(
            box["x"] + box["width"] / 2 + (east - x) * scale, box["y"] + box["height"] / 2 - (north - y) * scale
        )
        page.locator(".leaflet-tooltip", has_text=f"Intersection {feature['properties']['id']}").wait_for()


def test_the_page_comes_in_few_requests_and_asks_for_nothing_twice(browser: Browser, done: Done) -> None:
    page = browser.new_context().new_page()
    page.goto(done.server.address)
    page.wait_for_load_state("networkidle")
    entries = '["navigation", "resource"].flatMap((type) => performance.getEntriesByType(type))'
    answers = page.evaluate(f"{entries}.map((each) => [each.name, each.encodedBodySize])")
    once = [address for address, _ in answers if "limit=" not in address]  # lists are looked at again by the clock
    assert len(once) == len(set(once))
    files = {address: size for address, size in answers if "/api/" not in address}
    if not any("/bundle/" in address for address in files):
        pytest.skip("the page is not bundled: npm run build in static/")
    page.goto("about:blank")
    page.goto(f"{done.server.address}/#job={done.job}")
    page.wait_for_load_state("networkidle")
    assert sum("/api/" in address for address in page.evaluate(f"{entries}.map((each) => each.name)")) <= 5
    assert len(files) <= 10
    assert sum(files.values()) < 150_000


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
