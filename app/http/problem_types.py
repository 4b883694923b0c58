"""The kinds of problems: a stable `type` for each, and the list of them in the documentation."""

from __future__ import annotations

import re

UNTYPED = "about:blank"
"""Type of a problem that says no more than its HTTP status (RFC 9457, section 4.2.1)."""

MEANINGS = {
    "Archive is being unpacked": "An archive of the drive is still being unpacked.",
    "Bad digest": "A Content-Digest is malformed, or of an algorithm that is not checked here.",
    "Bad file name": "A path of a file is not one that the service takes.",
    "Bad part": "A part of a multipart body has a wrong name, file name or encoding.",
    "Bad setting": "A setting of the method does not exist, or has a value that it does not take.",
    "Body malformed": "A body is not what its Content-Type says.",
    "Body not complete": "The connection ended before the body did.",
    "Body refused": "A body is too large, or came too slowly.",
    "Busy": "Too much work of this kind waits already.",
    "Cancelled": "The job was cancelled.",
    "Changed meanwhile": "The drive or job is no longer the version that If-Match names.",
    "Compressed body": "The body has a Content-Encoding or Transfer-Encoding that is not taken.",
    "Database busy": "The database did not answer in time.",
    "Different drives": "The jobs to compare are not of one drive.",
    "Disk full": "The service has no disk space left.",
    "Drive in the trash": "The drive of the job is in the trash itself.",
    "Drive is being checked": "The commit of the drive still runs, and it takes no files meanwhile.",
    "Drive is closed": "The drive is committed, so its files and options are fixed.",
    "Drive not found": "There is no such drive.",
    "Drive not ready": "The drive must be committed first.",
    "Drive not usable": "The drive has errors; `problems` lists them with their files.",
    "Drive not whole": "Files of a drive are no longer on the disk of the service.",
    "Fault of the service": "The service itself failed; its log has the details.",
    "File missing": "The file is listed, but is no longer on the disk of the service.",
    "File not found": "There is no such file.",
    "File not kept": "The file was reduced to what the method needs when the drive was committed.",
    "Filter not valid": "The filter is not CQL2, or asks for what cannot be filtered here; `detail` says what.",
    "Format not installed": "The service lacks the package that writes this format.",
    "Head too large": "The request line and headers are too long.",
    "Host not clear": "The request names no Host, or several.",
    "Idempotency key used before": "The Idempotency-Key was sent with another request.",
    "Job not ended": "The job must end before it can be removed.",
    "Job not found": "There is no such job.",
    "Labels not found": "The drive has no labels of this folder.",
    "Limit reached": "The work took more time or memory than it may; `limit` names the setting, `bound` its value.",
    "Map in use": "A job that waits or runs needs the map.",
    "Map needed": "The drive is to be placed on a map, and no map is given.",
    "Map not found": "The map is not among the files of the drive.",
    "Model not usable": "The network that labels scans cannot be used.",
    "Names in conflict": "The name of a file is in conflict with that of another.",
    "No results": "The job is of a kind that has no results, or no job of the drive was successful.",
    "No such collection": "There is no collection of this name; `detail` lists those that there are.",
    "No such feature": "The collection has no feature of this id.",
    "No such keyframe": "The scan is not a keyframe of the job.",
    "No such range": "The range lies outside of the file.",
    "Not JSON": "The Content-Type of the body is not application/json.",
    "Not a map": "The name of the map does not end as those of OpenStreetMap files do.",
    "Not an archive": "The body is no archive of a kind that is unpacked here.",
    "Not found": "There is nothing at this address.",
    "Not georeferenced": "The drive has no georeference, so nothing of it has longitude and latitude.",
    "Not in the trash": "The trash holds no such drive or job.",
    "Not in this result": "The result has no such part.",
    "Not multipart/form-data": "The body must be multipart/form-data.",
    "Not possible": "What was asked for cannot be done with this drive; `detail` says why.",
    "Not scored": "The job was submitted without a map, so it has no evaluation.",
    "Not used": "A member of the request has no effect without another one.",
    "Overpass switched off": "The service does not fetch maps.",
    "Part of a file": "Files are taken whole only.",
    "Place needed": "The map of which place is to be fetched is not said.",
    "Quota used up": "The drives of this token keep as many bytes as it allows.",
    "Request malformed": "The request does not keep to HTTP.",
    "Request not valid": "A parameter or the body is not valid; `problems` lists where.",
    "Request of another site": "The request came from a page of another site, which may not change anything here.",
    "Result damaged": "A file of the result is damaged.",
    "Result is gone": "The result is no longer on the disk of the service.",
    "Result not ready": "The job is not successful (yet); `state` is its state.",
    "Server lost": "The server that worked on the job was ended too often.",
    "Token may only read": "The request would change something, and its token may only read.",
    "Token needed": "The service needs a valid API token.",
    "Too large": "A body or drive is larger than allowed.",
    "Too many connections": "The service has too many connections.",
    "Too many files": "A request or drive has more files than allowed.",
    "Too many headers": "The request has too many headers.",
    "Too many jobs": "Too many jobs of this client wait or run.",
    "Too many wrong tokens": "Too many tokens that do not exist were sent within a minute.",
    "Unknown host name": "The service does not answer under this host name.",
    "Unknown parameter": "The address takes no query parameter of this name; `problems` lists which.",
    "Upload broken off": "The client closed the connection before the body was complete.",
    "Worker lost": "The worker process died of the work.",
    "Wrong digest": "The body has another SHA-256 than announced.",
}
"""Title of a problem -> what it means, for programs that decide by the type."""


def slug_of(title: str) -> str:
    """Return the last part of the type of a problem: "Drive not usable" -> "drive-not-usable"."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower())


def type_of(title: str) -> str:
    """Return the type of a problem by its title, a URI reference below the service's own address."""
    return f"/problems/{slug_of(title)}" if title in MEANINGS else UNTYPED


def types_listed() -> str:
    """Return the list of all types as Markdown."""
    return "\n".join(f"- `{type_of(title)}`: {meaning}" for title, meaning in MEANINGS.items())
