"""The scans of a session kept as a drive: files as they come, its poses at the end, then its check and its job."""

from __future__ import annotations

import numpy as np

from app.context import Context
from app.drives.commit import begin_commit
from app.drives.models import CommitRequest, DriveOptionsModel, NewDrive
from app.drives.records import create_drive
from app.drives.upload import keep
from app.http.intake import Arrival, Intake
from app.http.limits import check_free_space, job_limit
from app.jobs.models import NewJob
from app.jobs.queue import submit
from app.jobs.submission import check_request
from app.states import JobKind
from interloc.config import DetectorConfig
from interloc.geometry import rpy_from_rotation
from interloc.live.scan import LiveScan

_ROAD, _OTHER = 40, 48  # ids of SemanticKITTI: road, sidewalk


class Keeper:
    """Writes the keyframes of a session into a drive of SemanticKITTI's layout, numbered anew from 0.

    It is used by the thread of the session; the drive takes files until `finish`.
    """

    def __init__(self, context: Context, owner: str, name: str, config: DetectorConfig) -> None:
        check_free_space(context, 0)
        options = DriveOptionsModel(label_scheme="semantickitti", pose_frame="lidar")
        drive, _ = create_drive(context, owner, NewDrive(name=name, options=options))
        self.drive_id = drive.id
        self._context, self._owner, self._config = context, owner, config
        self._scans: list[LiveScan] = []  # without their points

    def keep(self, scan: LiveScan) -> None:
        """Write the points of a keyframe; a 413 where the drive, a 507 where the disk would be too full."""
        ground, number = scan.ground, len(self._scans)
        points = np.pad(ground.xyz, ((0, 0), (0, 1)))
        labels = np.where(ground.is_road, _ROAD, _OTHER).astype("<u4")
        check_free_space(self._context, points.nbytes + labels.nbytes)
        self._write(
            {
                f"velodyne/{number:06d}.bin": points.astype("<f4").tobytes(),
                f"labels/{number:06d}.label": labels.tobytes(),
            }
        )
        self._scans.append(LiveScan(scan.frame, scan.T_world_lidar, points[:0], time_s=scan.time_s, fix=scan.fix))

    def finish(self) -> dict[str, str]:
        """Write poses, times, fixes; begin check and job of the drive (429: too many wait); return both ids."""
        poses = [" ".join(f"{value:.17g}" for value in scan.T_world_lidar[:3].ravel()) for scan in self._scans]
        files = {"poses.txt": poses}
        if all(scan.time_s is not None for scan in self._scans):
            files["times.txt"] = [f"{scan.time_s:.17g}" for scan in self._scans]
        fixes = [scan.fix for scan in self._scans]
        if fixes and fixes[0] is not None:
            files["geo.csv"] = ["frame,lat_deg,lon_deg,alt_m,roll_rad,pitch_rad,yaw_rad"]
            for number, fix in enumerate(fixes):
                assert fix is not None  # all have one, or none
                values = (fix.lat_deg, fix.lon_deg, fix.alt_m, *rpy_from_rotation(fix.R_enu_lidar))
                files["geo.csv"].append(",".join([str(number), *(f"{value:.17g}" for value in values)]))
        self._write({name: "".join(f"{line}\n" for line in lines).encode() for name, lines in files.items()})
        context, owner = self._context, self._owner
        begin_commit(context, self.drive_id, owner, CommitRequest())
        new = NewJob(drive_id=self.drive_id, config=self._config.model_dump(mode="json"))
        with context.database.writing() as session:
            job, _ = submit(
                session,
                context.database,
                kind=JobKind.INTERSECTIONS,
                drive_id=self.drive_id,
                owner=owner,
                request=check_request(session, context, new),
                limit=job_limit(context, owner),
            )
            job_id = job.id
        context.jobs_changed.set()
        return {"drive_id": self.drive_id, "job_id": job_id}

    def _write(self, files: dict[str, bytes]) -> None:
        arrivals: list[Arrival] = []
        intakes = [Intake(self._context, path, len(content)) for path, content in files.items()]
        try:
            for intake, content in zip(intakes, files.values(), strict=True):
                intake.write(content)
                arrivals.append(intake.finish())
            keep(self._context, self.drive_id, arrivals)
        finally:
            for intake in intakes:
                intake.discard()
