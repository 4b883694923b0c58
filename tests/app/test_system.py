"""Health, readiness, metrics; settings: the table of docs/service.md is true, and the environment is read."""

import sqlite3
from pathlib import Path
from typing import Any

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from app.settings import GB, MB, Settings
from app.store.models import Drive, Job
from tests.app.conftest import Serve, opened


def figures(text: str) -> dict[tuple[str, ...], float]:
    """Samples by name and labels, as Prometheus parses them."""
    return {
        (sample.name, *(f"{name}={value}" for name, value in sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_a_service_that_can_work_is_ready(client: httpx.Client) -> None:
    assert client.get("/healthz").json() == {"status": "ok"}
    answer = client.get("/readyz")
    assert (answer.status_code, answer.json()) == (200, {"ready": True, "reasons": {}})


def test_a_full_disk_is_not_ready_but_alive(serve: Serve) -> None:
    client = serve(min_free_bytes=1 << 60)
    answer = client.get("/readyz")
    assert answer.status_code == 503
    assert list(answer.json()["reasons"]) == ["disk"]
    assert "INTERLOC_MIN_FREE_BYTES" in answer.json()["reasons"]["disk"]
    assert client.get("/healthz").status_code == 200


def test_a_database_that_is_gone_is_not_ready(serve: Serve, tmp_path: Path) -> None:
    client = serve(tmp_path / "data")
    with sqlite3.connect(tmp_path / "data/interloc.sqlite3") as link:
        link.execute("DROP TABLE drive_files")
        link.execute("DROP TABLE jobs")
        link.execute("DROP TABLE drives")
    link.close()
    answer = client.get("/readyz")
    assert answer.status_code == 503
    assert "database" in answer.json()["reasons"]


def test_requests_are_counted_by_route(serve: Serve) -> None:
    client = serve()
    for name in ("a", "b"):
        drive = client.post("/api/v1/drives", json={"name": name}).json()["id"]
        assert client.get(f"/api/v1/drives/{drive}").status_code == 200
    client.put(f"/api/v1/drives/{drive}/files/poses.txt", content=bytes(1000))
    client.get("/api/v1/nowhere")
    client.request("BREW", "/api/v1/drives")
    found = figures(client.get("/metrics").text)
    count = "interloc_http_requests_total"
    assert found[count, "method=POST", "route=/api/v1/drives", "status=201"] == 2
    assert found[count, "method=GET", "route=/api/v1/drives/{drive_id}", "status=200"] == 2
    assert found[count, "method=GET", "route=(none)", "status=404"] == 1
    assert found["interloc_http_request_seconds_count", "method=POST", "route=/api/v1/drives"] == 2
    assert found["interloc_received_bytes_total",] >= 1000
    assert found["interloc_drives", "state=uploading"] == 2
    assert found["interloc_event_listeners",] == 0
    assert found["interloc_free_bytes",] > 0
    assert not [labels for labels in found if drive in str(labels)]


def test_jobs_are_counted_in_the_database(tmp_path: Path) -> None:
    with opened(tmp_path) as context:
        with context.database.writing() as session:
            now = context.database.clock(session)
            session.add(
                Drive(id="d", name="d", owner="a", state="ready", created_at=now, touched_at=now, stored_bytes=50)
            )
            session.flush()
            common = {"drive_id": "d", "owner": "a", "request": {}, "kind": "intersections"}
            session.add(Job(**common, state="accepted", created_at=now - 30))
            for seconds in (4.0, 6.0):
                times = {"created_at": now - 20, "started_at": now - 18, "finished_at": now - 18 + seconds}
                session.add(Job(**common, **times, state="successful"))
        found = figures(context.metrics.render(context.database, context.storage).decode())
    assert found["interloc_jobs", "kind=intersections", "state=successful"] == 2
    assert found["interloc_jobs", "kind=intersections", "state=accepted"] == 1
    assert found["interloc_oldest_waiting_job_seconds",] == pytest.approx(30, abs=10)
    assert found["interloc_queue_wait_seconds_sum", "kind=intersections"] == pytest.approx(4, abs=1e-3)
    assert found["interloc_job_seconds_count", "kind=intersections", "state=successful"] == 2
    assert found["interloc_job_seconds_sum", "kind=intersections", "state=successful"] == pytest.approx(10, abs=1e-3)
    assert found["interloc_stored_bytes", "state=ready"] == 50


SERVICE = Path(__file__).parents[2] / "docs" / "service.md"


def shown(name: str, value: Any) -> str:
    """A default as people read it."""
    if value in (None, "", ()):
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if name.endswith("_bytes"):
        return f"{value // GB} GB" if value % GB == 0 else f"{value // MB} MB"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def settings_table() -> str:
    """The table of all settings, for docs/service.md."""
    lines = ["| `INTERLOC_` | default | what |", "|---|---|---|"]
    for name, field in Settings.model_fields.items():
        assert field.description, f"{name} is not described"
        lines.append(f"| `{name.upper()}` | {shown(name, field.default)} | {field.description} |")
    return "\n".join(lines)


def test_the_documentation_lists_all_settings() -> None:
    assert settings_table() in SERVICE.read_text(), f"docs/service.md must hold\n{settings_table()}"


def test_settings_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INTERLOC_DATA_DIR", "/srv/interloc")
    monkeypatch.setenv("INTERLOC_TOKEN", "sixteen-letters-or-more")
    monkeypatch.setenv("INTERLOC_ROOT_PATH", "/interloc/")
    settings = Settings()
    assert settings.data_dir == Path("/srv/interloc")
    assert settings.sqlalchemy_url == "sqlite:////srv/interloc/interloc.sqlite3"
    assert settings.root_path == "/interloc"
    assert "sixteen" not in repr(settings)


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("localhost", True), ("10.0.0.1", False), ("::", False)],
)
def test_which_addresses_are_of_this_machine_only(host: str, loopback: bool) -> None:
    assert Settings(host=host).is_loopback is loopback
    assert not Settings(host="box.example").is_loopback
