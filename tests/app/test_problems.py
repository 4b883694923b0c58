"""Errors are problem documents."""

import httpx


def test_unknown_address_is_a_problem_document(client: httpx.Client) -> None:
    answer = client.get("/api/v1/nowhere")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["instance"] == "/api/v1/nowhere"
    assert answer.json()["status"] == 404
