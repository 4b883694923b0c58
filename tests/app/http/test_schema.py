"""The API keeps to its own description, whatever is sent: no 5xx, no status, header or body that is not described.

What takes seconds is made when the tests run, by the one process that runs them: every process of the tests imports
this.
"""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
import requests
from hypothesis import HealthCheck, settings

from app.main import create_app
from app.settings import Settings
from interloc.output.layers import LAYERS
from tests.app.conftest import running_server
from tests.app.processes import API, NO_TLS

SHARES = 8  # of the operations, each a test
# One function serves all layers, one all exports, and the addresses of all sources of features are alike.
ALIKE = (
    *(f"read_{name}" for name in LAYERS if name not in {"intersections", "osm_roads", "trajectory"}),
    r"export_(?!csv|qgz)\w+",
    r"read_(job|map)_ogc(?!_items)\w*",
)
LEFT_OUT = f"^({'|'.join(('make_demo_drive', *ALIKE))})$"  # the first takes a minute
EFFORT = settings(max_examples=3, suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def schema() -> Any:
    import schemathesis  # noqa: PLC0415

    description = deepcopy(create_app(Settings()).openapi())  # all applications of a process share it
    # Tried as those of a new drive.
    del description["components"]["schemas"]["CommitRequest"]["properties"]["options"]

    @schemathesis.serializer("application/gzip", "application/x-tar", "application/zip", "application/zstd")
    def as_they_are(_: object, value: object) -> bytes:
        """Send what was generated as the bytes of an archive."""
        return value if isinstance(value, bytes) else str(value).encode()

    return schemathesis.openapi.from_dict(description).exclude(operation_id_regex=LEFT_OUT)


@dataclass(frozen=True)
class Target:
    """A server, and what is there: an open drive, a ready one, a job of it that has ended well."""

    address: str
    session: requests.Session
    open_drive: str
    ready_drive: str
    job: str


@pytest.fixture(scope="module")
def target(street: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Target]:
    with (
        running_server(tmp_path_factory.mktemp("data")) as address,
        httpx.Client(base_url=f"{address}{API}", timeout=120, verify=NO_TLS) as client,
    ):
        drives = [client.post("/drives", json={"name": name}).json()["id"] for name in ("open", "ready")]
        for drive in drives:
            files = [(str(path.relative_to(street)), path.read_bytes()) for path in street.rglob("*") if path.is_file()]
            assert client.post(f"/drives/{drive}/scans", files=[("files", file) for file in files]).status_code == 200
        assert client.post(f"/drives/{drives[1]}/commit").json()["state"] == "ready"
        order = {"drive_id": drives[1], "osm": {"file": "map.osm"}}
        job = client.post("/jobs", json=order).json()["id"]
        assert "event: job" in client.get(f"/jobs/{job}/events").text  # it ends with the job
        assert client.get(f"/jobs/{job}").json()["state"] == "successful"
        with requests.Session() as session:
            session.trust_env = False  # no proxies are looked for at each request
            yield Target(address, session, *drives, job)


@pytest.mark.parametrize("share", range(SHARES))
def test_operations_do_what_they_say(share: int, schema: Any, target: Target) -> None:
    from schemathesis.generation.hypothesis.builder import HypothesisTestConfig, HypothesisTestMode, create_test  # noqa: PLC0415

    config = HypothesisTestConfig(schema.config, list(HypothesisTestMode), explicit_settings=EFFORT)
    for operation in [result.ok() for result in schema.get_all_operations()][share::SHARES]:
        create_test(operation=operation, test_func=send, config=config)(target=target, sent=set())


def send(case: Any, target: Target, sent: set[str]) -> None:
    """Send a case as it is, and once more to what is there, but nothing that was `sent` before."""
    generated, known = case.path_parameters, case.path_parameters
    if generated and not (case.method == "DELETE" and case.path.endswith("_id}")):
        # Generated parameters nearly always lead nowhere.
        places = {
            "drive_id": target.ready_drive if case.method == "GET" else target.open_drive,
            "job_id": target.job,
            "name": "run.json" if "/jobs/" in case.path else "paper",
            "path": "poses.txt",
            "frame": 20,
        }
        known = {name: places.get(name, value) for name, value in generated.items()}
    # What leads nowhere is asked for once: the rest of a request makes a difference before the place is looked up,
    # thus for all places alike, or where there is one. A method that the operation does not have is refused anywhere.
    nowhere = repr((case.method, generated))
    is_foreign = case.method != case.operation.method.upper()
    if known == generated or not (is_foreign or nowhere in sent):
        call(case, target)
        sent.add(nowhere)
    case.path_parameters = known
    whole = repr((case.method, known, case.query, case.headers, case.cookies, case.media_type, case.body))
    if known != generated and whole not in sent:
        call(case, target)
        sent.add(whole)


def call(case: Any, target: Target) -> None:
    """Send a case and check the answer."""
    from schemathesis import checks  # noqa: PLC0415

    every: list[Any] = [
        checks.not_a_server_error,
        checks.status_code_conformance,
        checks.content_type_conformance,
        checks.response_schema_conformance,
        checks.response_headers_conformance,
    ]
    case.call_and_validate(base_url=target.address, session=target.session, checks=every, timeout=60)
