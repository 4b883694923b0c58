"""Uploads through the page, in a browser, to a real server: reduced there, they give what the library gives."""

from __future__ import annotations

import json
import re
import shutil
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx
import pytest

from interloc import detect, evaluate, open_drive, read_osm, write_report, write_results
from interloc.drives.options import LabelFolder
from interloc.evaluation.evaluate import Evaluation
from tests.app.processes import API, ServerProcess, as_by_command, ended, started
from tests.app.street import write_street
from tests.localization.town import LAT_DEG, LON_DEG, write_town_drive, write_town_map
from tests.page.browsers import Browser, Watch, needs_page

SAMPLE = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "kitti360_0009"

pytestmark = needs_page

SCANS = 16
MANY_SCANS = 40  # more than the page has in hand at once
REAL_SCANS = 12


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    folder = tmp_path_factory.mktemp("server")
    with started(folder / "data", folder / "log", workers=1) as running:
        yield running


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_street(tmp_path_factory.mktemp("drives") / "street", SCANS)


@pytest.fixture(scope="module")
def long_street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_street(tmp_path_factory.mktemp("drives") / "long street", MANY_SCANS)


class Upload:
    """The upload panel in a tab."""

    def __init__(self, page: Any, address: str) -> None:
        self.page = page
        self.sent: list[str] = []
        self.under_way: set[Any] = set()
        self.held: list[Any] = []
        page.on("request", self._note)
        page.on("requestfinished", self._note_end)
        page.on("requestfailed", self._note_end)
        page.goto(f"{address}/#panel=upload")
        page.wait_for_selector("#panel-upload .drop")  # the map of a service without drives has one too, earlier

    def _note(self, request: Any) -> None:
        if request.method == "PUT":
            self.sent.append(request.url.split("/files/", 1)[1])
            self.under_way.add(request)

    def _note_end(self, request: Any) -> None:
        self.under_way.discard(request)

    def pick(self, folder: Path) -> None:
        self.page.set_input_files("input[name=folder]", folder)
        self.page.wait_for_selector(".upload-form, .note.error")

    def choose(self, text: str) -> None:
        """Choose a radio or checkbox of the form, also where it is folded away."""
        self.page.evaluate("document.querySelectorAll('.upload-form details').forEach((each) => (each.open = true))")
        self.page.locator("label.check", has_text=text).first.locator("input").check()

    def press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()

    def text(self) -> str:
        return str(self.page.inner_text("#panel-upload"))

    def let_through(self, count: int) -> None:
        """Hold back all scans but the first few."""
        held = self.held

        def decide(route: Any) -> None:
            nonlocal count
            count -= 1
            if count >= 0 or held is not self.held:
                route.continue_()
            else:
                held.append(route)

        self.page.route("**/files/ground/**", decide)

    def release(self) -> None:
        held, self.held = self.held, []
        for route in held:
            route.continue_()

    def wait_for_scans(self, count: int) -> None:
        """Wait until so many scans are through."""
        script = "count => Number(/Scans\\s+(\\d+) of/.exec(document.body.innerText)?.[1] ?? 0) >= count"
        self.page.wait_for_function(script, arg=count)

    def only(self) -> None:
        """Upload without a job; returns when all is there."""
        self.press("Upload only")
        self.page.wait_for_selector("text=Upload another")

    def job(self) -> str:
        """Wait until the job is there; returns its id."""
        self.page.wait_for_url(re.compile("job="))
        found = re.search(r"job=(\w+)", self.page.url)
        assert found is not None
        return found.group(1)


@pytest.fixture
def upload(browser: Browser, server: ServerProcess) -> Upload:
    return Upload(browser.new_page(), server.address)


def drive_of(client: httpx.Client, job_id: str) -> dict[str, Any]:
    job = client.get(f"{API}/jobs/{job_id}").raise_for_status().json()
    drive: dict[str, Any] = client.get(f"{API}/drives/{job['drive_id']}").raise_for_status().json()
    return drive


def files_of(client: httpx.Client, drive_id: str) -> set[str]:
    answer = client.get(f"{API}/drives/{drive_id}/files", params={"limit": 10_000}).raise_for_status().json()
    return {file["path"] for file in answer["files"]}


def features(data: bytes | str) -> Any:
    return json.loads(data)["features"]


@dataclass(frozen=True)
class Expected:
    """What the library finds in a folder itself: the features of each layer, and the score."""

    layers: dict[str, Any]
    evaluation: Evaluation | None


