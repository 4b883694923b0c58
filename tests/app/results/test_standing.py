"""Which of the jobs of a drive stands for it."""

import httpx

from app.store.models import Job
from tests.app.results.conftest import Finished


def test_a_pinned_job_stands_for_its_drive_else_the_best_does(finished: Finished) -> None:
    def shown() -> tuple[str | None, str | None]:
        drive = finished.get("/drives/street").raise_for_status().json()
        (listed,) = (each for each in finished.get("/drives").json()["drives"] if each["id"] == "street")
        assert listed["result_job"] == drive["result_job"]
        return drive["result_job"], drive["pinned_job"]

    def pin(job: str | None) -> httpx.Response:
        return finished.client.patch("/api/v1/drives/street", json={"pinned_job": job})

    assert shown()[0] == "lost", "the newest of those of one rank, though its files are gone"
    assert pin("paper").is_success
    assert shown() == ("paper", "paper")
    assert pin("failed").status_code == 409
    assert pin("elsewhere").status_code == 404, "it is of another drive"
    assert pin(None).json()["pinned_job"] is None
    scores = {"paper": {"map_f1": 1.0}, "default": {"map_f1": 0.5}, "plain": {"f1_at_5": 0.4}}
    with finished.changing() as session:
        for job, report in scores.items():
            session.get_one(Job, job).summary = {"georeferenced": True, "report": report}
    assert shown() == ("default", None), "paper comes after, whatever its score"
    with finished.changing() as session:
        for job in scores:
            session.get_one(Job, job).summary = None


def test_one_answer_holds_all_of_a_result_that_the_page_shows(finished: Finished) -> None:
    answer = finished.get("/jobs/default/view").raise_for_status()
    told = answer.json()
    assert told["job"] == finished.get("/jobs/default").json()
    assert told["run"] == finished.get("/jobs/default/files/run.json").json()
    assert told["report"] == finished.get("/jobs/default/report?format=json").json()
    for name in ("intersections", "trajectory", "osm_nodes", "matches"):
        assert told[name] == finished.get(f"/jobs/default/layers/{name}").json()
    assert finished.get("/jobs/default/view", headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
    local = finished.get("/jobs/local/view").raise_for_status().json()
    assert local["keyframes"] == finished.get("/jobs/local/files/keyframes.local.json").json()
    assert local["report"] is None
    assert finished.get("/jobs/failed/view").json()["run"] is None
    assert finished.get("/jobs/lost/view").status_code == 410
    assert finished.get("/jobs/nobody/view").status_code == 404
