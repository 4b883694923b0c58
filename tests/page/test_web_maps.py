"""A page of another site shows a result: MapLibre GL reads GeoJSON, vector tiles and items of the API by CORS."""

from typing import Any

import pytest

from tests.app.processes import API
from tests.page.browsers import Browser, needs_page
from tests.page.other_site import PACKAGES
from tests.page.results import Done

pytestmark = [
    *needs_page,
    pytest.mark.skipif(not (PACKAGES / "maplibre-gl").is_dir(), reason="npm ci in static/ was run without dev"),
]


@pytest.fixture
def site(browser: Browser, other_site: str) -> Any:
    """A tab with a page of another origin, that has MapLibre GL and pmtiles.js."""
    page = browser.new_page()
    page.goto(other_site)
    page.wait_for_function("typeof window.show === 'function'")
    return page


def test_maplibre_shows_a_result_on_a_page_of_another_site(site: Any, done: Done, watch: Any) -> None:
    watch.excuse("GPU stall due to ReadPixels")  # of the test itself
    job = f"{done.server.address}{API}/jobs/{done.job}"
    features = done.features("intersections")
    known = sorted(each["properties"]["id"] for each in features)
    assert known
    sources: dict[str, Any] = {
        "layer": {"type": "geojson", "data": f"{job}/layers/intersections"},
        "tiles": {"type": "vector", "url": f"pmtiles://{job}/export?f=pmtiles"},
        "lines": {"type": "vector", "url": f"pmtiles://{job}/export?f=pmtiles&layer=branches"},
    }
    if done.server.client.get("/ogc").status_code == 200:
        address = f"{done.server.address}/ogc/collections/intersections/items"
        sources["items"] = {"type": "geojson", "data": address}
    layers: list[dict[str, Any]] = [
        {"id": "circles", "type": "circle", "source": "tiles", "source-layer": "intersections"},
        {"id": "branches", "type": "line", "source": "lines", "source-layer": "branches"},
        *({"id": f"of {name}", "type": "circle", "source": name} for name in sources if name not in {"tiles", "lines"}),
    ]
    answers: list[Any] = []
    site.on("response", lambda answer: answers.append(answer))  # noqa: PLW0108 - Playwright takes no builtin
    site.evaluate("([...all]) => show(...all)", [features[0]["geometry"]["coordinates"], sources, layers])

    assert site.evaluate("ids('layer')") == known
    assert site.evaluate("ids('tiles', 'intersections')") == known
    assert site.evaluate("map.querySourceFeatures('lines', { sourceLayer: 'branches' }).length") > 1
    assert known[0] in site.evaluate("drawn('circles')")
    assert known[0] in site.evaluate("drawn('of layer')")
    if "items" in sources:
        assert site.evaluate("map.querySourceFeatures('items').length") >= len(known)

    ranges = [each for each in answers if each.url.endswith("/export?f=pmtiles")]
    assert {each.status for each in ranges} == {206}
    size = int(ranges[0].headers["content-range"].rpartition("/")[2])
    told = site.evaluate(
        """async (url) => {
          const { headers } = await fetch(url, { headers: { Range: "bytes=0-6" } });
          return ["content-range", "etag", "accept-ranges", "content-length"].map((name) => headers.get(name));
        }""",
        f"{job}/export?f=pmtiles",
    )
    assert told[0] == f"bytes 0-6/{size}"
    assert told[1].startswith('"')
    assert told[2:] == ["bytes", "7"]
