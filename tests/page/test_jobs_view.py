"""Jobs as a person meets them: run again with what they were, named, compared; drives that are watched as they grow."""

import re
import secrets
import threading
from functools import partial
from typing import Any

from interloc.client.live import LiveSender
from interloc.config import DetectorConfig
from interloc.drives.folder import FolderDrive
from tests.app.processes import API
from tests.crossing import paused
from tests.live.conftest import config, crossing
from tests.page.browsers import needs_page
from tests.page.results import Done, address_of, look_again, visit

pytestmark = needs_page


def run(page: Any) -> str:
    """Press the button of the dialog, and wait for the end; returns the id of the job."""
    page.get_by_role("button", name="Run", exact=True).click()
    page.wait_for_selector("dialog", state="detached")
    page.wait_for_selector("#panel-result .badge.good")
    page.wait_for_selector(".legend:visible")
    found = re.search(r"job=(\w+)", address_of(page))
    assert found
    return found[1]


def test_a_drive_is_run_again_with_a_map_and_the_job_named_and_compared(page: Any, done: Done) -> None:
    client = done.server.client
    drive = client.get(f"{API}/jobs/{done.job}").json()["drive_id"]
    visit(page, done.server.address)
    cards = page.locator("article.drive", has=page.get_by_role("button", name="street", exact=True))
    cards.last.get_by_role("button", name="Run street").click()  # the newest are first, and others may be of this name
    page.get_by_role("combobox", name=re.compile("^Preset")).select_option("paper")
    choices = page.locator("dialog label.check")
    choices.filter(has_text="No map").locator("input").check()
    first = run(page)
    assert first not in {done.job, done.local_job}
    summary = client.get(f"{API}/jobs/{first}").json()["summary"]
    page.locator("#panel-result summary", has_text="How it was made").click()
    assert re.search(rf"Detections\s+{summary['detections']}\s", page.inner_text("#panel-result"))
    assert "paper" in page.inner_text("#panel-result")

    page.locator("#panel-result").get_by_role("button", name="Run again with a map…").click()
    assert choices.filter(has_text="map.osm").locator("input").first.is_checked()
    choices.filter(has_text="A file of mine").locator("input").check()
    page.set_input_files("dialog input[name=osm-file]", done.short / "map.osm")
    again = run(page)
    before, after = (client.get(f"{API}/jobs/{each}").json()["request"] for each in (first, again))
    assert after == before | {"osm": {"file": "map-2.osm"}}

    assert page.inner_text(".job-title") == "paper, drive, map-2.osm"
    page.get_by_role("button", name="Rename this job").click()
    page.get_by_label("Name", exact=True).fill("coarse")
    page.get_by_label("Note", exact=True).fill("Two\nlines")
    page.get_by_role("button", name="Save").click()
    page.locator(".job-title", has_text="coarse").wait_for()
    assert page.inner_text("#panel-result .noted") == "Two\nlines"
    assert page.title().split()[0] == "coarse"

    page.get_by_role("button", name="Pin this result", exact=True).click()
    page.get_by_role("button", name="No longer pin this result").wait_for()
    assert client.get(f"{API}/drives/{drive}").json()["pinned_job"] in address_of(page)
    page.get_by_role("button", name="No longer pin this result").click()

    page.get_by_role("button", name="Compare", exact=True).click()
    page.locator(f"#compare-{done.job}").check()
    page.get_by_role("heading", name="What was asked for").wait_for()
    assert address_of(page).endswith(f"&compare={done.job}")
    heads = page.locator("#panel-compare .wide-table").first.locator("th").all_inner_texts()
    assert [head.split("\n")[0] for head in heads] == ["Figure", "coarse", "default, drive"]
    asked = f"{API}/compare?jobs={address_of(page).rpartition('job=')[2].partition('&')[0]},{done.job}"
    right = next(each for each in client.get(asked).json()["figures"] if each["name"] == "map_right")
    row = page.locator("#panel-compare tr", has_text="Intersections right").locator("td").all_inner_texts()
    assert row[1:] == [str(each) for each in right["values"]]

    client.patch(f"{API}/jobs/{done.job}", json={"name": "of another tab"}).raise_for_status()
    look_again(page)
    page.locator(".others", has_text="of another tab").wait_for()
    client.patch(f"{API}/jobs/{done.job}", json={"name": None}).raise_for_status()


