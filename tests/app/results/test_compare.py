"""Jobs of one drive side by side."""

import json

import pytest

from tests.app.results.conftest import Finished


def test_two_presets_side_by_side(finished: Finished) -> None:
    answer = finished.get("/compare?jobs=default,paper")
    assert answer.status_code == 200
    told = answer.json()
    assert told["runs"] == ["default", "paper"]
    assert told["names"] == ["default, no map", "paper, no map"]
    assert not any(setting["is_own"] for setting in told["settings"])
    settings = {row["name"]: row["values"] for row in told["settings"]}
    assert settings["preset"] == ["default", "paper"]
    assert all(values[0] != values[1] for values in settings.values())
    reports = [json.loads((finished.results / job / "report.json").read_text()) for job in ("default", "paper")]
    figures = {row["name"]: row["values"] for row in told["figures"]}
    assert figures["ace_m"] == [report["ace_m"] for report in reports]
    assert figures["recall_at_5"] == [report["recall"]["5.0"] for report in reports]
    assert told["found_by_all"] + len(told["found_only_by"][0]) == reports[0]["nodes_found"]
    assert told["inputs"] == told["warnings"] == []


def test_other_labels_are_named_and_a_renamed_drive_is_the_same(finished: Finished) -> None:
    path = finished.data_dir / "jobs/paper/result/run.json"
    before = path.read_text()
    labels = json.loads(before)["labels"]
    path.write_text(json.dumps(json.loads(before) | {"labels": "network salsanext", "drive_name": "renamed"}))
    try:
        told = finished.get("/compare?jobs=default,paper").json()
    finally:
        path.write_text(before)
    assert told["inputs"] == [{"name": "labels", "values": [labels, "network salsanext"]}]
    assert told["warnings"] == []


def test_a_job_beside_itself_would_say_nothing(finished: Finished) -> None:
    for jobs in ("default", "default,default", "", ",", "a,b,c,d,e,f,g,h,i"):
        assert finished.get("/compare", params={"jobs": jobs}).status_code == 422
    assert finished.get("/compare").status_code == 422


@pytest.mark.parametrize(("jobs", "status", "title"), [
    ("default,elsewhere", 422, "Different drives"),
    ("default,plain", 404, "Not scored"),
    ("default,nobody", 404, "Job not found"),
    ("default,failed", 409, "Result not ready"),
])  # fmt: skip
def test_what_cannot_be_compared(jobs: str, status: int, title: str, finished: Finished) -> None:
    answer = finished.get("/compare", params={"jobs": jobs})
    assert (answer.status_code, answer.json()["title"]) == (status, title)
