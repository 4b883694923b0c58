"""The page on small screens: the map keeps its room, and nothing lies behind anything."""

from typing import Any

import pytest

from tests.page.browsers import Browser, needs_page
from tests.page.results import SCANS, Done, show

pytestmark = needs_page

# What cannot be hit in its middle once it is scrolled to, or is too small for a finger.
OUT_OF_REACH = """(parts) => [...document.querySelectorAll(parts)]
  .filter((each) => each.checkVisibility({ visibilityProperty: true }))
  .flatMap((each) => {
    each.scrollIntoView({ block: "center", behavior: "instant" });
    const target = each.closest("label") ?? each;
    const { x, y, width, height } = target.getBoundingClientRect();
    const hit = document.elementFromPoint(x + width / 2, y + height / 2);
    const hidden = !hit || !(target.contains(hit) || hit.contains(target));
    const small = width < 24 || height < 24;
    const found = `${each.outerHTML.slice(0, 120)}: ${width} x ${height}, hits ${hit?.outerHTML.slice(0, 80)}`;
    return hidden || small ? [found] : [];
  })"""
CONTROLS = "button, select, input:not([type=file]), a.button, summary, td"


def reach(page: Any, *parts: str) -> list[str]:
    where = ", ".join(f"{part} :is({CONTROLS})" for part in parts)
    found: list[str] = page.evaluate(OUT_OF_REACH, where)
    return found


SIZES = {"tablet": (1024, 768), "phone on its side": (844, 390), "phone": (390, 844)}


@pytest.fixture
def page(browser: Browser) -> Any:
    """A tab for fingers."""
    return browser.new_context(has_touch=True).new_page()


def test_everything_can_be_reached(page: Any, done: Done) -> None:
    for name, (width, height) in SIZES.items():
        page.set_viewport_size({"width": width, "height": height})
        show(page, done, f"panel=result&frame={SCANS // 2}&drawer=1")
        page.wait_for_selector("#drawer img:not(.waiting) >> nth=5")
        stage = page.locator("#stage").bounding_box()
        assert stage["width"] >= min(480, width), name
        assert not reach(page, "#header", "#stage", "#drawer"), name
        assert page.locator("#drawer tbody tr, #drawer .quiet").last.is_visible(), name
        page.locator(".legend summary").click()
        assert not reach(page, ".legend"), name
        page.locator(".legend summary").click()
        page.locator("#tab-result").click()  # its panel was below the keyframe
        page.locator("#drawer").wait_for(state="hidden")
        assert not reach(page, "#tabs", "#panel-result"), name
        assert page.evaluate("document.documentElement.scrollHeight") == height, name  # all that scrolls are its parts
        page.locator("#tab-upload").click()
        if not page.locator(".upload-form").is_visible():
            page.set_input_files("input[name=folder]", done.short)
            page.wait_for_selector(".upload-form >> text=read as semantickitti")
        if width < height:
            assert page.locator("#panel").bounding_box()["height"] > height / 2, name
        assert not reach(page, ".upload-form"), name

    show(page, done, "panel=result")  # details are wholly on the map of a phone
    page.keyboard.press("n")
    page.locator(".leaflet-popup-content h3").wait_for()
    page.wait_for_function("""() => {
      const map = document.getElementById("map").getBoundingClientRect();
      const box = document.querySelector(".leaflet-popup").getBoundingClientRect();
      return box.top >= map.top && box.bottom <= map.bottom;
    }""")
    page.locator(".leaflet-popup").get_by_role("button", name="Look inside").press("Enter")
    page.locator(".leaflet-popup").wait_for(state="detached")  # it would cover the map above the keyframe
    assert page.evaluate("document.activeElement.id") == "map"
