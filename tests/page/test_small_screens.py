"""The page on small screens: the map keeps its room, and nothing lies behind anything."""

from __future__ import annotations

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


@pytest.mark.parametrize("size", [(1024, 768), (390, 844), (844, 390)], ids=str)
def test_everything_can_be_reached(browser: Browser, done: Done, size: tuple[int, int]) -> None:
    page = browser.new_context(viewport={"width": size[0], "height": size[1]}, has_touch=True).new_page()
    show(page, done, f"panel=report&frame={SCANS // 2}&drawer=1")
    page.wait_for_selector("#drawer img:not(.waiting) >> nth=5")
    stage = page.locator("#stage").bounding_box()
    assert stage["width"] >= min(480, size[0])
    assert not reach(page, "#header", "#stage", "#drawer")
    assert page.locator("#drawer tbody tr, #drawer .quiet").last.is_visible()
    page.locator(".legend summary").click()
    assert not reach(page, ".legend")
    page.locator(".legend summary").click()
    page.locator("#tab-report").click()  # its panel was below the keyframe
    page.locator("#drawer").wait_for(state="hidden")
    assert not reach(page, "#tabs", "#panel-report")
    page.locator("#tab-upload").click()
    page.set_input_files("input[name=folder]", done.short)
    page.wait_for_selector(".upload-form >> text=read as semantickitti")
    if size[0] < size[1]:
        assert page.locator("#panel").bounding_box()["height"] > size[1] / 2
    assert not reach(page, ".upload-form")


def test_details_are_wholly_on_the_map_of_a_phone(browser: Browser, done: Done) -> None:
    page = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True).new_page()
    show(page, done, "panel=report")
    page.keyboard.press("n")
    page.locator(".leaflet-popup-content h3").wait_for()
    page.wait_for_function("""() => {
      const map = document.getElementById("map").getBoundingClientRect();
      const box = document.querySelector(".leaflet-popup").getBoundingClientRect();
      return box.top >= map.top && box.bottom <= map.bottom;
    }""")
