"""The description of the API is whole, and the API keeps to it, whatever is sent."""

import json
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
import requests
from fastapi.routing import APIRoute
from hypothesis import HealthCheck, settings
from openapi_spec_validator import OpenAPIV31SpecValidator
from pydantic import SecretStr

from app.http.openapi import UNLISTED
from app.http.problem_types import TYPES
from app.main import ROUTES, create_app
from app.settings import Settings
from interloc.output.layers import LAYERS
from tests.app.conftest import running_server
from tests.app.processes import API, NO_TLS

MEDIA_TYPE = "application/problem+json"
Operation = dict[str, Any]


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return create_app(Settings()).openapi()


def operations(document: dict[str, Any]) -> Iterator[tuple[str, Operation]]:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield f"{method.upper()} {path}", operation


def test_every_error_is_a_problem_document(document: dict[str, Any]) -> None:
    for name, operation in operations(document):
        if name.partition(" ")[2].startswith("/api/"):
            assert operation["security"] == [{}, {"token": []}], name  # this service needs no token
        for status in ("4XX", "5XX"):
            assert list(operation["responses"][status]["content"]) == [MEDIA_TYPE], name


def test_a_service_with_tokens_says_so() -> None:
    own = SecretStr("the-token-of-the-operator")
    for closed in (Settings(token=own), Settings(host="10.0.0.1")):
        document = create_app(closed).openapi()
        secured = {name: operation.get("security") for name, operation in operations(document)}
        assert [security for security in secured.values() if security != [{"token": []}]] == []


def test_the_document_is_valid_for_its_version(document: dict[str, Any]) -> None:
    assert document["openapi"].startswith("3.1.")
    assert [str(error) for error in OpenAPIV31SpecValidator(json.loads(json.dumps(document))).iter_errors()] == []


def test_every_kind_of_problem_is_listed(client: httpx.Client, document: dict[str, Any]) -> None:
    told = document["components"]["schemas"]["ProblemDocument"]["properties"]["type"]["description"]
    assert [name for name in TYPES if name not in told] == []
    assert client.get("/api/v1/drives/nowhere").json()["type"] == "/problems/drive-not-found"
    assert client.get("/api/v1/nothing").json()["type"] == "about:blank"


def test_what_others_call_is_described(document: dict[str, Any]) -> None:
    """Only what the page alone calls, what describes itself, and HEAD of what can be got are not."""
    assert 35 <= len(list(operations(document))) <= 60
    hidden = {
        route.path
        for route in ROUTES
        if isinstance(route, APIRoute) and not route.include_in_schema and route.methods != {"HEAD"}
    }
    of_page = {"/", "/static/{path:path}", "/docs", "/docs/start.js", "/config.json", "/healthz", "/readyz", "/metrics"}
    assert not {path for path in hidden - of_page if not UNLISTED.fullmatch(path)}


def test_the_document_is_served_under_the_root_path(serve_all: Any) -> None:
    client: httpx.Client = serve_all(root_path="/interloc")
    for path in ("/openapi.json", "/interloc/openapi.json"):
        answer = client.get(path)
        assert answer.status_code == 200
        assert answer.json()["servers"] == [{"url": "/interloc"}]
    created = client.post("/interloc/api/v1/drives", json={"name": "a"})
    assert created.headers["location"] == f"/interloc/api/v1/drives/{created.json()['id']}"


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

    chosen = [HypothesisTestMode.EXAMPLES, HypothesisTestMode.COVERAGE]  # nothing random: what is found is found again
    config = HypothesisTestConfig(schema.config, chosen, explicit_settings=EFFORT)
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
