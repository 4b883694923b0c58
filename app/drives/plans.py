"""Which scans a client should send that thins and reduces a drive itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from app.drives.records import files_key, find_drive
from app.problems import FileProblem
from app.schemas.drives import DriveOptionsModel, PlanRequest, ReductionPlanModel
from app.service import Service

if TYPE_CHECKING:
    from interloc.drives.reduction.plan import ReductionPlan


def plan_upload(service: Service, drive_id: str, request: PlanRequest) -> ReductionPlanModel:
    """Plan the reduction from the small files that were uploaded so far.

    Raises
    ------
    Problem
        404: no such drive.
    """
    from interloc.drives.reduction.plan import plan_reduction  # noqa: PLC0415 - the server starts without it

    with service.database.reading() as session:
        drive = find_drive(session, drive_id)
    options = request.options or DriveOptionsModel.model_validate(drive.options)
    root = service.storage.folder(files_key(drive_id))
    root.mkdir(parents=True, exist_ok=True)
    plan = plan_reduction(
        root,
        request.numbers(),
        label_folders=request.label_folders,
        label_scheme=options.label_scheme,
        pose_frame=options.pose_frame,
        layout=options.layout,
        oxts=None if options.oxts is None else root / options.oxts,
        name=drive.name.replace("/", "_"),
        keyframes=request.keyframes,
        scan_folder=request.scan_folder,
    )
    return _shown(plan, str(root), drive.name)


def _shown(plan: ReductionPlan, root: str, name: str) -> ReductionPlanModel:
    def named(text: str) -> str:
        return text.replace(f"{root}/", "").replace(root, name)

    return ReductionPlanModel(
        layout=plan.layout,
        pose_frame=plan.pose_frame,
        pose_frame_reason=plan.pose_frame_reason,
        georeference=plan.georeference,
        georeference_reason=None if plan.georeference_reason is None else named(plan.georeference_reason),
        length_m=plan.length_m,
        scans=plan.scans,
        frames=plan.frames_to_send.tolist(),
        frames_to_look_into=plan.frames_to_look_into.tolist(),
        manifest=None if plan.manifest is None else plan.manifest.model_dump(mode="json"),
        problems=[
            FileProblem(severity=each.severity, path=named(each.path), message=named(each.message))
            for each in plan.problems
        ],
    )
