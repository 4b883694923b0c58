"""Paths of uploaded files: relative, inside the folder of the drive, and valid on every file system."""

import re
import unicodedata
from pathlib import Path

from interloc.errors import InterLocError

MAX_PATH = 512
"""Maximum number of characters of a path."""

MAX_SEGMENT_BYTES = 255
"""Maximum size of one folder or file name in UTF-8, which is the limit of common file systems."""

MAX_DEPTH = 16

ARCHIVE_ENDINGS = (".zip", ".tar", ".tar.gz", ".tgz", ".tar.zst", ".tzst")
"""Endings of archives, for those who choose one; the service itself looks at the first bytes."""

_MAX_SHOWN_CHARS = 80
_CONTROLS = {"Cc", "Cf", "Cs", "Zl", "Zp"}
_DEVICE = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9]) *(\.|$)", re.IGNORECASE)  # on Windows, with any ending


class BadNameError(InterLocError, ValueError):
    """The path is not valid for a file of a drive; a `ValueError` too, which validators of pydantic may raise."""

    http_status = 422


def check_path(path: str) -> str:
    """Return a path unchanged if it is valid for a file of a drive, else raise a `BadNameError`.

    Not valid is what is empty, absolute, leads upwards, is hidden, too long or too deep, has a name that Windows cannot
    store, or holds a backslash, a control or format character, or bytes that are not UTF-8.
    """
    complaint = _complaint(path)
    if complaint:
        name = path if len(path) <= _MAX_SHOWN_CHARS else path[:_MAX_SHOWN_CHARS] + "..."
        raise BadNameError(
            f"{name!a} {complaint}. Expected a path relative to the folder of the drive, with forward slashes, "
            "for example velodyne/000000.bin."
        )
    return path


def without_folder(text: str, folder: Path, name: str) -> str:
    """Name the files of a folder as their owner knows them: a message must not reveal where the folder is."""
    return text.replace(f"{folder}/", "").replace(str(folder), name)


def _complaint(path: str) -> str | None:
    """Return what is wrong with a path."""
    segments = path.split("/")
    rules = (
        (not path, "is empty"),
        (
            (not path.isprintable() and any(unicodedata.category(each) in _CONTROLS for each in path))
            or "\ufffd" in path,
            "holds a control character, another one that is not shown, or bytes that are not UTF-8",
        ),
        ("\\" in path, "holds a backslash"),
        (path.startswith("/") or path[1:2] == ":", "is an absolute path"),
        (len(path) > MAX_PATH, f"has {len(path)} characters, more than {MAX_PATH}"),
        (len(segments) > MAX_DEPTH, f"lies {len(segments)} folders deep, more than {MAX_DEPTH}"),
        ("" in segments, "holds an empty name (two slashes, or a slash at its end)"),
        ("." in segments or ".." in segments, "holds . or .., which lead elsewhere"),
        (
            any(len(segment.encode(errors="replace")) > MAX_SEGMENT_BYTES for segment in segments),
            f"holds a name of more than {MAX_SEGMENT_BYTES} bytes",
        ),
        (
            any(segment.startswith(".") for segment in segments),
            "is hidden (a name that starts with a dot), which no file of a drive is; leave it out",
        ),
        (any(segment.endswith((".", " ")) for segment in segments), "holds a name that ends with a dot or a blank"),
        (
            any(_DEVICE.match(segment) for segment in segments),
            "holds the name of a device of Windows (con, nul, com1, ...), under which nothing can be stored there",
        ),
    )
    return next((complaint for applies, complaint in rules if applies), None)
