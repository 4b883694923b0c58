"""Pages of other sites cannot use the service through the browser of its user."""

import httpx
import pytest

from tests.app.conftest import Serve

DRIVES = "/api/v1/drives"
OWN = "the-token-of-the-operator"


@pytest.mark.parametrize("host", ["localhost", "localhost:8000", "127.0.0.1:1", "127.1.2.3", "[::1]:80", "a.localhost"])
def test_names_of_this_machine_are_answered(client: httpx.Client, host: str) -> None:
    assert client.get(DRIVES, headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "host",
    ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example:8000", "192.0.2.1", "", "[::1", "10.0.0.1"],
)
@pytest.mark.parametrize("path", [DRIVES, "/", "/config.json", "/metrics"])
def test_other_names_are_not(client: httpx.Client, host: str, path: str) -> None:
    answer = client.get(path, headers={"Host": host})
    assert answer.status_code == 421
    assert answer.json()["title"] == "Unknown host name"
    assert client.get("/healthz", headers={"Host": host}).status_code == 200


def test_a_name_can_be_allowed(serve: Serve) -> None:
    client = serve(allowed_hosts="maps.example, lidar.example")
    assert client.get(DRIVES, headers={"Host": "Maps.Example:443"}).status_code == 200
    assert client.get(DRIVES, headers={"Host": "evil.example"}).status_code == 421


def test_with_tokens_any_name_will_do(serve: Serve) -> None:
    """A page that points its name here has no token to send."""
    client = serve(token=OWN)
    headers = {"Host": "evil.example", "Authorization": f"Bearer {OWN}"}
    assert client.get(DRIVES, headers=headers).status_code == 200


FOREIGN = [
    {"Sec-Fetch-Site": "cross-site", "Origin": "https://evil.example"},
    {"Sec-Fetch-Site": "same-site", "Origin": "http://localhost:3000"},
    {"Origin": "https://evil.example"},
    {"Origin": "null"},
    {"Origin": "http://[::1"},
]
OURS = [{}, {"Sec-Fetch-Site": "same-origin", "Origin": "https://shown.example"}, {"Sec-Fetch-Site": "none"}]


@pytest.mark.parametrize("headers", FOREIGN)
def test_other_origins_change_nothing(client: httpx.Client, headers: dict[str, str]) -> None:
    assert client.post(DRIVES, json={"name": "a"}, headers=headers).status_code == 403
    assert client.put(f"{DRIVES}/0123456789abcdef/files/a", content=b"a", headers=headers).status_code == 403
    assert client.delete(f"{DRIVES}/0123456789abcdef", headers=headers).status_code == 403
    assert client.get(DRIVES, headers=headers).status_code == 200


@pytest.mark.parametrize("headers", OURS)
def test_the_page_and_programs_do(client: httpx.Client, headers: dict[str, str]) -> None:
    assert client.post(DRIVES, json={"name": "a"}, headers=headers).status_code == 201
    origin = str(client.base_url).rstrip("/")
    assert client.post(DRIVES, json={"name": "a"}, headers={"Origin": origin}).status_code == 201


def test_no_answer_lets_other_origins_read(client: httpx.Client) -> None:
    for method in ("GET", "OPTIONS"):
        asked = {"Origin": "https://evil.example", "Access-Control-Request-Method": "GET"}
        answer = client.request(method, DRIVES, headers=asked)
        assert not [name for name in answer.headers if name.startswith("access-control")]
    assert answer.status_code == 405


def test_headers_for_browsers(serve: Serve) -> None:
    client = serve(tile_url="https://{s}.tiles.example:8443/a/{z}/{x}/{y}.png")
    for path in ("/config.json", "/healthz", DRIVES, "/api/v1/nowhere", "/nowhere"):
        headers = client.get(path).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "strict-origin-when-cross-origin"
        assert headers["cross-origin-opener-policy"] == "same-origin"
        assert "server" not in headers
        assert "unsafe" not in headers["content-security-policy"]
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert (
        "img-src 'self' data: blob: https://*.tiles.example:8443;"
        in client.get("/nowhere").headers["content-security-policy"]
    )
    assert client.get(DRIVES).headers["cache-control"] == "private, no-cache"  # they have an ETag
    assert "sandbox" in client.get(DRIVES).headers["content-security-policy"]


def test_https_is_believed_of_a_trusted_proxy_alone(client: httpx.Client, serve: Serve) -> None:
    other = serve(trusted_proxies="192.0.2.1")
    for each, scheme in ((client, "https"), (other, "http")):
        landing = each.get("/ogc", headers={"X-Forwarded-Proto": "https"}).json()
        assert landing["links"][0]["href"].startswith(f"{scheme}://")
