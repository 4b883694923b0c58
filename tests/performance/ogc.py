"""How fast OGC API - Features answers over a million features: `tests/performance/ogc.py [--spread]`.

From the project's folder, with PYTHONPATH=. there. A thousand drives with a thousand detections each are written into
a new database as the end of a job writes them, all in one town (the hard case: every box meets every drive) or spread
over a country; each drive has an older result, too. Then: seconds of queries as the service does them, and of GDAL's
OAPIF driver that reads 10,000 features from a server.
"""

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import httpx
import numpy as np

from app.context import Context
from app.ogc.index import write_job_rows
from app.ogc.work import rows_of
from app.settings import Settings
from app.store.models import Drive, Job
from interloc.arrays import FloatArray
from interloc.output.geojson import write_collection
from interloc.output.layers import LAYERS
from tests.app.conftest import running_server

DRIVES = 1000
DETECTIONS = 1000
TOWN_DEG = 0.1
COUNTRY_DEG = 6.0
RUNS = 7

QUERIES = {
    "first page": "limit=100",
    "bbox of a street": "limit=100&bbox=8.4300,49.0300,8.4330,49.0320",
    "bbox of a quarter": "limit=100&bbox=8.42,49.02,8.45,49.04",
    "bbox of everything": "limit=100&bbox=0,40,20,60",
    "an OSM node": "limit=100&filter=osm_id=4000000123",
    "a verdict": "limit=100&filter=outcome='wrong'",
    "two numbers": "limit=100&filter=score>0.95 AND error_m BETWEEN 2 AND 3",
    "a pattern": "limit=100&filter=reason LIKE '%25misplaced%25'",
    "an afternoon": "limit=100&datetime=2026-03-01T12:00:00Z/2026-03-01T18:00:00Z",
    "a drive": "limit=1000&filter=drive='drive 500'",
}


READ_BY_GDAL = """
import sys, time

import pyogrio

address = f"OAPIF:{sys.argv[1]}/ogc"
for _ in range(3):
    began = time.perf_counter()
    count = len(pyogrio.raw.read(address, layer="detections", max_features=10_000)[2])
    print(f"GDAL {pyogrio.__gdal_version_string__}: {count:,} features in {time.perf_counter() - began:.2f} s")
"""
"""In a process of its own: GDAL would stop the threads of the server."""


