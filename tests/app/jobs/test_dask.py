"""Work on a real Dask cluster: a scheduler and a worker of two threads, each a process of its own."""

import json
import os
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from app.jobs.executors import DaskExecutor
from app.jobs.processes import NoWorkersError, WorkerLostError
from interloc.cli.main import run
from tests.app.conftest import Serve
from tests.app.kills import die
from tests.app.processes import Command, Gate, assert_as_by_command, ended, half_way, submit, upload, wait_until

pytest.importorskip("distributed", reason="the extra dask is not installed")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of the scheduler; its worker has a nanny, which replaces it when it dies."""
    folder = tmp_path_factory.mktemp("dask")
    contact = folder / "scheduler.json"
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(contact)]
    workers = ["worker", "--scheduler-file", str(contact), "--nthreads", "2", "--no-dashboard"]
    # Work is tried once. Workers are forks of their nanny, as it is one of this process: nothing is imported again.
    settings = {"SCHEDULER__ALLOWED_FAILURES": "0", "WORKER__MULTIPROCESSING_METHOD": "forkserver"}
    environment = {**os.environ, **{f"DASK_DISTRIBUTED__{name}": value for name, value in settings.items()}}
    with ExitStack() as stack:

        def start(arguments: list[str]) -> None:
            log = folder / f"{arguments[0]}.log"
            process = Command(arguments, environment, log, log, folder, program=run_dask)
            stack.callback(process.join, 60)
            stack.callback(process.terminate)

        start(scheduler)
        wait_until(lambda: contact.exists() and contact.read_text().endswith("}"), "the scheduler")
        address = json.loads(contact.read_text())["address"]
        start(workers)
        executor = DaskExecutor(address, lambda: None)
        wait_until(lambda: executor.submit(os.getpid).result(60) and executor.alive == 2, "the worker")
        executor.stop()
        yield address


def run_dask() -> None:
    """Become `dask` with the arguments of this process."""
    from dask import config  # noqa: PLC0415 - an extra
    from dask.cli import run_cli  # noqa: PLC0415

    config.refresh()
    run_cli()


def test_a_cluster_finds_what_the_command_line_finds(cluster: str, serve: Serve, street: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    osm = street / "map.osm"
    assert run(["run", str(street), "-o", str(out), "--osm", str(osm), "--quiet"]) == 0
    client = serve(dask=cluster)
    drive_id = upload(client, street)
    gate = Gate(tmp_path / "data", drive_id, frame=25)
    job_id = submit(client, drive_id, osm={"file": "map.osm"})
    half_way(client, job_id)
    gate.open()
    assert_as_by_command(client, ended(client, job_id), out, "osm_nodes", "matches")
    assert client.get("/readyz").json()["ready"] is True


def test_work_that_kills_its_worker_is_lost_and_the_cluster_goes_on(cluster: str) -> None:
    lost: list[int] = []
    executor = DaskExecutor(cluster, lambda: lost.append(1))
    try:
        with pytest.raises(WorkerLostError, match="died"):
            executor.submit(die).result(120)
        assert lost == [1]
        assert executor.submit(os.getpid, urgent=True).result(60) != os.getpid()
    finally:
        executor.stop()


def test_a_batch_on_a_cluster_needs_no_folder_that_workers_share(cluster: str, street: Path, tmp_path: Path) -> None:
    listed = tmp_path / "list.csv"
    listed.write_text("drive,name\n" + "".join(f"{street},{name}\n" for name in "ab"))
    out = tmp_path / "out"
    assert run(["batch", str(listed), "-o", str(out), "--dask", cluster, "--quiet"]) == 0
    assert len({(out / name / "detections.geojson").read_bytes() for name in "ab"}) == 1


def test_a_cluster_that_was_away_takes_work_again(cluster: str) -> None:
    executor = DaskExecutor(cluster, lambda: None)
    try:
        executor._client.close()  # what Dask does where its scheduler is away for longer than its patience
        with pytest.raises(NoWorkersError, match="the Dask scheduler is away"):
            executor.submit(os.getpid)
        wait_until(lambda: executor.alive > 0, "the cluster to be there again")
        assert executor.submit(len, "abc").result(60) == 3
    finally:
        executor.stop()