def new_drive(done: Done, name: str) -> str:
    drive = done.server.client.post(f"{API}/drives", json={"name": name}).raise_for_status().json()["id"]
    done.server.client.put(f"{API}/drives/{drive}/files/poses.txt", content=b"1").raise_for_status()
    return str(drive)


def answer(page: Any, button: str) -> None:
    page.locator("dialog[open]").get_by_role("button", name=button).click()


def delete(page: Any, name: str) -> None:
    page.get_by_role("button", name=f"Delete {name}", exact=True).dispatch_event("click")  # the list is drawn anew
    assert "restored from the trash for 3 days" in page.locator("dialog[open]").inner_text()
    answer(page, "Delete the drive")


def test_a_deleted_drive_is_restored_or_goes_for_good(page: Any, done: Done) -> None:
    later, never = (f"{each} {secrets.token_hex(4)}" for each in ("kept", "gone"))  # no others, if tried again
    kept, gone = new_drive(done, later), new_drive(done, never)
    visit(page, done.server.address, "panel=drives")
    look_again(page)
    trash = page.locator("details.trash")
    delete(page, later)
    delete(page, never)
    trash.locator("summary").click()
    trash.get_by_role("button", name=f"Restore {later}").click()
    page.get_by_role("button", name=f"Delete {later}", exact=True).wait_for()
    assert done.server.client.get(f"{API}/drives/{kept}").json()["files"] == 1
    trash.get_by_role("button", name="Empty the trash").click()
    answer(page, "Keep")
    assert trash.get_by_text(never).is_visible()
    trash.get_by_role("button", name="Empty the trash").click()
    answer(page, "Empty the trash")
    trash.wait_for(state="hidden")
    assert done.server.client.get(f"{API}/trash").json()["items"] == []
    assert done.server.client.post(f"{API}/trash/drives/{gone}/restore").status_code == 404
    assert done.server.client.delete(f"{API}/drives/{kept}?purge=true").status_code == 204


__all__ = ["config", "crossing"]


def test_a_drive_is_watched_as_it_grows(page: Any, done: Done, crossing: FolderDrive, config: DetectorConfig) -> None:
    is_half_way, go_on = threading.Event(), threading.Event()
    scans = partial(paused, crossing, config, 16, lambda: (is_half_way.set(), go_on.wait(60)))
    name = f"a street, live {secrets.token_hex(4)}"  # no other session has, if this is not the first try
    begin = {"name": name, "config": config.model_dump(mode="json")}
    sender = LiveSender(done.server.address, None, begin, lambda _: None, keeps_all=True)
    thread = threading.Thread(target=lambda: sender.run(scans), daemon=True)
    thread.start()
    assert is_half_way.wait(60)
    visit(page, done.server.address, "panel=drives")
    page.get_by_role("button", name=name).click()
    note = page.locator(".stage-note")
    note.get_by_text("16 keyframes").wait_for()
    half = page.locator("#map").screenshot()
    go_on.set()
    note.get_by_text("48 keyframes · 1 intersection, 0 unsure · It has ended.").wait_for()
    thread.join(60)
    assert page.locator("#map").screenshot() != half
    link = address_of(page)  # to pass on
    visit(page, done.server.address, "panel=upload")
    note.get_by_text("48 keyframes").wait_for(state="hidden")
    visit(page, done.server.address, link.partition("#")[2])
    note.get_by_text("48 keyframes · 1 intersection, 0 unsure · It has ended.").wait_for()