def write_result(folder: Path, rng: np.random.Generator, start: FloatArray, seconds: float) -> None:
    """Write the layers of a result as a drive of ten kilometres leaves them."""
    steps = np.cumsum(rng.normal(0.0, 6e-5, (DETECTIONS, 2)), axis=0) + np.linspace(0, 1, DETECTIONS)[:, None] * 0.03
    lonlat = np.round(start + steps, 7)
    times = [time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(seconds + i)) for i in range(DETECTIONS)]
    error = rng.gamma(2.0, 1.0, DETECTIONS)
    wrong = error > 5.0
    layer = LAYERS["detections"]
    columns = {each.name: [None] * DETECTIONS for each in layer.attributes} | {
        "frame": np.arange(DETECTIONS) * 3,
        "branch_count": rng.integers(3, 6, DETECTIONS),
        "branch_bearings_deg": [[0.0, 90.0, 180.0]] * DETECTIONS,
        "score": rng.random(DETECTIONS),
        "intersection": (np.arange(DETECTIONS) // 20).tolist(),
        "id": [f"{3 * i}-1" for i in range(DETECTIONS)],
        "time": times,
        "outcome": np.where(wrong, "wrong", "right").tolist(),
        "osm_id": (4_000_000_000 + rng.integers(0, 20_000, DETECTIONS)).tolist(),
        "error_m": error,
        "reason": [f"misplaced by {e:.1f} m" if w else None for e, w in zip(error, wrong, strict=True)],
    }
    features = layer.features(lonlat.tolist(), **columns)
    folder.mkdir(parents=True, exist_ok=True)
    write_collection(folder / "detections.geojson", features, local=False)
    for name in ("intersections", "keyframes"):
        write_collection(folder / f"{name}.geojson", [], local=False)
    track = LAYERS["trajectory"].features([lonlat.tolist()], scans=[3000])
    write_collection(folder / "trajectory.geojson", track, local=False)
    (folder / "run.json").write_text('{"labels": "labels"}')


def fill(context: Context, *, extent_deg: float) -> float:
    """Write the index of all drives; returns the seconds per result that its job would wait for it."""
    rng = np.random.default_rng(1)
    waits = []
    folder = context.settings.data_dir / "one"
    for number in range(DRIVES):
        write_result(folder, rng, np.array([8.4, 49.0]) + rng.random(2) * extent_deg, 1_767_225_600 + number * 9000.0)
        with context.database.writing() as session:
            now = context.database.clock(session)
            times = {"created_at": now, "touched_at": now}
            drive = Drive(id=f"{number:016x}", name=f"drive {number}", owner="me", state="uploading", **times)
            session.add(drive)
            session.flush()
            done = {"drive_id": drive.id, "owner": "me", "kind": "intersections", "state": "successful", "request": {}}
            old, new = (Job(**done, created_at=now - age_s) for age_s in (1, 0))
            session.add_all([old, new])
            session.flush()
            began = time.perf_counter()
            layers = list(rows_of(folder))
            write_job_rows(session, new, layers)
            waits.append(time.perf_counter() - began)
            write_job_rows(session, old, layers)
    return statistics.median(waits)


def measure(call: Callable[[], Any]) -> tuple[float, float]:
    """Return the seconds that a call takes, and those of CPU time: server and client are one process."""
    call()
    seconds, cpu = [], []
    for _ in range(RUNS):
        began, began_cpu = time.perf_counter(), time.process_time()
        call()
        seconds.append(time.perf_counter() - began)
        cpu.append(time.process_time() - began_cpu)
    return statistics.median(seconds), min(cpu)


def measure_queries(client: httpx.Client, items: str, queries: dict[str, str]) -> None:
    for name, query in queries.items():
        answer = client.get(f"{items}?{query}")
        assert answer.status_code == 200, answer.text
        seconds, cpu = measure(lambda query=query: client.get(f"{items}?{query}"))
        matched = answer.json()["numberMatched"]
        click.echo(f"{name:20} {1000 * seconds:7.0f} ms {1000 * cpu:7.0f} ms of CPU   {matched:9,} matched")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--spread", action="store_true", help="drives all over a country instead of one town")
    parser.add_argument("--database", help="address of an empty PostgreSQL database instead of SQLite")
    arguments = parser.parse_args()
    data = Path(tempfile.mkdtemp(prefix="ogc-"))
    options: dict[str, Any] = {} if arguments.database is None else {"database_url": arguments.database}
    context = Context.open(Settings(data_dir=data, min_free_bytes=0, **options))
    wait_s = fill(context, extent_deg=COUNTRY_DEG if arguments.spread else TOWN_DEG)
    size = sum(path.stat().st_size for path in data.glob("*.sqlite3*"))
    click.echo(
        f"{DRIVES * DETECTIONS:,} features of {DRIVES:,} drives, each with an older result: {size / 1e6:,.0f} MB"
    )
    click.echo(f"a job of {DETECTIONS:,} features waits {1000 * wait_s:.0f} ms for the index")
    context.close()
    with running_server(data, **options) as address, httpx.Client(base_url=address, timeout=120) as client:
        items = "/ogc/collections/detections/items"
        measure_queries(client, items, QUERIES)
        for name in ("", "/collections", "/collections/trajectory/items?bbox=8.43,49.03,8.433,49.032"):
            seconds, cpu = measure(lambda name=name: client.get(f"/ogc{name}"))
            click.echo(f"/ogc{name[:40]:40} {1000 * seconds:7.0f} ms {1000 * cpu:7.0f} ms of CPU")

        command = [sys.executable, "-c", READ_BY_GDAL, address]
        subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
