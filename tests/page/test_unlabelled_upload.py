"""Uploads of drives that only the service can read or label: sent as they are, labelled there, or refused in words."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.app.processes import API, ServerProcess, ended
from tests.page.browsers import Browser, Watch, needs_page
from tests.page.canvas import NOTE_PATHS
from tests.page.results import SHORT as SCANS
from tests.page.results import Done
from tests.page.uploads import Upload, drive_of
from tests.street_points import poses_along, seen, write_scans
from tests.street_points import street as street_points

pytestmark = needs_page


@pytest.fixture(scope="module")
def unlabelled(tmp_path_factory: pytest.TempPathFactory, street: Path) -> Path:
    root = Path(shutil.copytree(street, tmp_path_factory.mktemp("unlabelled") / "07"))
    shutil.rmtree(root / "labels")
    return root


def test_a_drive_without_labels_is_labelled_by_the_service(
    upload: Upload, uploads: ServerProcess, unlabelled: Path
) -> None:
    upload.pick(unlabelled)
    assert upload.page.get_by_label("By the network flat, on the service").is_checked()
    assert "The service makes the labels, so the scans are sent whole: all" in upload.text()
    assert "range image of 32 \N{MULTIPLICATION SIGN} 256" in upload.text()
    upload.choose("With label files of mine")
    assert "Expected one .label file per scan" in upload.text()
    assert upload.page.get_by_role("button", name="Upload and run").is_disabled()
    upload.choose("By the network flat, on the service")
    spacing = upload.page.get_by_label("Distance between keyframes")
    spacing.fill("1")
    assert upload.page.get_by_text("The service labels the keyframes of 2 m and 5°").is_visible()
    assert upload.page.get_by_role("button", name="Upload and run").is_disabled()
    spacing.fill("2")
    upload.press("Upload and run")
    job = ended(uploads.client, upload.job())
    assert job["state"] == "successful", job["error"]
    assert job["request"]["labels"] == "predictions"
    drive = drive_of(uploads.client, job["id"])
    assert drive["options"]["model"] == "flat"
    assert drive["report"]["label_folder"] == "network flat"
    assert sum(path.endswith(".bin") for path in upload.sent) == SCANS

    Upload(upload.page, uploads.address).pick(unlabelled)  # the time is known now


def test_a_recording_shows_its_topics_and_its_limit(upload: Upload, tmp_path: Path) -> None:
    upload.page.evaluate(
        """() => {
            const dataTransfer = new DataTransfer();
            dataTransfer.items.add(new File([new Uint8Array(40000)], "town.mcap"));
            dispatchEvent(new DragEvent("drop", { dataTransfer, cancelable: true }));
        }"""
    )
    upload.page.wait_for_selector(".upload-form")
    form = upload.page.locator(".upload-form")
    assert "ROS bag" in upload.text()
    assert "the fixes in the bag, if it has any" in upload.text()
    assert upload.page.input_value(".upload-form input[type=text]") == "town"
    form.get_by_text("How the files are read").click()
    form.get_by_label("Topic of the scans").fill("velodyne_points")
    assert form.get_by_text("Topic of the scans: write it as /").is_visible()
    form.get_by_label("Topic of the scans").fill("/velodyne_points")
    assert form.get_by_role("button", name="Upload only").is_enabled()
    upload.choose_another()
    for name in ("town.laz", "track.csv"):
        (tmp_path / name).write_bytes(bytes(60_000))
    upload.page.set_input_files("input[name=files]", [tmp_path / "town.laz", tmp_path / "track.csv"])
    upload.page.wait_for_selector(".upload-form")
    assert "town.laz is too large" in upload.text()
    assert "INTERLOC_MAX_RECORDING_BYTES" in upload.text()
    assert form.get_by_role("button", name="Upload only").is_disabled()

    upload.choose_another()
    bare = tmp_path / "bare"
    bare.mkdir()
    header = "VERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 1\nHEIGHT 1\n"
    (bare / "000000.pcd").write_text(f"{header}POINTS 1\nDATA binary\n{'0' * 16}")
    (bare / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    upload.pick(bare)
    assert upload.page.get_by_label("By the network flat, on the service").is_checked()
    assert form.get_by_role("button", name="Upload only").is_enabled()
    upload.choose("With label files of mine")
    assert "000000.pcd has no label: its fields are x, y, z, intensity." in re.sub(r"\s+", " ", upload.text())
    assert form.get_by_role("button", name="Upload only").is_disabled()


def test_scans_alone_make_a_drive_on_a_service_without_networks(browser: Browser, done: Done, tmp_path: Path) -> None:
    pytest.importorskip("small_gicp", reason="poses from points need small_gicp")
    scans = [seen(street_points(), pose) for pose in poses_along(np.full(5, 1.5), turn_rad=0.02)]
    upload = Upload(browser.kept_page(NOTE_PATHS), done.server.address)
    upload.pick(write_scans(tmp_path / "alone", scans))
    assert upload.page.get_by_label("By geometry, on the service").is_checked()
    assert "Needs no labels" in upload.text()
    assert "they are computed from the points" in upload.text()
    upload.choose("No map")
    upload.press("Upload and run")
    job = ended(done.server.client, upload.job())
    upload.close()
    assert job["state"] == "successful", job["error"]
    assert job["request"]["labels"] == "geometry"
    report = drive_of(done.server.client, job["id"])["report"]
    assert report["pose_frame_reason"] == "odometry over the points of 6 scans"
    assert report["label_folder"] == "geometry"

    # All ground of this street is flat and alike: the page says along how much of it the labels are doubtful.
    upload.page.wait_for_selector("#panel-result .badge.good")
    doubts = upload.page.locator("#panel-result .note", has_text="Labels doubtful")
    ((start, stop),) = job["summary"]["doubtful_labels_m"]
    assert f"{start:.0f} to {stop:.0f} m of the track" in doubts.inner_text()


def test_a_refused_archive_leaves_nothing(upload: Upload, uploads: ServerProcess, watch: Watch) -> None:
    watch.expect("status of 415")
    torn = {"name": "torn.zip", "mimeType": "application/zip", "buffer": bytes(4000)}
    upload.page.set_input_files("input[name=files]", torn)
    upload.press("Upload only")
    upload.page.locator("#panel-upload .note.error").wait_for()
    assert "torn" not in uploads.client.get(f"{API}/drives").text
    upload.press("Back")
