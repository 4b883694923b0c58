"""The drive of the demo, the same as `make demo` makes it: through a quarter of a made-up town."""

import hashlib
import shutil

from app.drives.work import unpack
from app.work.requests import JobRequest
from app.work.task import LISTING, Part, Plan, Report, Task, UnpackedFile, place_unpacked
from interloc.errors import require_lab

finish = unpack.finish

_SCANS = 932
_COLUMNS = 720  # shots per laser and turn: a third of a real sensor's, which is enough and a third of the work


def prepare(task: Task[JobRequest]) -> Plan:
    """Return the approximate number of scans as one part; the simulator must be there."""
    require_lab()
    scans = task.settings.max_demo_scans or _SCANS
    return Plan([Part(0, 0, scans)], scans)


def run(task: Task[JobRequest], part: Part, report: Report) -> None:
    """Simulate the drive into the scratch folder, with a list of its files."""
    if (task.scratch / LISTING).is_file():
        return
    from interloc.lab.config import LidarConfig, SimulationOptions  # noqa: PLC0415 - `require_lab` says if it is not there
    from interloc.lab.drive import simulate  # noqa: PLC0415
    from interloc.lab.town import Town  # noqa: PLC0415

    folder = task.scratch / f"simulating-{task.attempt}"
    shutil.rmtree(folder, ignore_errors=True)
    drive = folder / "drive"
    try:
        simulate(
            Town("quarter").trip(),
            drive,
            SimulationOptions(
                keyframes_only=True,
                ground_only=True,
                max_scans=task.settings.max_demo_scans,
                sensor=LidarConfig(columns=_COLUMNS),
            ),
            progress=lambda done, _: report(min(done, part.stop)),
        )
        listing = []
        for path in sorted(path for path in drive.rglob("*") if path.is_file()):
            content = path.read_bytes()
            digest = hashlib.sha256(content).hexdigest()
            listing.append(UnpackedFile(path.relative_to(drive).as_posix(), len(content), digest))
        place_unpacked(drive, listing, task.scratch)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
