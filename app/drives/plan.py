"""The plan for a client that reduces a drive itself: which scans it should send."""

from __future__ import annotations

from pathlib import Path

from fastapi.concurrency import run_in_threadpool

from app.context import Context
from app.drives.models import JudgedLabels, LabelsAnswer, LabelsRequest, PlanRequest, ReductionPlanModel
from app.drives.records import files_key, find_drive
from app.drives.work.commit import reading_options
from app.drives.work.plan import plan_and_judge
from app.http.problems import FileProblem
from app.jobs.runner import Runner
from app.paths import without_folder
from app.work.documents import UploadOptions
from interloc.drives.findings import Finding, Findings
from interloc.drives.labels import LabelJudgement, judge_labels
from interloc.drives.options import LabelFolder
from interloc.reduction.plan import ReductionPlan


async def plan_upload(
    context: Context, runner: Runner, drive_id: str, request: PlanRequest, client: str
) -> ReductionPlanModel:
    """Plan the reduction from the small files that were uploaded; problems as of `Runner.run_in_worker`."""
    name, root, given = await run_in_threadpool(_look_up, context, drive_id, request)
    made, judged = await runner.run_in_worker(
        plan_and_judge,
        root,
        request.numbers(),
        reading_options(given, root, name),
        request.keyframes,
        request.scan_folder,
        request.label_counts,
        client=client,
    )
    return _shown(made, judged, root, name)


def judge_label_counts(request: LabelsRequest) -> LabelsAnswer:
    """Judge what label ids mean, before the drive is on the service."""
    scheme, kitti360 = request.options.label_scheme, request.options.layout == "kitti360"
    labels = []
    for folder, counts in request.label_counts.items():
        findings = Findings(stop_at_first=False)
        judged = judge_labels(folder, counts, scheme, kitti360=kitti360, check=True, findings=findings)
        problems = [
            FileProblem(severity=each.severity, path=each.path, message=each.message) for each in findings.found
        ]
        labels.append(_judged(folder, judged, problems))
    return LabelsAnswer(labels=labels)


def _look_up(context: Context, drive_id: str, request: PlanRequest) -> tuple[str, Path, UploadOptions]:
    with context.database.reading() as session:
        drive = find_drive(session, drive_id)
    root = context.storage.folder(files_key(drive_id))
    root.mkdir(parents=True, exist_ok=True)
    return drive.name, root, request.options or UploadOptions.model_validate(drive.options)


def _shown(
    made: ReductionPlan, judged: dict[LabelFolder, tuple[LabelJudgement, list[Finding]]], root: Path, name: str
) -> ReductionPlanModel:
    def named(text: str) -> str:
        return without_folder(text, root, name)

    def problems(found: list[Finding]) -> list[FileProblem]:
        return [
            FileProblem(severity=each.severity, path=named(each.path), message=named(each.message)) for each in found
        ]

    return ReductionPlanModel(
        layout=made.layout,
        pose_frame=made.pose_frame,
        pose_frame_reason=made.pose_frame_reason,
        georeference=made.georeference,
        georeference_reason=None if made.georeference_reason is None else named(made.georeference_reason),
        length_m=made.length_m,
        scans=made.scans,
        frames=made.frames_to_send.tolist(),
        frames_to_look_into=made.frames_to_look_into.tolist(),
        labels=[_judged(folder, labels, problems(found)) for folder, (labels, found) in judged.items()],
        manifest=None if made.manifest is None else made.manifest.model_dump(mode="json"),
        problems=problems(made.problems),
    )


def _judged(folder: LabelFolder, labels: LabelJudgement, problems: list[FileProblem]) -> JudgedLabels:
    scheme = labels.scheme
    return JudgedLabels(
        folder=folder,
        scheme=None if scheme is None else scheme.name,
        road=[] if scheme is None else sorted(scheme.road),
        confusable=[] if scheme is None else sorted(scheme.confusable),
        road_share=labels.road_share,
        ground_share=labels.ground_share,
        problems=problems,
    )
