"""A server with results to look at."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from interloc.geometry import lonlat_from_enu
from tests.app.processes import API, ServerProcess, archive_of, ended
from tests.app.street import LAT_DEG, LON_DEG

SCANS = 90
SHORT = 16  # scans of a drive that is only uploaded
TILE = "https://tiles.example/{z}/{x}/{y}.png"
TOKEN = "a-token-that-only-these-tests-know-0123456789"  # noqa: S105


@dataclass(frozen=True)
class Result:
    server: ServerProcess
    job: str

    def features(self, layer: str) -> list[dict[str, Any]]:
        answer = self.server.client.get(f"{API}/jobs/{self.job}/layers/{layer}").raise_for_status()
        return list(answer.json()["features"])


@dataclass(frozen=True)
class Done(Result):
    """A server with two results of the same street: with and without georeference; its first scans as a drive."""

    local_job: str
    short: Path

    @property
    def data(self) -> Path:
        """Data folder of the server."""
        return self.server.log.with_name("data")

    def report(self) -> dict[str, Any]:
        return dict(self.server.client.get(f"{API}/jobs/{self.job}/report").raise_for_status().json())


class Scored(Result):
    """A result that has features of every kind."""

    def nodes(self, kind: str) -> list[dict[str, Any]]:
        """Nodes of the map: found, missed, or outside of what the drive could see."""
        return [node for node in self.features("osm_nodes") if node["properties"]["outcome"] == kind]

    def intersections(self, outcome: str) -> list[dict[str, Any]]:
        """Intersections that are right, wrong or unscored."""
        return [each for each in self.features("intersections") if each["properties"]["outcome"] == outcome]

    def detections(self, outcome: str) -> list[dict[str, Any]]:
        """Detections, by what the matches say of those at their places."""
        found = self.features("matches")
        true = {tuple(match["geometry"]["coordinates"][0]) for match in found if match["properties"]["outcome"] == "TP"}
        every = self.features("detections")
        return [each for each in every if (tuple(each["geometry"]["coordinates"]) in true) == (outcome == "TP")]


def write_other_map(street: Path) -> None:
    """A map that differs from the street: one crossing is not in it, one is that is not there, roads of all kinds."""
    root = ET.parse(street / "map.osm").getroot()  # noqa: S314 - written by the test itself
    at = {node.get("id"): float(node.get("lon", 0)) for node in root.iter("node")}
    gone = lonlat_from_enu(LAT_DEG, LON_DEG, np.array([[60.0, 0.0]]))[0, 0]
    crossings = [way for way in root.iter("way") if len({round(at[nd.get("ref")], 6) for nd in way.iter("nd")}) == 1]
    root.remove(next(way for way in crossings if abs(at[way.find("nd").get("ref")] - gone) < 1e-6))  # type: ignore[union-attr]
    along = next(way for way in root.iter("way") if way not in crossings)
    for number, kind in enumerate(("residential", "primary", "service", "footway")):
        x = (90.0, -25.0, 75.0, 105.0)[number]
        ends = [(x, -50.0), (x, 0.0), (x, 50.0)] if number == 0 else [(x, 20.0), (x, 50.0)]
        refs = [str(5000 + 10 * number + i) for i in range(len(ends))]
        for ref, (lon, lat) in zip(refs, lonlat_from_enu(LAT_DEG, LON_DEG, np.array(ends)), strict=True):
            root.insert(0, ET.Element("node", id=ref, lat=f"{lat:.9f}", lon=f"{lon:.9f}"))
        way = ET.SubElement(root, "way", id=str(7000 + number))
        for ref in refs:
            ET.SubElement(way, "nd", ref=ref)
        ET.SubElement(way, "tag", k="highway", v=kind)
        if number == 0:  # it meets the street between its nodes at 60 and 120 m
            places = [at.get(nd.get("ref"), 0.0) for nd in along.iter("nd")]
            middle = lonlat_from_enu(LAT_DEG, LON_DEG, np.array([[90.0, 0.0]]))[0, 0]
            along.insert(sum(lon < middle for lon in places), ET.Element("nd", ref=refs[1]))
    ET.ElementTree(root).write(street / "map.osm")


def run_street(server: ServerProcess, folder: Path, **request: Any) -> str:
    """Upload a drive, run it, wait for the end; returns the id of the job."""
    drive = server.client.post(f"{API}/drives", json={"name": folder.name}).raise_for_status().json()["id"]
    server.client.post(f"{API}/drives/{drive}/archive", content=archive_of(folder)).raise_for_status()
    server.client.post(f"{API}/drives/{drive}/commit", json={}).raise_for_status()
    job = server.client.post(f"{API}/jobs", json={"drive_id": drive, **request}).raise_for_status().json()["id"]
    assert ended(server.client, job)["state"] == "successful"
    return str(job)


_GO = """(hash) => {
  for (const dialog of document.querySelectorAll("dialog")) dialog.close();  // of the test before
  if (location.hash.slice(1) === hash) return null;
  return new Promise((done) => {
    addEventListener("popstate", () => done(), { once: true });  // after what the page does then
    location.hash = hash;
  });
}"""


def visit(page: Any, address: str, fields: str = "") -> None:
    """Open an address of the page; a tab that has the page of this server already does not load it again."""
    if page.url.partition("#")[0] == f"{address}/":
        page.evaluate(_GO, fields)
    else:
        page.goto(f"{address}/#{fields}")


def show(page: Any, done: Result, fields: str, job: str | None = None) -> None:
    """Open a link to a result as if it were the first that the tab shows, and wait for its map."""
    page.keyboard.press("Escape")  # what is open above the page
    visit(page, done.server.address, "panel=drives")
    page.wait_for_selector(".legend", state="hidden")
    visit(page, done.server.address, f"job={job or done.job}&{fields}")
    page.wait_for_selector(".legend:visible")


def look_again(page: Any) -> None:
    """Come back to the page: it looks at once for what others have done."""
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")


def address_of(page: Any) -> str:
    """The address that a tab shows now: `page.url` comes a moment after the page has changed it."""
    return str(page.evaluate("location.href"))