LAYERS = ("detections", "intersections", "keyframes", "trajectory")


@cache
def find(drive: Path, labels: LabelFolder = "labels", *, scored: bool = True) -> Expected:
    """Find the intersections of a drive with the library, once."""
    result = detect(open_drive(drive, labels=labels))
    assert len(result.detections) > 0
    with TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        write_results(result, out)
        evaluation = evaluate(result, read_osm(drive / "map.osm")) if scored else None
        if evaluation is not None:
            write_report(evaluation, out)
        return Expected({name: features((out / f"{name}.geojson").read_bytes()) for name in LAYERS}, evaluation)


def check_results(client: httpx.Client, job_id: str, expected: Expected) -> None:
    """Compare the results of a job with what the library finds."""
    job = ended(client, job_id)
    assert job["state"] == "successful", job["error"]
    for name in LAYERS:
        served = as_by_command(client.get(f"{API}/jobs/{job_id}/{name}").raise_for_status())
        assert features(served) == expected.layers[name], name
    if expected.evaluation is None:
        return
    report = client.get(f"{API}/jobs/{job_id}/report").raise_for_status().json()
    assert report["matched"] == int(expected.evaluation.matching.is_matched.sum())
    assert report["ace_m"] == pytest.approx(expected.evaluation.errors.ace_m, abs=0.005)  # the report rounds


SMALL_FILES = {"geo.csv", "map.osm", "poses.txt", "times.txt", "reduced.json"}


def check_reduced_drive(client: httpx.Client, drive_id: str, scans: int = SCANS) -> None:
    """Check that all that belongs to a street that was reduced in the browser has arrived, and no more."""
    assert client.get(f"{API}/drives/{drive_id}").raise_for_status().json()["state"] == "ready"
    assert files_of(client, drive_id) == SMALL_FILES | {f"ground/labels/{frame:06d}.ground" for frame in range(scans)}


def newest(client: httpx.Client) -> str:
    """Id of the drive that was made last."""
    return str(client.get(f"{API}/drives").raise_for_status().json()["drives"][0]["id"])


def test_a_folder_is_reduced_in_the_browser_and_gives_the_same_results(
    upload: Upload, server: ServerProcess, street: Path
) -> None:
    upload.pick(street)
    upload.page.wait_for_selector("text=read as semantickitti")
    text = upload.text()
    assert f"{SCANS} scans, 0 to {SCANS - 1}" in text
    assert "geo.csv" in text
    upload.page.get_by_text(re.compile(r"The map covers 100 % .* 0\.0.m from the track")).wait_for()
    assert re.search(rf"{SCANS} scans · 3[0-9].m · roads of map\.osm", upload.page.inner_text(".stage-note"))
    upload.press("Upload and run")
    job_id = upload.job()
    check_results(server.client, job_id, find(street))
    drive = drive_of(server.client, job_id)
    assert drive["name"] == "street"
    check_reduced_drive(server.client, drive["id"])
    assert drive["report"]["scan_bytes"] == sum(scan.stat().st_size for scan in (street / "velodyne").iterdir())
    assert drive["report"]["label_scheme"] == "semantickitti"


@pytest.fixture
def sample(tmp_path: Path) -> Path:
    """The first scans of a real drive, with labels of both kinds."""
    root = tmp_path / "real"
    for folder, suffix in (("velodyne", "bin"), ("labels", "label"), ("predictions", "label")):
        (root / folder).mkdir(parents=True)
        for frame in range(REAL_SCANS):
            shutil.copy(SAMPLE / folder / f"{frame:06d}.{suffix}", root / folder)
    for name in ("poses.txt", "times.txt", "geo.csv"):
        lines = (SAMPLE / name).read_text().splitlines(keepends=True)
        (root / name).write_text("".join(lines[: REAL_SCANS + name.endswith(".csv")]))
    return root


@pytest.mark.skipif(not SAMPLE.is_dir(), reason="the KITTI-360 sample is not there: ../shared/data/kitti360_0009")
def test_real_scans_with_two_kinds_of_labels_give_the_same_results(
    upload: Upload, server: ServerProcess, sample: Path
) -> None:
    upload.pick(sample)
    upload.page.get_by_label("Labels to find intersections with").select_option("predictions")
    assert "Choose the map to score against" in upload.text()
    assert upload.page.get_by_role("button", name="Upload and run").is_disabled()
    assert upload.page.get_by_role("button", name="Upload only").is_enabled()
    upload.choose("No map")
    upload.press("Upload and run")
    job_id = upload.job()
    check_results(server.client, job_id, find(sample, "predictions", scored=False))
    drive = drive_of(server.client, job_id)
    again = server.client.post(f"{API}/jobs", json={"drive_id": drive["id"], "labels": "labels"}).raise_for_status()
    check_results(server.client, again.json()["id"], find(sample, scored=False))


