"""Where a drive went: written by its commit."""

from __future__ import annotations

from pathlib import Path

from app.context import Context
from app.drives.records import drive_key, find_drive
from app.http.problems import Problem
from app.work.places import TRAJECTORY


def trajectory_file(context: Context, drive_id: str) -> Path:
    """Return the trajectory of a drive.

    Raises
    ------
    Problem
        404: no such drive. 409: it is not ready. 410: somebody else removed it.
    """
    with context.database.reading() as session:
        drive = find_drive(session, drive_id)
    if drive.state != "ready":
        raise Problem(
            409, "Drive not ready", f"Drive {drive_id} is {drive.state}; it has a trajectory once it is committed."
        )
    folder = context.storage.folder(drive_key(drive_id))
    path = next((path for name in TRAJECTORY if (path := folder / name).is_file()), None)
    if path is None:
        raise Problem(410, "Drive not whole", f"The trajectory of drive {drive_id} is no longer on disk.")
    return path
