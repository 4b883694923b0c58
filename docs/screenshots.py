"""Take the pictures of the page for the README and docs/: `make screenshots`.

Simulates the demo drive, has a real server of its own work on it, and opens the page in the Chromium of this machine.
The pictures of 1280 by 800 pixels go to docs/figures; with --look FOLDER those of other sizes and colours go there.
"""

from __future__ import annotations

import argparse
import io
import shlex
import tempfile
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from PIL import Image

from interloc.cli.main import run
from tests.app.processes import API, ServerProcess, ended, started, submit, upload, wait_until
from tests.page.browsers import PATIENCE_MS, chromium

FIGURES = Path(__file__).parent / "figures"
Size = tuple[int, int]
SIZE = (1280, 800)
LARGE = (1920, 1080)
PLAYED = (1180, 620)
PLAYED_WIDTH = 640
PLAYED_EVERY = 10  # keyframes
PRESETS = ("paper", "default")
FRAME = 613  # two intersections
DEMO = shlex.split("simulate town --part quarter --ground-only --columns 720")


class Studio:
    """A server with the demo drive, worked on with both presets; the same drive as a folder."""

    def __init__(self, server: ServerProcess, folder: Path) -> None:
        self.address = server.address
        self.folder = folder / "demo"
        assert run([*DEMO, "-o", str(self.folder), "--quiet"]) == 0
        drive = {"state": ""}
        while drive["state"] != "ready":
            answer = server.client.post(f"{API}/demo", headers={"Prefer": "wait=300"}, timeout=310)
            drive = answer.raise_for_status().json()
        jobs = [submit(server.client, drive["id"], preset=preset, osm={"file": "map.osm"}) for preset in PRESETS]
        done = [ended(server.client, job) for job in jobs]
        assert all(job["state"] == "successful" for job in done), done
        self.job = done[-1]["id"]
        keyframes = server.client.get(f"{API}/jobs/{self.job}/layers/keyframes").json()["features"]
        self.frames = len(keyframes)
        self.frame = max((each["properties"] for each in keyframes), key=lambda each: each["detections"])["frame"]
        self.now = datetime.fromisoformat(done[-1]["finished_at"]) + timedelta(seconds=9)
        self.merge(server)

    def merge(self, server: ServerProcess) -> None:
        """Drive through the town a second time, and compare the map of both drives with one that lacks some streets."""
        again = self.folder.with_name("second pass")
        assert run([*DEMO, "--seed", "1", "-o", str(again), "--quiet"]) == 0
        np.savetxt(again / "times.txt", 1.7e9 + np.loadtxt(again / "times.txt"))  # else it would be the same drive
        ended(server.client, submit(server.client, upload(server.client, again)))
        root = ET.parse(again / "map.osm").getroot()  # noqa: S314 - written by the simulator just now
        root.attrib.pop("generator")  # of a map that is made up nothing is claimed, and of one nothing where it ends
        streets = [way for way in root.iter("way") if way.find("tag[@k='highway']") is not None]
        nodes = {node.attrib["id"]: node for node in root.iter("node")}
        uses = Counter(nd.attrib["ref"] for way in streets for nd in way.iter("nd"))
        ends = {way.findall("nd")[at].attrib["ref"] for way in streets for at in (0, -1)}
        middle = {axis: fmean(float(node.attrib[axis]) for node in nodes.values()) for axis in ("lat", "lon")}
        for number, ref in enumerate(sorted(end for end in ends if uses[end] == 1), 1):
            onward = {axis: str(3 * float(nodes[ref].attrib[axis]) - 2 * of) for axis, of in middle.items()}
            ET.SubElement(root, "node", onward, id=str(-number))
            way = ET.SubElement(root, "way", id=str(-number))
            way.extend([ET.Element("nd", ref=each) for each in (ref, str(-number))])
            ET.SubElement(way, "tag", k="highway", v="residential")
        for way in streets[3::6]:
            root.remove(way)
        city = f"{API}/maps/default"
        server.client.put(f"{city}/osm/town.osm", content=ET.tostring(root)).raise_for_status()
        wait_until(lambda: server.client.get(city).json()["findings"], "what the map lacks")

    def steps(self) -> bytes:
        """Return the picture of all steps of the method at one scan."""
        out = self.folder.parent / "steps"
        assert run(["explain", str(self.folder), "--frame", str(FRAME), "-o", str(out), "--quiet"]) == 0
        return shrink((out / "overview.png").read_bytes())

    def show(self, page: Any, fields: str) -> None:
        """Open a link to the result."""
        page.goto(f"{self.address}/#job={self.job}&{fields}")
        page.wait_for_selector(".legend")


def show_map(page: Any, studio: Studio) -> None:
    """Show the whole town, and the report beside it."""
    studio.show(page, "panel=result")
    page.wait_for_selector("#panel-result tbody tr")


