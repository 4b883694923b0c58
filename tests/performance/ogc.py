"""How fast OGC API - Features answers over a million features: `python -m tests.performance.ogc`.

A thousand drives with a thousand detections each are written into a new database as the end of a job writes them, all
in one town (the hard case: every box meets every drive); each drive has an older result, too.
"""

import statistics
import tempfile
import time
from pathlib import Path

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
        "score": rng.random(DETECTIONS),
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


def fill(context: Context) -> float:
    """Write the index of all drives; returns the seconds per result that its job would wait for it."""
    rng = np.random.default_rng(1)
    waits = []
    folder = context.settings.data_dir / "one"
    for number in range(DRIVES):
        write_result(folder, rng, np.array([8.4, 49.0]) + rng.random(2) * TOWN_DEG, 1_767_225_600 + number * 9000.0)
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


def main() -> None:
    with tempfile.TemporaryDirectory(prefix="ogc-") as folder:
        data = Path(folder)
        context = Context.open(Settings(data_dir=data, min_free_bytes=0))
        wait_s = fill(context)
        context.close()
        click.echo(f"a job of {DETECTIONS:,} features waits {1000 * wait_s:.0f} ms for the index")
        with running_server(data) as address, httpx.Client(base_url=address, timeout=120) as client:
            for name, query in QUERIES.items():
                seconds, cpu = [], []  # server and client are one process
                for _ in range(1 + RUNS):
                    began, began_cpu = time.perf_counter(), time.process_time()
                    answer = client.get(f"/ogc/collections/detections/items?{query}").raise_for_status()
                    seconds.append(time.perf_counter() - began)
                    cpu.append(time.process_time() - began_cpu)
                matched, taken = answer.json()["numberMatched"], statistics.median(seconds[1:])
                click.echo(f"{name:20} {1000 * taken:7.0f} ms {1000 * min(cpu):7.0f} ms of CPU   {matched:9,} matched")


if __name__ == "__main__":
    main()
