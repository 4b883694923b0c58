"""The description of the API is whole: it is all that many will read of it."""

import json
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from fastapi.routing import APIRoute
from openapi_spec_validator import OpenAPIV31SpecValidator
from pydantic import SecretStr

from app.http.openapi import UNLISTED
from app.http.problem_types import TYPES
from app.main import ROUTES, create_app
from app.settings import Settings

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
    for settings in (Settings(token=own), Settings(host="10.0.0.1")):
        document = create_app(settings).openapi()
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
