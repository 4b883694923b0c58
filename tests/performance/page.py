"""How smoothly the map of the page moves: `make bench-page`.

A real server, a drive with ten thousand detections, the Chromium of this machine without a graphics card. The map is
dragged to and fro and zoomed; the times between frames are those at which the browser would have shown them.
"""

import argparse
import itertools
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tests.app.processes import API, ServerProcess, ended, started, submit, upload
from tests.app.street import write_street
from tests.page.browsers import PATIENCE_MS, chromium
from tests.performance.shared import Row, show

DRAGS = 8
STEPS = 30
# Notes the time of every frame.
RECORD = """() => {
  window.frames_ms = [];
  const note = (now) => { window.frames_ms.push(now); window.recording = requestAnimationFrame(note); };
  window.recording = requestAnimationFrame(note);
}"""
STOP = "() => (cancelAnimationFrame(window.recording), window.frames_ms)"


def record(page: Any, move: Callable[[], None]) -> str:
    """Move the map, and tell the times between frames."""
    page.evaluate(RECORD)
    move()
    times = page.evaluate(STOP)
    gaps = sorted(after - before for before, after in itertools.pairwise(times))
    late = sum(gap > 34 for gap in gaps) / len(gaps)
    return (
        f"{statistics.median(gaps):.1f} ms a frame (median), {gaps[int(0.95 * len(gaps))]:.1f} ms (95 %), "
        f"{gaps[-1]:.0f} ms at most, {late:.1%} over 34 ms, {len(gaps)} frames"
    )


def drag(page: Any) -> None:
    box = page.locator("#map").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    for number in range(DRAGS):
        page.mouse.move(x, y + 120)
        page.mouse.down()
        page.mouse.move(x + (300 if number % 2 else -300), y + 160, steps=STEPS)
        page.mouse.up()


def zoom(page: Any) -> None:
    for name in ("Zoom in", "Zoom in", "Zoom out", "Zoom out"):
        page.get_by_role("button", name=name).click()
        page.wait_for_timeout(500)


def measure(server: ServerProcess, street: Path) -> Iterator[Row]:
    """Have a drive worked on, open the result, and move its map."""
    job = submit(server.client, upload(server.client, street), osm={"file": "map.osm"})
    ended(server.client, job, 300)
    detections = server.client.get(f"{API}/jobs/{job}/layers/detections").json()["features"]
    yield "detections", f"{len(detections):,}"
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.set_default_timeout(PATIENCE_MS)
        began = time.perf_counter()
        page.goto(f"{server.address}/#panel=result&job={job}")
        page.wait_for_selector(".legend:visible")
        yield "from the address to the map", f"{time.perf_counter() - began:.1f} s"
        page.wait_for_timeout(1000)
        yield "drag, the whole drive seen", record(page, lambda: drag(page))
        yield "zoom, the whole drive seen", record(page, lambda: zoom(page))
        for _ in range(4):
            page.get_by_role("button", name="Zoom in").click()
            page.wait_for_timeout(500)
        yield "drag, closer", record(page, lambda: drag(page))


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=6800, help="of the drive")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        street = write_street(folder / "street", options.scans)
        with started(folder / "data", folder / "server.log") as server:
            show(measure(server, street))


if __name__ == "__main__":
    main()
