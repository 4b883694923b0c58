"""A look at a folder that is not on the service: what it answers, and what it refuses."""

import base64
from pathlib import Path
from typing import Any

import httpx

from interloc.config import KeyframeConfig
from interloc.reduction.look import look_into
from interloc.reduction.reduce import reduce_drive
from tests.app.conftest import Serve
from tests.app.processes import files_below
from tests.app.street import write_street

LOOK = "/api/v1/drives/look"
MB = 1024**2


def told(root: Path) -> dict[str, Any]:
    """What a client tells of a folder."""
    paths = {path.relative_to(root).as_posix(): path for path in root.rglob("*") if path.is_file()}
    small = {name: path.read_bytes() for name, path in paths.items() if path.suffix in {".txt", ".csv"}}
    return {
        "name": root.name,
        "files": {name: path.stat().st_size for name, path in paths.items()},
        "contents": {name: base64.b64encode(data).decode() for name, data in small.items()},
    }


def test_the_service_answers_what_the_library_finds_and_keeps_nothing(serve: Serve, tmp_path: Path) -> None:
    client = serve(tmp_path / "data")
    street = write_street(tmp_path / "street", 8)
    answer = client.post(LOOK, json=told(street))
    assert answer.status_code == 200
    contents = {name: (street / name).read_bytes() for name in ("poses.txt", "times.txt", "geo.csv")}
    expected = look_into(told(street)["files"], contents, "street")
    assert answer.json() == expected.model_dump(mode="json")
    assert answer.json()["drive"]["problems"] == []
    assert client.get("/api/v1/drives").json()["drives"] == []
    assert files_below(tmp_path / "data/incoming") == []


def test_what_is_too_large_for_the_service_is_named_with_its_setting(serve: Serve) -> None:
    client = serve(max_file_bytes=1 * MB, max_recording_bytes=2 * MB, max_drive_bytes=3 * MB, max_drive_files=4)

    def problems(files: dict[str, int]) -> list[str]:
        found = client.post(LOOK, json={"name": "a", "files": files}).json()["drive"]["problems"]
        return [f"{each['path']} {each['message']}" for each in found]

    (recording,) = problems({"a.mcap": 2 * MB + 1})
    assert recording == (
        "a.mcap is too large: it has 2.1 MB; the service takes files of 2.1 MB at most (INTERLOC_MAX_RECORDING_BYTES). "
        "Split the recording."
    )
    assert "INTERLOC_MAX_FILE_BYTES" in problems({"a.pcd": MB + 1, "poses.txt": 0})[0]
    assert "files are too large together" in problems({"a_0.mcap": 2 * MB, "a_1.mcap": 2 * MB})[0]
    (many,) = problems({f"velodyne/{frame:06d}.bin": 16 for frame in range(5)})
    assert many.startswith("files 5 are too many; expected at most 4")


def test_names_that_lead_elsewhere_are_left_out(client: httpx.Client) -> None:
    files = {"velodyne/000000.bin": 16, "../../velodyne/000001.bin": 16, "/etc/velodyne/0.bin": 16, "a\\b/geo.csv": 3}
    look = client.post(LOOK, json={"name": "a", "files": files}).json()
    assert [each["root"] for each in look["drives"]] == [""]
    assert look["drive"]["scans"]["count"] == 1
    assert "3 are left out for their names" in look["drive"]["problems"][-1]["message"]


def test_a_listing_may_be_larger_than_other_bodies(client: httpx.Client) -> None:
    files = {f"07/velodyne/{frame:06d}.bin": 160 for frame in range(50_000)}
    assert client.post(LOOK, json={"name": "a", "files": files}).json()["drive"]["scans"]["count"] == 50_000
    answer = client.post(LOOK, content=b" " * (32 * MB + 1), headers={"Content-Type": "application/json"})
    assert answer.status_code == 413


def test_a_client_that_reduces_is_told_what_to_send_and_what_its_labels_mean(
    client: httpx.Client, tmp_path: Path
) -> None:
    street = write_street(tmp_path / "street", 8)
    counts = {"labels": {"40": 50, "48": 30, "70": 20}}
    look = client.post(LOOK, json={**told(street), "label_counts": counts}).raise_for_status().json()["drive"]
    assert (look["plan"]["scans"], look["plan"]["kept"]) == (8, [[0, 8]])
    labels = look["labels"]["labels"]
    assert (labels["scheme"], labels["road_share"], labels["ground_share"]) == ("semantickitti", 0.5, 0.8)
    whole = reduce_drive(street, tmp_path / "reduced", keyframes=KeyframeConfig()).model_dump(mode="json")
    (written,) = look["plan"]["manifest"].pop("labels")
    assert written["counts"] == counts["labels"]
    assert written["label_bytes"] == whole.pop("labels")[0]["label_bytes"]
    assert look["plan"]["manifest"] == whole
