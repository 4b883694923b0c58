"""Uploads through the page, in a browser, to a real server: reduced there, they give what the library gives."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from interloc import detect, evaluate, open_drive, read_osm, write_report, write_results
from interloc.drives.options import LabelFolder
from tests.app.processes import API, ServerProcess, as_by_command, ended
from tests.app.street import write_street
from tests.page.browsers import Watch, needs_page
from tests.page.results import SHORT as SCANS
from tests.page.results import address_of
from tests.page.uploads import Upload, check_reduced_drive, drive_of, files_of, newest

pytestmark = needs_page

MANY_SCANS = 40  # more than the page has in hand at once
LAYERS = ("detections", "intersections", "keyframes", "trajectory")


def features(data: bytes | str) -> Any:
    return json.loads(data)["features"]


def check_results(
    client: httpx.Client, job_id: str, drive: Path, out: Path, *, labels: LabelFolder = "labels", scored: bool
) -> None:
    """Compare the results of a job with what the library finds in the folder itself."""
    result = detect(open_drive(drive, labels=labels))
    assert len(result.detections) > 0
    write_results(result, out)
    evaluation = evaluate(result, read_osm(drive / "map.osm")) if scored else None
    if evaluation is not None:
        write_report(evaluation, out)
    job = ended(client, job_id)
    assert job["state"] == "successful", job["error"]
    for name in LAYERS:
        served = as_by_command(client.get(f"{API}/jobs/{job_id}/layers/{name}").raise_for_status())
        assert features(served) == features((out / f"{name}.geojson").read_bytes()), name
    if evaluation is not None:
        report = client.get(f"{API}/jobs/{job_id}/report").raise_for_status().json()
        assert report["matched"] == int(evaluation.matching.is_matched.sum())
        assert report["ace_m"] == pytest.approx(evaluation.errors.ace_m, abs=0.005)  # the report rounds


def test_a_folder_is_reduced_in_the_browser_and_gives_the_same_results(
    upload: Upload, uploads: ServerProcess, street: Path, tmp_path: Path
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
    check_results(uploads.client, job_id, street, tmp_path / "out", scored=True)
    drive = drive_of(uploads.client, job_id)
    assert drive["name"] == "street"
    check_reduced_drive(uploads.client, drive["id"], SCANS)
    assert drive["report"]["scan_bytes"] == sum(scan.stat().st_size for scan in (street / "velodyne").iterdir())
    assert drive["report"]["label_scheme"] == "semantickitti"


def test_labels_of_two_kinds_are_sent_and_one_is_chosen(
    upload: Upload, uploads: ServerProcess, street: Path, tmp_path: Path
) -> None:
    root = Path(shutil.copytree(street, tmp_path / "both"))
    shutil.copytree(root / "labels", root / "predictions")
    (root / "map.osm").unlink()
    for path in (root / "labels").iterdir():  # with them the roads would be wider
        labels = np.fromfile(path, "<u4")
        np.where(labels == 48, 40, labels).astype("<u4").tofile(path)
    upload.pick(root)
    upload.page.get_by_label("Labels to find intersections with").select_option("predictions")
    assert "Choose the map to score against" in upload.text()
    assert upload.page.get_by_role("button", name="Upload and run").is_disabled()
    assert upload.page.get_by_role("button", name="Upload only").is_enabled()
    upload.choose("No map")
    upload.press("Upload and run")
    job_id = upload.job()
    check_results(uploads.client, job_id, root, tmp_path / "out", labels="predictions", scored=False)
    sent = files_of(uploads.client, drive_of(uploads.client, job_id)["id"])
    assert {path.split("/")[1] for path in sent if path.startswith("ground/")} == {"labels", "predictions"}


def test_a_dropped_folder_can_be_sent_as_it_is(upload: Upload, uploads: ServerProcess, street: Path) -> None:
    upload.page.get_by_role("tab", name="Drives").click()
    upload.page.wait_for_selector("#panel-drives > *")
    session = upload.page.context.new_cdp_session(upload.page)
    data = {"items": [], "files": [str(street)], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        session.send("Input.dispatchDragEvent", {"type": kind, "x": 200, "y": 300, "data": data})
        upload.page.wait_for_selector("#panel-upload .drop, .upload-form")
    upload.page.wait_for_selector(".upload-form")
    assert f"{SCANS} scans, 0 to {SCANS - 1}" in upload.text()
    assert upload.page.input_value(".upload-form input[type=text]") == "street"
    upload.choose("Everything as it is")
    upload.only()
    assert "Done" in upload.text()
    for kind in ("velodyne", "labels"):
        assert sum(path.startswith(f"{kind}/") for path in upload.sent) == SCANS
    assert newest(uploads.client)["state"] == "ready"


def test_a_reload_does_not_send_again_what_has_arrived(upload: Upload, uploads: ServerProcess, street: Path) -> None:
    upload.pick(street)
    upload.let_through(4)
    upload.press("Upload only")
    upload.wait_for_files(4)
    upload.page.reload()
    upload.held = []
    upload.page.wait_for_selector("text=Uploads that were begun")
    before = newest(uploads.client)
    arrived = files_of(uploads.client, before["id"])
    assert 4 <= len(arrived) < SCANS
    upload.sent.clear()
    upload.page.get_by_role("button", name="Go on with street").first.click()
    upload.page.get_by_text("Pick the same again to go on").wait_for()
    upload.pick(street)
    upload.press("Upload only")
    upload.page.wait_for_selector("text=Upload another")
    assert newest(uploads.client)["id"] == before["id"]
    check_reduced_drive(uploads.client, before["id"], SCANS)
    sent = {path for path in upload.sent if path.startswith("ground/")}
    assert len(sent) == SCANS - sum(path.startswith("ground/") for path in arrived)
    assert not sent & arrived
    upload.press("Upload another")
    upload.page.wait_for_selector("#panel-upload .drop")
    assert "Uploads that were begun" not in upload.text()


def test_a_stopped_upload_stands_still_and_goes_on(upload: Upload, uploads: ServerProcess, tmp_path: Path) -> None:
    long_street = write_street(tmp_path / "long street", MANY_SCANS)
    upload.pick(long_street)
    upload.let_through(3)
    upload.press("Upload only")
    upload.wait_for_files(5)
    upload.page.wait_for_function("""() => {
      const percent = /^(\\d+\\s%) \\S InterLoc/.exec(document.title)?.[1]; // how far it is
      return percent && [...document.querySelectorAll("[role=tab]")].some((tab) => tab.innerText.includes(percent));
    }""")
    upload.press("Stop")
    upload.page.get_by_role("button", name="Continue").wait_for()
    upload.release()
    assert len(upload.sent) < MANY_SCANS
    before = list(upload.sent)
    upload.press("Continue")
    upload.page.wait_for_selector("text=Upload another")
    check_reduced_drive(uploads.client, newest(uploads.client)["id"], MANY_SCANS)
    assert len(set(upload.sent)) == len(upload.sent) > len(before)


def test_what_is_wrong_is_shown_before_anything_is_sent_and_can_be_corrected(
    upload: Upload, uploads: ServerProcess, street: Path, tmp_path: Path
) -> None:
    broken = Path(shutil.copytree(street, tmp_path / "broken"))
    (broken / "labels/000007.label").rename(tmp_path / "000007.label")
    poses = (broken / "poses.txt").rename(tmp_path / "poses.txt")
    upload.pick(broken)
    text = upload.text()
    assert "labels/000007.label" in text
    assert f"1 of {SCANS} scans have no labels" in text
    assert "poses.txt" in text
    assert upload.page.get_by_role("button", name="Upload and run").is_disabled()
    upload.choose_another()
    upload.pick(broken / "velodyne")
    assert "the scans themselves: give the folder above it" in upload.text()

    (tmp_path / "000007.label").rename(broken / "labels/000007.label")
    (broken / "poses.txt").write_text("\n".join(poses.read_text().splitlines()[:10]) + "\n")
    upload.pick(broken)
    assert f"10 poses for the scans 0 to {SCANS - 1}" in upload.text()
    assert upload.page.get_by_role("button", name="Upload only").is_disabled()
    assert not upload.sent
    upload.page.set_input_files("input[name=more-files]", poses)
    upload.page.get_by_text("10 poses for").wait_for(state="hidden")
    upload.only()
    check_reduced_drive(uploads.client, newest(uploads.client)["id"], SCANS)


def test_what_the_server_or_its_proxy_refuses_is_told(
    upload: Upload, watch: Watch, street: Path, tmp_path: Path
) -> None:
    drive = Path(shutil.copytree(street, tmp_path / "bent"))
    scan = drive / "velodyne/000010.bin"
    points = np.fromfile(scan, "<f4").reshape(-1, 4)
    points[:, 1] = np.nan
    points.tofile(scan)
    refusal = {"status": 413, "content_type": "text/html", "body": "<html><h1>413 Request Entity Too Large</h1></html>"}
    at = re.compile(r"/api/v1/drives/\w+/(files|scans)")
    upload.page.route(at, lambda route: route.fulfill(**refusal))
    watch.expect("413")
    upload.pick(drive)
    upload.choose("Everything as it is")
    upload.press("Upload and run")
    proxy = "A reverse proxy between this browser and the service takes no request of this size"
    upload.page.get_by_text(proxy).wait_for()
    upload.page.unroute(at)
    watch.excuse("status of 4(09|22)")
    upload.press("Try again")
    told = upload.page.locator("#panel-upload .note.error", has_text="velodyne/000010.bin").first
    told.wait_for()
    assert "not finite" in told.inner_text()
    assert "job=" not in address_of(upload.page)


def test_a_folder_that_the_service_cannot_look_into_is_not_sent(upload: Upload, watch: Watch, street: Path) -> None:
    watch.expect("ERR_FAILED")
    upload.page.route("**/drives/look", lambda route: route.abort())
    upload.pick(street)
    assert "The server does not answer." in upload.text()
    upload.page.unroute("**/drives/look")


def test_one_of_several_drives_is_chosen(upload: Upload, street: Path, tmp_path: Path) -> None:
    for name in ("00", "07"):
        shutil.copytree(street, tmp_path / "sequences" / name, ignore=shutil.ignore_patterns("geo.csv"))
    (tmp_path / f"sequences/07/velodyne/{SCANS - 1:06d}.bin").unlink()
    upload.pick(tmp_path)
    assert "2 drives are in the folder" in upload.text()
    upload.page.get_by_label("2 drives are in the folder").select_option(label=f"sequences/07 ({SCANS - 1} scans)")
    upload.page.wait_for_selector(f"text={SCANS - 1} scans, 0 to {SCANS - 2}")
    assert upload.page.input_value(".upload-form input[type=text]") == "07"
    placing = upload.page.get_by_label("Place the drive on the map by its roads")
    assert placing.is_checked()  # since it has no GNSS
    refusal = upload.page.get_by_text("This drive has no GNSS: place it on the map")
    placing.uncheck()
    assert refusal.is_visible()
    placing.check()
    assert refusal.is_hidden()


def test_settings_labels_and_maps_of_the_form_reach_the_job(
    upload: Upload, uploads: ServerProcess, street: Path, tmp_path: Path
) -> None:
    drive = Path(shutil.copytree(street, tmp_path / "own"))
    (drive / "labels").rename(tmp_path / "network")
    (drive / "map.osm").rename(tmp_path / "city.osm")
    (drive / "geo.csv").rename(tmp_path / "fixes.csv")
    upload.pick(drive)
    assert upload.page.get_by_role("button", name="Upload and run").is_disabled()
    upload.choose("With label files of mine")
    upload.page.set_input_files("input[name=prediction-folder]", tmp_path / "network")
    upload.open_all()
    upload.page.set_input_files("input[name=georeference-file]", tmp_path / "fixes.csv")
    upload.choose("A file of mine")
    run, only = (upload.page.get_by_role("button", name=name) for name in ("Upload and run", "Upload only"))
    (tmp_path / "far.osm").write_text((tmp_path / "city.osm").read_text().replace('lat="49.', 'lat="44.'))
    upload.page.set_input_files("input[name=osm-file]", tmp_path / "far.osm")
    upload.page.get_by_text("far.osm lies elsewhere: it covers nothing of the drive.").wait_for()
    assert run.is_disabled()
    assert only.is_enabled()
    upload.choose("Place the drive on the map by its roads")
    assert run.is_enabled()
    upload.page.get_by_label("Place the drive on the map by its roads").uncheck()
    assert run.is_disabled()
    upload.page.set_input_files("input[name=osm-file]", tmp_path / "city.osm")
    upload.page.get_by_label("Preset").first.select_option("paper")
    upload.page.get_by_label("Side of a cell").fill("0.25")
    upload.page.get_by_label("Distance between keyframes").fill("4")
    upload.press("Upload and run")
    job = uploads.client.get(f"{API}/jobs/{upload.job()}").raise_for_status().json()
    request = job["request"]
    assert request["preset"] == "paper"
    assert request["config"]["bev"]["resolution_m"] == 0.25
    assert request["config"]["bev"]["min_points"] == 5  # as the preset "paper" has it
    assert request["config"]["keyframes"]["distance_m"] == 4
    assert request["labels"] == "predictions"
    assert request["osm"] == {"file": "city.osm"}
    found = files_of(uploads.client, job["drive_id"])
    assert "georeference/fixes.csv" in found
    used = SCANS // 2  # every second scan: more than 4 m
    assert sum(path.startswith("ground/predictions/") for path in found) == used
    uploads.client.delete(f"{API}/jobs/{job['id']}").raise_for_status()
