"""A real PostgreSQL server for the tests, where its programs are installed; each test gets a database of its own."""

import atexit
import os
import pwd
import secrets
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import psycopg
import pytest

_USER = "nobody"  # PostgreSQL refuses to run as root


def _program(name: str) -> str | None:
    found = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return str(found[-1]) if found else shutil.which(name)


def _as_user() -> list[str]:
    return ["setpriv", f"--reuid={_USER}", "--clear-groups"] if os.geteuid() == 0 else []


@cache
def _server() -> str:
    """Start a server once; returns its address without a database."""
    initdb, postgres = _program("initdb"), _program("postgres")
    if initdb is None or postgres is None or (os.geteuid() == 0 and shutil.which("setpriv") is None):
        pytest.skip("PostgreSQL (initdb, postgres) is not installed on this machine")
    folder = Path(tempfile.mkdtemp(prefix="postgres-", dir="/tmp"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    if os.geteuid() == 0:
        os.chown(folder, pwd.getpwnam(_USER).pw_uid, -1)
    data = folder / "data"
    subprocess.run(
        [*_as_user(), initdb, "-D", str(data), "-U", "interloc", "--auth=trust", "--no-sync"],
        check=True,
        capture_output=True,
        cwd="/",
    )
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    options = ["-c", "fsync=off", "-c", "unix_socket_directories=", "-c", "max_connections=200"]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            [*_as_user(), postgres, "-D", str(data), "-p", str(port), "-h", "127.0.0.1", *options],
            stdout=log,
            stderr=log,
            cwd="/",
        )
    atexit.register(process.wait)
    atexit.register(process.terminate)
    address = f"postgresql://interloc@127.0.0.1:{port}"
    for _ in range(600):
        try:
            psycopg.connect(f"{address}/postgres").close()
        except psycopg.OperationalError:
            assert process.poll() is None, (folder / "log").read_text()
            time.sleep(0.05)
        else:
            return address
    raise AssertionError("PostgreSQL did not start: " + (folder / "log").read_text())


@contextmanager
def new_database() -> Iterator[str]:
    """Address of an empty database, which goes with the block."""
    server = _server()
    name = f"test_{secrets.token_hex(6)}"
    with psycopg.connect(f"{server}/postgres", autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name}")
    try:
        yield f"{server.replace('postgresql', 'postgresql+psycopg', 1)}/{name}"
    finally:
        with psycopg.connect(f"{server}/postgres", autocommit=True) as connection:
            connection.execute(f"DROP DATABASE {name} WITH (FORCE)")
