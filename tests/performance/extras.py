"""Each extra alone, from a built wheel: `python -m tests.performance.extras [EXTRA ...]`.

In a fresh environment with no extra and in one with each alone, all commands are run on small drives. What an
environment has works; what it has not says which packages it wants; nothing is a fault of InterLoc itself. Then the
page is served from an environment with the extra `service`. Takes some minutes and a gigabyte.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import httpx
import numpy as np

from interloc import open_drive
from interloc.drives.folder import FolderDrive
from tests.app.processes import free_port, wait_until
from tests.app.street import write_street
from tests.bags import write_bag
from tests.las_files import write_scan_files
from tests.street_points import poses_along, seen
from tests.street_points import street as street_points
from tests.street_points import write_scans as write_upright

ROOT = Path(__file__).parents[2]
EXTRAS = ("", "service", "dask", "label", "live", "las", "odometry", "parquet", "ros", "storage")
PLAIN = [
    *("info street", "run street -o out --osm street/map.osm", "batch street -o many"),
    *("explain street --frame 20 -o steps", "label street --by geometry -o labelled"),
    *("convert street -o converted", "export out -o out.gpkg", "export out -o out.kmz", "merge out -o city"),
    *("live street --print", "info --settings --preset paper", "simulate town -o made --max-scans 3"),
]
# Command, and the extra that it needs.
COMMANDS = (
    *((command, "") for command in PLAIN),
    ("batch street -o dask --dask tcp://127.0.0.1:1", "dask"),
    ("export out -o out.parquet", "parquet"),
    ("info bag", "ros"),
    ("info las", "las"),
    ("odometry upright -o poses.txt", "odometry"),
    ("info s3://nowhere/drive", "storage"),
    ("live street --server http://127.0.0.1:1", "live"),
    ("admin token add me --data-dir data", "service"),
    ("ros /points", "ros2"),
)
FAILS_ELSEWHERE = ("s3://", "127.0.0.1:1")  # with the extra too, for a reason that its message tells


def environment(folder: Path, wheel: Path, extra: str) -> Path:
    """Make an environment with one extra; returns its Python."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    python = folder / "bin" / "python"
    wanted = f"{wheel}[{extra}]" if extra else str(wheel)
    install = ["-m", "pip", "install", "--quiet", "--no-compile", "-c", str(ROOT / "constraints.txt"), wanted]
    subprocess.run([python, *install], check=True)
    for module in folder.glob("lib/*/site-packages/interloc/**/*.py"):
        os.utime(module, (0, 0))  # or each environment would compile the kernels anew
    return python


def try_all(python: Path, place: Path, extra: str) -> list[str]:
    """Run all commands; returns what is not as it should be."""
    faults = []
    has = {extra} | ({"live"} if extra == "service" else set())
    for command, needs in COMMANDS:
        done = subprocess.run(
            [python, "-m", "interloc", *command.split()],
            cwd=place,
            env=os.environ | {"INTERLOC_DATA_DIR": str(place / "data"), "NUMBA_CACHE_DIR": str(place.parent / "numba")},
            capture_output=True,
            text=True,
            check=False,
        )
        said = done.stdout + done.stderr
        asks = "pip install" in said
        should_work = not needs or needs in has
        fails_elsewhere = any(sign in command for sign in FAILS_ELSEWHERE)
        works = not asks and (done.returncode == 0) != fails_elsewhere
        good = works if should_work else asks and done.returncode != 0
        if not good or "fault of InterLoc" in said or "Traceback" in said:
            faults.append(f"[{extra}] interloc {command}: exit {done.returncode}: {said.strip()[-400:]}")
    return faults


def serves_the_page(python: Path, place: Path) -> list[str]:
    """Serve from an installed wheel, as pipx does."""
    port = free_port()
    command = [str(python), "-m", "interloc", "serve", "--port", str(port), "--data-dir", str(place / "served")]
    process = subprocess.Popen(command, cwd=place)

    def page() -> str:
        try:
            return httpx.get(f"http://127.0.0.1:{port}/").text
        except httpx.TransportError:
            return ""

    try:
        text = wait_until(page, "the page")
    finally:
        process.terminate()
        process.wait(60)
    return [] if "<title>InterLoc" in text else [f"[service] the page is {text[:200]!r}"]


def main() -> None:
    """Build, install, run; exit code 1 where something is not as it should be."""
    with tempfile.TemporaryDirectory(prefix="extras-") as root:
        folder = Path(root)
        build = ["-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(folder), str(ROOT)]
        subprocess.run([sys.executable, *build], check=True)
        (wheel,) = folder.glob("interloc-*.whl")
        faults = []
        for extra in sys.argv[1:] or EXTRAS:
            began = time.monotonic()
            python = environment(folder / "environment", wheel, extra)
            place = folder / "place"
            street = write_street(place / "street", 40)
            drive = open_drive(street)
            assert isinstance(drive, FolderDrive)
            times = drive.times_s
            assert times is not None
            scans = [np.pad(drive.ground_points(at).xyz, ((0, 0), (0, 1))) for at in range(len(drive.frames))]
            write_bag(place / "bag", "mcap", scans, list(times), poses=list(drive.T_world_lidar))
            write_scan_files(drive, place / "las")
            driven = poses_along(np.full(10, 1.5), turn_rad=0.02)
            write_upright(place / "upright", [seen(street_points(), pose) for pose in driven])
            found = try_all(python, place, extra)
            if extra == "service":
                found += serves_the_page(python, place)
            took = f"{extra or 'none':10} {time.monotonic() - began:6.0f} s"
            print(took, *found, sep="\n  ")  # noqa: T201 - what it is for
            faults += found
            shutil.rmtree(folder / "environment")
            shutil.rmtree(place)
        sys.exit(bool(faults))


if __name__ == "__main__":
    main()
