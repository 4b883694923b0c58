"""Processes that kill themselves at an exact point, as a power cut would: between two steps that belong together."""

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sqlalchemy import event

from app.context import Context
from app.drives.records import delete_file
from app.drives.upload import keep
from app.http.intake import Intake
from app.maps.routes import _keep_osm
from app.settings import Settings
from app.store.models import Drive
from app.trash import deletion as trash
from tests import forks


def killed(act: Callable[..., None], data_dir: Path, *arguments: Any) -> None:
    """Do something of this module in a process of its own, which does not survive it."""
    process = forks.context.Process(target=act, args=(data_dir, *arguments))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL, process.exitcode


def put(data_dir: Path, drive_id: str, path: str, content: bytes) -> None:
    """Receive a file; die when it has its name and its row is about to be committed."""
    context = _open(data_dir)
    intake = Intake(context, path, len(content))
    intake.write(content)
    arrival = intake.finish()
    event.listen(context.database.engine, "commit", die)
    keep(context, drive_id, [arrival])


def remove_file(data_dir: Path, drive_id: str, path: str) -> None:
    """Delete a file; die when that its row is gone is about to be committed."""
    context = _open(data_dir)
    event.listen(context.database.engine, "commit", die)
    delete_file(context, drive_id, path)


def put_map(data_dir: Path, map_id: str, name: str) -> None:
    """Receive the OSM file of a map; die when its row is about to be committed."""
    context = _open(data_dir)
    intake = Intake(context, name, 4)
    intake.write(b"next")
    arrival = intake.finish()
    event.listen(context.database.engine, "commit", die)
    _keep_osm(context, map_id, "anonymous", arrival)


def purge(data_dir: Path, drive_id: str) -> None:
    """Purge a drive that is in the trash; die when its folder is gone and those of its jobs are not."""
    context = _open(data_dir)
    delete = context.storage.delete
    context.storage.delete = lambda key: die() if key.startswith("jobs/") else delete(key)
    trash.purge(context, Drive, drive_id)


def _open(data_dir: Path) -> Context:
    return Context.open(Settings(data_dir=data_dir, min_free_bytes=0))


def die(*_: object) -> None:
    """End this process at once."""
    os.kill(os.getpid(), signal.SIGKILL)