def show_report(page: Any, studio: Studio) -> None:
    """Show a node on the map, and both presets side by side."""
    studio.show(page, "panel=result")
    page.locator(".intersections tbody tr.can").first.click()
    page.locator(".leaflet-popup-content").wait_for()
    page.get_by_role("button", name="Compare", exact=True).click()
    page.locator("#panel-compare .others input").first.check()
    page.wait_for_selector("#panel-compare td.better")


def show_keyframe(page: Any, studio: Studio) -> None:
    """Show what the method saw at a keyframe."""
    studio.show(page, f"panel=result&frame={studio.frame}&drawer=1")
    page.wait_for_selector("#drawer img:not(.waiting) >> nth=5")


def show_upload(page: Any, studio: Studio) -> None:
    """Show the form of an upload."""
    page.goto(f"{studio.address}/#panel=upload")
    page.set_input_files("input[name=folder]", studio.folder)
    page.wait_for_selector(".upload-form >> text=The map covers")


def show_city(page: Any, studio: Studio) -> None:
    """Show the map of all drives, and a finding of its queue."""
    page.goto(f"{studio.address}/#panel=map")
    page.locator("#panel-map .jobs li").first.wait_for()
    page.keyboard.press("j")
    page.wait_for_selector(".finding img[src^=blob]")
    page.get_by_role("button", name="Zoom out").click(click_count=3)


VIEWS: dict[str, Callable[[Any, Studio], None]] = {
    "page_map": show_map,
    "page_report": show_report,
    "page_keyframe": show_keyframe,
    "page_upload": show_upload,
    "page_city": show_city,
}


def take(browser: Any, studio: Studio, show: Callable[[Any, Studio], None], size: Size, scheme: str) -> bytes:
    """Open a view in a tab of its own; returns the picture as PNG."""
    context = browser.new_context(
        viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, reduced_motion="reduce"
    )
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    page.clock.set_fixed_time(studio.now)  # so that "just now" does not move
    show(page, studio)
    page.wait_for_load_state("networkidle")
    page.mouse.move(size[0] - 2, 2)
    page.wait_for_timeout(400)  # the canvas is painted at the next frame
    picture: bytes = page.screenshot(animations="disabled")
    context.close()
    return shrink(picture)


def play(browser: Any, studio: Studio) -> bytes:
    """Play the drive on the map; returns the pictures as an animated GIF."""
    context = browser.new_context(viewport={"width": PLAYED[0], "height": PLAYED[1]}, reduced_motion="reduce")
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    page.add_init_script("localStorage.setItem('interloc.legend', 'no')")
    studio.show(page, "panel=result")
    page.wait_for_load_state("networkidle")
    pictures = []
    for frame in range(0, studio.frames, PLAYED_EVERY):
        page.evaluate("(hash) => { location.hash = hash; }", f"panel=result&job={studio.job}&frame={frame}")
        page.wait_for_timeout(120)  # the canvas is painted at the next frame
        picture = Image.open(io.BytesIO(page.screenshot(clip=page.locator("#map").bounding_box()))).convert("RGB")
        height = round(PLAYED_WIDTH * picture.height / picture.width)
        pictures.append(picture.resize((PLAYED_WIDTH, height), Image.Resampling.LANCZOS))
    context.close()
    palette = pictures[len(pictures) // 2].quantize(128, Image.Quantize.MAXCOVERAGE)
    packed = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    buffer = io.BytesIO()
    packed[0].save(buffer, "GIF", save_all=True, append_images=packed[1:], duration=100, loop=0, optimize=True)
    return buffer.getvalue()


def shrink(picture: bytes) -> bytes:
    """Pack a PNG as well as it can be, without an alpha channel and with its colours untouched."""
    buffer = io.BytesIO()
    Image.open(io.BytesIO(picture)).convert("RGB").save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def take_all(look: Path | None) -> Iterator[Path]:
    """Take all pictures; yields the files written."""
    with tempfile.TemporaryDirectory() as temporary, chromium() as browser:
        folder = Path(temporary)
        with started(folder / "data", folder / "server.log") as server:
            studio = Studio(server, folder)
            for name, show in VIEWS.items():
                path = FIGURES / f"{name}.png"
                path.write_bytes(take(browser, studio, show, SIZE, "light"))
                yield path
            for name, picture in (("play.gif", play(browser, studio)), ("steps.png", studio.steps())):
                (FIGURES / name).write_bytes(picture)
                yield FIGURES / name
            if look is None:
                return
            look.mkdir(parents=True, exist_ok=True)
            for name, show in VIEWS.items():
                for size, scheme in ((SIZE, "light"), (LARGE, "light"), (SIZE, "dark"), ((400, 800), "light")):
                    path = look / f"{name}_{size[0]}_{scheme}.png"
                    path.write_bytes(take(browser, studio, show, size, scheme))
                    yield path


def main(say: Callable[[str], object] = print) -> None:
    """Take the pictures, and name them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--look", type=Path, metavar="FOLDER", help="further pictures, to look at")
    for path in take_all(parser.parse_args().look):
        say(f"{path}  {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