def test_everything_can_be_sent_as_it_is(upload: Upload, server: ServerProcess, street: Path) -> None:
    upload.pick(street)
    upload.choose("Everything as it is")
    upload.choose("No map")
    upload.press("Upload and run")
    job_id = upload.job()
    check_results(server.client, job_id, find(street, scored=False))
    assert sum(path.startswith("velodyne/") for path in upload.sent) == SCANS
    assert sum(path.startswith("labels/") for path in upload.sent) == SCANS


def test_a_dropped_folder_is_read(upload: Upload, street: Path) -> None:
    upload.page.get_by_role("tab", name="Drives").click()
    upload.page.wait_for_selector("#panel-drives > *")
    session = upload.page.context.new_cdp_session(upload.page)
    data = {"items": [], "files": [str(street)], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        session.send("Input.dispatchDragEvent", {"type": kind, "x": 200, "y": 300, "data": data})
        upload.page.wait_for_selector(".drop, .upload-form")
    upload.page.wait_for_selector(".upload-form")
    assert f"{SCANS} scans, 0 to {SCANS - 1}" in upload.text()
    assert upload.page.input_value(".upload-form input[type=text]") == "street"
    upload.only()
    assert "Done" in upload.text()


def test_a_reload_does_not_send_again_what_has_arrived(upload: Upload, server: ServerProcess, street: Path) -> None:
    upload.pick(street)
    upload.choose("No map")
    upload.let_through(6)
    upload.press("Upload and run")
    upload.wait_for_scans(6)
    upload.page.reload()
    upload.held = []
    upload.page.wait_for_selector("text=Uploads that were begun")
    (before,) = [
        drive for drive in server.client.get(f"{API}/drives").json()["drives"] if drive["state"] == "uploading"
    ]
    arrived = files_of(server.client, before["id"])
    assert sum(path.startswith("ground/") for path in arrived) >= 6
    upload.sent.clear()
    upload.pick(street)
    upload.press("Continue that upload")
    job_id = upload.job()
    check_results(server.client, job_id, find(street, scored=False))
    assert drive_of(server.client, job_id)["id"] == before["id"]
    sent = {path for path in upload.sent if path.startswith("ground/")}
    assert len(sent) == SCANS - sum(path.startswith("ground/") for path in arrived)
    assert not sent & arrived
    upload.page.goto(f"{server.address}/#panel=upload")
    upload.page.reload()
    upload.page.wait_for_selector("#panel-upload .drop")
    assert "Uploads that were begun" not in upload.text()


def test_a_paused_upload_stands_still_and_goes_on(upload: Upload, server: ServerProcess, long_street: Path) -> None:
    upload.pick(long_street)
    upload.let_through(5)
    upload.press("Upload only")
    upload.wait_for_scans(5)
    upload.press("Pause")
    upload.release()
    upload.page.wait_for_selector("text=What is being sent still arrives")
    while upload.under_way:
        upload.page.wait_for_timeout(50)
    sent = len(upload.sent)
    assert sent < MANY_SCANS
    upload.page.wait_for_timeout(700)
    assert len(upload.sent) == sent
    check_that_others_leave_it(upload, server, long_street)
    upload.press("Resume")
    upload.page.wait_for_selector("text=Upload another")
    check_reduced_drive(server.client, newest(server.client), MANY_SCANS)


def check_that_others_leave_it(upload: Upload, server: ServerProcess, street: Path) -> None:
    """While a tab sends a drive, it says how far it is; another one says so too, and does not send the same."""
    title = re.match(r"(\d+\s%) \S InterLoc", upload.page.title())
    assert title is not None
    assert title[1] in upload.page.get_by_role("tab", name="Upload").inner_text()
    other = Upload(upload.page.context.new_page(), server.address)
    other.page.get_by_text(f"Another tab sends it, {title[1]}").wait_for()
    assert "Continue" not in other.text()
    other.page.get_by_role("tab", name="Drives").click()
    other.page.locator("#panel-drives").get_by_text(f"Another tab sends it, {title[1]}").wait_for()
    other.page.get_by_role("tab", name="Upload").click()
    other.pick(street)
    other.press("Upload only")
    other.page.get_by_text("Another tab sends this drive").wait_for()
    assert not other.sent
    other.page.close()


def test_a_server_that_comes_back_is_waited_for(browser: Browser, watch: Watch, street: Path, tmp_path: Path) -> None:
    watch.expect("net::ERR_")
    with started(tmp_path / "data", tmp_path / "log", workers=1) as first:
        upload = Upload(browser.new_context().new_page(), first.address)
        upload.pick(street)
        upload.let_through(8)
        upload.press("Upload only")
        upload.wait_for_scans(8)
        first.kill()
        upload.release()
        upload.page.wait_for_selector("text=Trying again in")
        port = int(first.address.rsplit(":", 1)[1])
        with started(tmp_path / "data", tmp_path / "log", workers=1, port=port) as second:
            upload.page.wait_for_selector("text=Upload another")
            check_reduced_drive(second.client, newest(second.client))
            upload.page.context.close()


def test_an_archive_is_unpacked_and_checked(
    upload: Upload, server: ServerProcess, street: Path, tmp_path: Path
) -> None:
    archive = tmp_path / "street.tar.gz"
    with tarfile.open(archive, "w:gz") as packed:
        packed.add(street, "street")
    upload.page.set_input_files("input[name=files]", archive)
    upload.page.wait_for_selector(".upload-form")
    assert "street.tar.gz" in upload.text()
    upload.only()
    drive = server.client.get(f"{API}/drives/{newest(server.client)}").json()
    assert (drive["name"], drive["state"], drive["report"]["scans"]) == ("street", "ready", SCANS)


def test_what_is_wrong_is_shown_before_anything_is_sent(upload: Upload, street: Path, tmp_path: Path) -> None:
    broken = Path(shutil.copytree(street, tmp_path / "broken"))
    (broken / "labels/000007.label").unlink()
    (broken / "poses.txt").unlink()
    upload.pick(broken)
    text = upload.text()
    assert "labels/000007.label" in text
    assert f"1 of {SCANS} scans have no labels" in text
    assert "poses.txt" in text
    assert upload.page.get_by_role("button", name="Upload and run").is_disabled()
    assert not upload.sent
    upload.press("Choose another")
    upload.page.wait_for_selector(".drop")
    upload.pick(broken / "velodyne")
    assert "the scans themselves: pick the folder above it" in upload.text()


def test_what_the_service_finds_wrong_can_be_corrected(
    upload: Upload, server: ServerProcess, street: Path, tmp_path: Path
) -> None:
    cut = Path(shutil.copytree(street, tmp_path / "cut"))
    lines = (street / "poses.txt").read_text().splitlines()
    (cut / "poses.txt").write_text("\n".join(lines[:10]) + "\n")
    upload.pick(cut)
    assert f"10 poses for the scans 0 to {SCANS - 1}" in upload.text()
    assert upload.page.get_by_role("button", name="Upload only").is_disabled()
    upload.page.set_input_files("input[name=more-files]", street / "poses.txt")
    upload.page.get_by_text("10 poses for").wait_for(state="hidden")
    upload.only()
    check_reduced_drive(server.client, newest(server.client))


def test_a_folder_that_the_service_cannot_look_into_is_sent_as_it_is(
    upload: Upload, server: ServerProcess, watch: Watch, street: Path
) -> None:
    watch.expect("ERR_FAILED")
    upload.page.route("**/drives/look", lambda route: route.abort())
    upload.pick(street)
    text = re.sub(r"\s+", " ", upload.text())
    assert "The service did not look into it: The server does not answer." in text
    assert re.search(r"all \d+ files \(.*\) would be sent as they are, and be checked there", text)
    upload.only()
    assert sum(path.startswith("velodyne/") for path in upload.sent) == SCANS
    assert server.client.get(f"{API}/drives/{newest(server.client)}").raise_for_status().json()["state"] == "ready"


def test_one_of_several_drives_is_chosen(upload: Upload, street: Path, tmp_path: Path) -> None:
    for name in ("00", "07"):
        shutil.copytree(street, tmp_path / "sequences" / name)
    (tmp_path / f"sequences/07/velodyne/{SCANS - 1:06d}.bin").unlink()
    upload.pick(tmp_path)
    assert "2 drives are in the folder" in upload.text()
    upload.page.get_by_label("2 drives are in the folder").select_option(label=f"sequences/07 ({SCANS - 1} scans)")
    upload.page.wait_for_selector(f"text={SCANS - 1} scans, 0 to {SCANS - 2}")
    assert upload.page.input_value(".upload-form input[type=text]") == "07"


def test_settings_labels_and_maps_of_the_form_reach_the_job(
    upload: Upload, server: ServerProcess, street: Path, tmp_path: Path
) -> None:
    drive = Path(shutil.copytree(street, tmp_path / "own"))
    (drive / "labels").rename(tmp_path / "network")
    (drive / "map.osm").rename(tmp_path / "city.osm")
    (drive / "geo.csv").rename(tmp_path / "fixes.csv")
    upload.pick(drive)
    assert upload.page.get_by_role("button", name="Upload and run").is_disabled()
    upload.page.set_input_files("input[name=prediction-folder]", tmp_path / "network")
    upload.choose("From elsewhere")
    upload.page.set_input_files("input[name=georeference-file]", tmp_path / "fixes.csv")
    upload.choose("A file of mine")
    upload.page.set_input_files("input[name=osm-file]", tmp_path / "city.osm")
    upload.page.get_by_label("Preset").first.select_option("paper")
    upload.page.get_by_label("Side of a cell").fill("0.25")
    upload.page.get_by_label("Distance between keyframes").fill("4")
    upload.press("Upload and run")
    job = ended(server.client, upload.job())
    assert job["state"] == "successful", job["error"]
    request = job["request"]
    assert request["preset"] == "paper"
    assert request["config"]["bev"]["resolution_m"] == 0.25
    assert request["config"]["bev"]["min_points"] == 5  # as the preset "paper" has it
    assert request["config"]["keyframes"]["distance_m"] == 4
    assert request["labels"] == "predictions"
    assert request["osm"] == {"file": "city.osm"}
    found = files_of(server.client, job["drive_id"])
    assert "georeference/fixes.csv" in found
    used = SCANS // 2  # every second scan: more than 4 m
    assert sum(path.startswith("ground/predictions/") for path in found) == used
    assert job["summary"]["keyframes"] == used


def test_the_form_is_usable_by_keyboard(upload: Upload, street: Path) -> None:
    upload.pick(street)
    unnamed = upload.page.evaluate(
        """() => [...document.querySelectorAll('#panel-upload :is(input, select, button)')]
            .filter((each) => each.type !== 'file' && !each.labels?.length && !each.textContent.trim()
                && !each.getAttribute('aria-label')).map((each) => each.outerHTML)"""
    )
    assert unnamed == []
    upload.page.locator(".upload-form input[type=text]").first.focus()
    for _ in range(80):
        upload.page.keyboard.press("Tab")
        if upload.page.evaluate("document.activeElement.textContent") == "Upload only":
            break
    else:
        pytest.fail("the last button cannot be reached")
    upload.page.keyboard.press("Enter")
    upload.page.wait_for_selector("text=Upload another")


def test_a_drive_without_gnss_is_placed_on_the_map(upload: Upload, server: ServerProcess, tmp_path: Path) -> None:
    town = tmp_path / "town"
    truth = write_town_drive(town, every_m=8)
    write_town_map(town / "map.osm")
    upload.pick(town)
    form = upload.page.locator(".upload-form")
    placing = form.get_by_label("Place the drive on the map by its roads")
    assert placing.is_checked()
    refusal = form.get_by_text("This drive has no GNSS: place it on the map")
    placing.uncheck()
    assert refusal.is_visible()
    placing.check()
    assert refusal.is_hidden()
    near = form.get_by_label("Roughly where: latitude, longitude")
    near.fill("somewhere")
    assert form.get_by_text("give latitude and longitude, or nothing").is_visible()
    near.fill(f"{LAT_DEG}, {LON_DEG}")
    upload.press("Upload and run")
    job = ended(server.client, upload.job())
    assert job["state"] == "successful", job["error"]
    assert job["request"]["near"] == {"lat_deg": LAT_DEG, "lon_deg": LON_DEG, "radius_km": 3.0}
    assert job["summary"]["location"]["lat_deg"] == pytest.approx(truth.true_lonlat[0, 1], abs=3e-5)
    upload.page.get_by_text("Placed by its roads").wait_for()
    places = len(features(server.client.get(f"{API}/jobs/{job['id']}/places").raise_for_status().content))
    row = upload.page.locator(".legend label", has_text="Next best places")
    assert str(places - 1) in row.inner_text()
