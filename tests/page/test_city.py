"""The map of many drives on the page: the start, the queue by keys, maps of one's own."""

import re
from typing import Any

import pytest

from tests.app.processes import API, wait_until
from tests.app.street import in_a_town, write_street
from tests.page.browsers import SIZE, Watch, needs_page
from tests.page.results import Done, address_of, look_again, run_street, visit
from tests.page.test_accessibility import check_widths, tab

__all__ = ["tab"]

pytestmark = needs_page

AGAIN = "street again"


@pytest.fixture(scope="module")
def city(done: Done, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The map of the server: the street twice, compared with a map that has one of its crossings 10 m to the east."""
    run_street(done.server, write_street(tmp_path_factory.mktemp("city") / AGAIN, 62))
    osm = re.sub(r'(<node id="[789]" .*lon=)"([^"]*)"', _move, in_a_town((done.short / "map.osm").read_text()))
    done.server.client.put(f"{API}/maps/default/osm/town.osm", content=osm).raise_for_status()

    def look() -> dict[str, Any] | None:
        found = done.server.client.get(f"{API}/maps/default").json()
        return found if found["findings"] and found["drives"] > 1 and not found["is_waiting"] else None

    found: dict[str, Any] = wait_until(look, "the map of the server", every_s=0.2)
    return found


def _move(node: re.Match[str]) -> str:
    return f'{node[1]}"{float(node[2]) + 1.37e-4}"'


def test_the_start_is_the_map_of_all_drives(page: Any, done: Done, watch: Watch, city: dict[str, Any]) -> None:
    watch.expect("503 .*collections/city/items")  # asked for again
    page.route("**/collections/city/items*", lambda route: route.fulfill(status=503), times=1)
    visit(page, done.server.address)
    note = page.locator(".stage-note")
    note.locator("[title^='OpenStreetMap seems']").wait_for()
    assert re.match(rf"{city['intersections']} intersections\s+of {city['drives']} drives", note.inner_text())
    box = page.locator("#map").bounding_box()
    x, y = box["x"] + 56 + (box["width"] - 96) / 2, box["y"] + (box["height"] + note.bounding_box()["height"]) / 2
    drives = done.server.client.get(f"{API}/drives").json()["drives"]
    tip = page.locator(".tip", has_text=re.compile("|".join(re.escape(each["name"]) for each in drives)))
    x += 40  # beside the sign of an intersection
    for aside in range(-40, 40, 4):
        page.mouse.move(x, y + aside)
        if tip.count():
            break
    page.mouse.click(x, y + aside)
    page.wait_for_url(re.compile("drive=.*job="))
    page.locator(".legend:visible").wait_for()
    assert not note.is_visible()
    page.locator("#tab-map").click()
    note.locator("[title^='OpenStreetMap seems']").wait_for()
    page.locator("#tab-result").click()
    page.locator(".legend:visible").wait_for()


def test_findings_are_judged_by_keys(tab: Any, done: Done, city: dict[str, Any], watch: Watch) -> None:
    queue = f"{API}/maps/default/queue"
    entries = done.server.client.get(queue).json()["entries"]
    first = entries[0]
    visit(tab, done.server.address, "panel=map")
    rows = tab.locator("#panel-map .jobs li")
    rows.first.wait_for()
    assert rows.count() == len(entries)
    tab.keyboard.press("j")
    card = tab.locator(".finding")
    card.get_by_text(first["properties"]["text"]).wait_for()
    card.locator("img[src^=blob]").wait_for()
    check_widths(tab, "finding")
    tab.set_viewport_size(SIZE)
    assert card.get_by_role("link", name="JOSM").get_attribute("href") == first["links"]["josm"]
    assert f"finding={first['id']}" in address_of(tab)
    tab.locator("#map").focus()
    tab.keyboard.press("1")
    tab.get_by_text("1 of 1 right: 100 % (95 %: 21 to 100 %)").wait_for()
    said = done.server.client.get(f"{queue}/{first['id']}").json()["verdict"]
    assert (said["verdict"], said["by"]) == ("right", "anonymous")
    done.server.client.put(f"{queue}/{first['id']}/verdict", json={"verdict": "cannot_tell"})
    tab.keyboard.press("u")
    tab.locator("#toasts", has_text="Somebody has said something since").wait_for()
    card.get_by_text("Cannot tell, by anonymous").wait_for()
    tab.keyboard.press("u")
    card.get_by_text("Cannot tell, by anonymous").wait_for(state="detached")
    card.get_by_role("button", name="Take it back").click()
    tab.get_by_text("How many are right is not known yet").wait_for()
    assert done.server.client.get(f"{queue}/{first['id']}").json()["verdict"] is None
    assert f"finding={first['id']}" in address_of(tab)

    watch.expect("403 .*verdict")
    refused = {"title": "Token may only read", "detail": "The token of eve has the scope read."}
    tab.route("**/verdict", lambda route: route.fulfill(status=403, json=refused))
    card.get_by_role("button", name="Wrong").click()
    tab.locator("#toasts", has_text=refused["detail"]).wait_for()
    assert card.get_by_role("button", name="Wrong").is_disabled()
    link = address_of(tab)  # to pass on
    visit(tab, done.server.address, "panel=drives")
    card.wait_for(state="hidden")
    visit(tab, done.server.address, link.partition("#")[2])
    card.get_by_text(first["properties"]["text"]).wait_for()
    watch.expect("404 .*queue/gone")
    visit(tab, done.server.address, "panel=map&finding=gone")
    tab.locator("#toasts", has_text="No such finding").wait_for()


def test_a_map_is_made_of_some_drives(page: Any, done: Done, city: dict[str, Any]) -> None:
    visit(page, done.server.address, "panel=drives")
    look_again(page)
    page.locator("#panel-drives", has_text=AGAIN).wait_for()
    visit(page, done.server.address, "panel=map")
    page.get_by_role("button", name="New map…").click()
    dialog = page.locator("dialog[open]")
    dialog.get_by_label("Name").fill("One street")
    dialog.get_by_role("button", name="Make the map").dblclick()
    choice = dialog.get_by_role("combobox", name="Drive to put in")
    choice.press("ArrowDown")
    choice.select_option(choice.locator("option", has_text=f"{AGAIN} (").get_attribute("value"))
    assert dialog.get_by_text("No drive belongs to it yet").is_visible()
    dialog.get_by_role("button", name="Put it in").click()
    dialog.get_by_role("button", name="Done").click()
    page.locator(".stage-note", has_text="of 1 drive").wait_for()
    assert len(done.server.client.get(f"{API}/maps").json()["maps"]) == 2
    page.locator("#panel-map .badge", has_text="Up to date").wait_for()
    page.get_by_role("button", name="Drives…").click()
    dialog.get_by_text("on the map").wait_for()
    dialog.get_by_role("button", name=f"Take {AGAIN} out of the map").click()
    dialog.get_by_text("No drive belongs to it yet").wait_for()
    dialog.get_by_role("button", name="Done").click()
    page.locator(".cover", has_text="No drive is on this map yet").wait_for()
    page.get_by_role("combobox", name="Map").select_option("default")
    page.locator(".stage-note", has_text=f"of {city['drives']} drives").wait_for()
    page.go_back()
    page.get_by_role("button", name="Delete the map One street").click()
    dialog.get_by_role("button", name="Delete the map").click()
    page.locator(".stage-note", has_text=f"of {city['drives']} drives").wait_for()
