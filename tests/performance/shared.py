"""What the scripts of this folder share: tables, new drives, the memory of a server."""

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress

import click
import httpx
import psutil

from tests.app.processes import API, ServerProcess

MB = 1024**2
Row = tuple[str, str]


def show(rows: Iterable[Row]) -> None:
    for name, value in rows:
        click.echo(f"{name:60}  {value}")


def new_drive(client: httpx.Client, name: str) -> str:
    return str(client.post(f"{API}/drives", json={"name": name}).raise_for_status().json()["id"])


@contextmanager
def sampled_memory(server: ServerProcess) -> Iterator[list[tuple[int, int, int]]]:
    """Resident bytes of a server, of its largest worker, and of all together, some times a second."""
    samples: list[tuple[int, int, int]] = []
    stop = threading.Event()

    def watch() -> None:
        process = psutil.Process(server.process.pid)
        while not stop.wait(0.2):
            own, workers = process.memory_info().rss, [0]
            for worker in process.children(recursive=True):
                with suppress(psutil.Error):
                    workers.append(worker.memory_info().rss)
            samples.append((own, max(workers), own + sum(workers)))

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield samples
    finally:
        stop.set()
        thread.join()
