"""The service behind nginx, as docs/service.md sets it up: on a port of its own, below a path."""

import json
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from websockets.sync.client import connect

from app.ogc.collections import OF_ALL
from tests.app.conftest import running_server
from tests.app.ogc.test_ogc import data
from tests.app.processes import NO_TLS, free_port

__all__ = ["data"]

NGINX = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin:/usr/local/sbin")
SERVICE = Path(__file__).parents[3] / "docs" / "service.md"

pytestmark = pytest.mark.skipif(NGINX is None, reason="nginx is not installed (apt install nginx-light)")


@contextmanager
def nginx(folder: Path, port: int, service: str, *changes: tuple[str, str]) -> Iterator[str]:
    """Run nginx with the block of the documentation; yields the address under which it shows the service."""
    (block,) = re.findall(r"```nginx\n(.*?)```", SERVICE.read_text(), re.DOTALL)
    block = replaced(block, ("http://127.0.0.1:8000/", f"{service}/"), *changes)
    with running_nginx(folder, port, f"server {{ listen 127.0.0.1:{port};\n{block}}}"):
        yield f"http://127.0.0.1:{port}/interloc"


def replaced(block: str, *changes: tuple[str, str]) -> str:
    for before, after in changes:
        assert before in block
        block = block.replace(before, after)
    return block


@contextmanager
def running_nginx(folder: Path, port: int, servers: str) -> Iterator[None]:
    """Run nginx with these blocks, of which one listens on the port."""
    kinds = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    temporary = " ".join(f"{kind}_temp_path {folder}/{kind};" for kind in kinds)
    (folder / "nginx.conf").write_text(
        f"daemon off; pid {folder}/pid; error_log {folder}/error.log; events {{}}\n"
        f"http {{ access_log off; {temporary}\n{servers}}}\n"
    )
    assert NGINX is not None, "nginx is not installed"
    command = [NGINX, "-c", f"{folder}/nginx.conf", "-p", str(folder), "-e", f"{folder}/error.log"]
    process = subprocess.Popen(command)
    try:
        while not answers(port):
            assert process.poll() is None, (folder / "error.log").read_text()
            time.sleep(0.02)
        yield
    finally:
        process.terminate()
        process.wait(10)


def answers(port: int) -> bool:
    with socket.socket() as asking:
        return asking.connect_ex(("127.0.0.1", port)) == 0


KEPT_PATH = ("/;", "/interloc/;")
"""The proxy leaves the path on."""

NO_PORT = ("$http_host", "$host")
"""What many recipes say."""


@pytest.mark.parametrize(
    ("changes", "by_url"), [((), False), ((), True), ((KEPT_PATH,), True), ((NO_PORT,), True)], ids=str
)
def test_links_begin_with_the_address_of_the_proxy_with_and_without_a_slash(
    data: Path, tmp_path: Path, changes: tuple[tuple[str, str], ...], by_url: bool
) -> None:
    port = free_port()
    address = f"http://127.0.0.1:{port}/interloc"
    settings = {"public_url": address} if by_url else {"root_path": "/interloc"}
    with (
        running_server(data, **settings) as service,
        nginx(tmp_path, port, service, *changes),
        httpx.Client(timeout=60, verify=NO_TLS) as client,
    ):
        for path in ("/ogc", "/api/v1/jobs/town-new/ogc", "/ogc/collections/detections/items?limit=3"):
            document = client.get(f"{address}{path}").raise_for_status().json()
            hrefs = [link["href"] for link in document["links"]]
            own = [href for href in hrefs if "opengis.net" not in href and "opendatacommons" not in href]
            assert own, path
            assert all(href.startswith(f"{address}/") for href in own), path
            with_slash = path.replace("?", "/?") if "?" in path else f"{path}/"
            answer = client.get(f"{address}{with_slash}")
            assert (answer.status_code, len(answer.json()["links"])) == (200, len(hrefs)), with_slash
        made = client.post(f"{address}/api/v1/drives/", json={"name": "new"})
        assert made.status_code == 201
        assert made.headers["location"].startswith("/interloc/api/v1/drives/")
        assert client.get(f"{address}/").status_code == 200


def test_live_sessions_pass(data: Path, tmp_path: Path) -> None:
    with (
        running_server(data, root_path="/interloc") as service,
        nginx(tmp_path, free_port(), service) as address,
        connect(f"{address.replace('http', 'ws', 1)}/api/v1/live", proxy=None) as socket,
    ):
        socket.send(json.dumps({"type": "begin", "name": "proxied"}))
        assert json.loads(socket.recv(60))["type"] == "session"


READ = """
import json, sys
import pyogrio
from owslib.ogcapi.features import Features

(address,) = sys.argv[1:]
pyogrio.set_gdal_config_options({"GDAL_HTTP_TIMEOUT": "30"})
found = {"layers": [name for name, _ in pyogrio.list_layers(f"OAPIF:{address}/ogc")]}
for slash in ("", "/"):
    found[f"gdal{slash}"] = len(pyogrio.read_dataframe(f"OAPIF:{address}/ogc{slash}", layer="detections"))
    service = Features(f"{address}/ogc{slash}")
    found[f"owslib{slash}"] = service.collection_items("detections", limit=5)["numberMatched"]
found["collections"] = service.feature_collections()
print(json.dumps(found))
"""


def test_gdal_and_owslib_read_through_it(data: Path, tmp_path: Path) -> None:
    port = free_port()
    with running_server(data, root_path="/interloc") as service, nginx(tmp_path, port, service) as address:
        command = [sys.executable, "-c", READ, address]
        found = json.loads(subprocess.run(command, check=True, capture_output=True, timeout=120).stdout)
        count = httpx.get(f"{address}/ogc/collections/detections/items?limit=1", verify=NO_TLS).json()["numberMatched"]
    assert found["layers"] == found["collections"] == list(OF_ALL)
    assert found["gdal"] == found["gdal/"] == found["owslib"] == found["owslib/"] == count
