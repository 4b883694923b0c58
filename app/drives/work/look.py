"""A look at a folder of a client: by the code that reads drives, and by the limits of the service."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from app.drives.work.commit import reading_options
from app.paths import BadNameError, check_path
from app.work.requests import UploadOptions
from app.work.task import WorkSettings
from interloc.config import KeyframeConfig
from interloc.drives.findings import Finding
from interloc.drives.layouts import is_recording
from interloc.reduction.look import DriveLook, LabelCounts, look_into

_MAX_PROBLEMS = 100


def look(
    files: dict[str, int],
    contents: dict[str, bytes],
    name: str,
    root: str | None,
    options: UploadOptions,
    keyframes: KeyframeConfig | None,
    label_counts: LabelCounts,
    limits: WorkSettings,
    place: Path,
) -> bytes:
    """Look into a folder, and return a `FolderLook` as JSON; parameters as of `LookRequest`."""
    valid, refused = {}, []
    for path, size in files.items():
        try:
            valid[check_path(path)] = size
        except BadNameError as error:
            refused.append(str(error))
    found = look_into(
        valid,
        contents,
        name,
        root,
        partial(reading_options, options),
        keyframes=keyframes,
        label_counts=label_counts,
        max_files=limits.max_drive_files,
        place=place,
    )
    if found.drive is None:
        return found.model_dump_json().encode()
    problems = [*_too_large(found.drive, valid, limits), *found.drive.problems]
    if len(problems) > _MAX_PROBLEMS:
        more = f"And {len(problems) - _MAX_PROBLEMS:,} more problems."
        problems = [*problems[:_MAX_PROBLEMS], Finding("note", "", more)]
    if refused:
        problems.append(Finding("note", "files", f"{len(refused):,} are left out for their names: {refused[0]}"))
    drive = found.drive.model_copy(update={"problems": problems})
    return found.model_copy(update={"drive": drive}).model_dump_json().encode()


def _too_large(drive: DriveLook, files: dict[str, int], limits: WorkSettings) -> Iterator[Finding]:
    """Find what of the files that are sent as they are is larger than the service takes."""
    for inside, path in drive.whole.items():
        setting = "max_recording_bytes" if is_recording(path) else "max_file_bytes"
        limit: int = getattr(limits, setting)
        if files[path] > limit:
            split = " Split the recording." if is_recording(path) else ""
            yield _limit(inside, f"is too large: it has {_mb(files[path])}", f"files of {_mb(limit)}", setting, split)
    total = sum(files[path] for path in drive.whole.values())
    if total > limits.max_drive_bytes:
        maximum = f"drives of {_mb(limits.max_drive_bytes)}"
        yield _limit("files", f"are too large together: {_mb(total)}", maximum, "max_drive_bytes")


def _limit(path: str, found: str, maximum: str, setting: str, remedy: str = "") -> Finding:
    text = f"{found}; the service takes {maximum} at most (INTERLOC_{setting.upper()}).{remedy}"
    return Finding("error", path, text)


def _mb(size: int) -> str:
    return f"{size / 1e6:,.1f} MB"
