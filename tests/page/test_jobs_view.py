"""Jobs as a person meets them: run again with what they were, named, compared, kept up to date."""

from __future__ import annotations

from typing import Any

from tests.app.processes import API, ended, submit
from tests.page.browsers import needs_page
from tests.page.results import Done, address_of, show

pytestmark = needs_page


def test_a_job_is_run_again_with_a_map_named_and_compared(page: Any, done: Done) -> None:
    client = done.server.client
    drive = client.get(f"{API}/jobs/{done.job}").json()["drive_id"]
    first = submit(client, drive, config={"bev": {"resolution_m": 0.25}}, policy="drive+service")
    ended(client, first)

    show(page, done, "panel=report", job=first)
    page.get_by_role("button", name="Run again with a map…").click()
    choices = page.locator("dialog label.check")
    assert choices.filter(has_text="map.osm").locator("input").first.is_checked()
    choices.filter(has_text="A file of mine").locator("input").check()
    page.set_input_files("dialog input[name=osm-file]", done.short / "map.osm")
    page.get_by_role("button", name="Run", exact=True).click()
    page.wait_for_selector("#panel-job .badge.good")
    again = address_of(page).partition("&job=")[2].partition("&")[0]
    before, after = (client.get(f"{API}/jobs/{each}").json()["request"] for each in (first, again))
    assert after == before | {"osm": {"file": "map-2.osm"}, "labels": "labels"}

    assert page.inner_text(".job-title") == "default, drive+service, r = 0.25, map-2.osm"
    page.get_by_role("button", name="Rename this job").click()
    page.get_by_label("Name", exact=True).fill("coarse")
    page.get_by_label("Note").fill("Two\nlines")
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")  # Save
    page.locator(".job-title", has_text="coarse").wait_for()
    assert page.inner_text("#panel-job .noted") == "Two\nlines"
    assert page.title().split()[0] == "coarse"

    page.get_by_role("button", name="Show this result for the drive").click()
    page.get_by_role("button", name="No longer pin this result").wait_for()
    assert client.get(f"{API}/drives/{drive}").json()["pinned_job"] in address_of(page)
    page.get_by_role("button", name="No longer pin this result").click()

    page.locator("#tab-compare").click()
    page.locator(f"#compare-{done.job}").check()
    page.get_by_role("heading", name="Intersections of the map").wait_for()
    assert address_of(page).endswith(f"&compare={done.job}")
    heads = page.locator("#panel-compare .wide-table").first.locator("th").all_inner_texts()
    assert [head.split("\n")[0] for head in heads] == ["Figure", "coarse", "default"]
    count = len(done.features("intersections"))
    assert f"{count} found by both" in page.inner_text("#panel-compare")
    page.wait_for_selector(f"#map .sign.beside >> nth={count - 1}")
    assert page.locator("#map .sign.beside").count() == count
    page.reload()
    page.wait_for_selector("#map .sign.beside")

    client.patch(f"{API}/jobs/{done.job}", json={"name": "of another tab"}).raise_for_status()
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")  # comes back to the page: looks at once
    page.locator(".others", has_text="of another tab").wait_for()
    client.patch(f"{API}/jobs/{done.job}", json={"name": None}).raise_for_status()
