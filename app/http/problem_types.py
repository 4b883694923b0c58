"""The kinds of problems: what each is called, its status, and what it means. Their types never change."""

from dataclasses import dataclass

UNTYPED = "about:blank"
"""Type of a problem that says no more than its HTTP status (RFC 9457, section 4.2.1)."""


@dataclass(frozen=True)
class ProblemType:
    """A kind of problem (RFC 9457)."""

    name: str
    """Last part of its type: programs decide by it, so it is the same in every version. Empty: untyped."""
    status: int
    """HTTP status; that of an error of the library, or of a worker, can be another one."""
    title: str
    """A few words: those of the name, unless they are written in another way."""
    meaning: str
    """One sentence for the documentation."""

    @property
    def type(self) -> str:
        """Type in problem documents: a URI reference below the service's own address."""
        return f"/problems/{self.name}" if self.name else UNTYPED


TYPES: dict[str, ProblemType] = {}
"""All of them by name, as the documentation lists them."""


def _kind(name: str, status: int, meaning: str, title: str = "") -> ProblemType:
    if name in TYPES:
        raise ValueError(f"two kinds of problems are called {name}")
    TYPES[name] = ProblemType(name, status, title or f"{name[0].upper()}{name[1:].replace('-', ' ')}", meaning)
    return TYPES[name]


ARCHIVE_IS_BEING_UNPACKED = _kind("archive-is-being-unpacked", 409, "An archive of the drive is still being unpacked.")
BAD_DIGEST = _kind("bad-digest", 422, "A Content-Digest is malformed, or of an algorithm that is not checked here.")
BAD_FILE_NAME = _kind("bad-file-name", 422, "A path of a file is not one that the service takes.")
BAD_PART = _kind("bad-part", 422, "A part of a multipart body has a wrong name, file name or encoding.")
BAD_SETTING = _kind("bad-setting", 422, "A setting of the method does not exist, or has a value that it does not take.")
BODY_MALFORMED = _kind("body-malformed", 400, "A body is not what its Content-Type says.")
BODY_NOT_COMPLETE = _kind("body-not-complete", 400, "The connection ended before the body did.")
BODY_REFUSED = _kind("body-refused", 413, "A body is too large, or came too slowly.")
BUSY = _kind("busy", 503, "Too much work of this kind waits already.")
CANCELLED = _kind("cancelled", 409, "The job was cancelled.")
COMPRESSED_BODY = _kind(
    "compressed-body", 415, "The body has a Content-Encoding or Transfer-Encoding that is not taken."
)
DATA_FOLDER_GONE = _kind("data-folder-gone", 503, "The data folder is not where it was when the server started.")
DATABASE_BUSY = _kind("database-busy", 503, "The database did not answer in time.")
DIFFERENT_DRIVES = _kind("different-drives", 422, "The jobs to compare are not of one drive.")
DISK_FULL = _kind("disk-full", 507, "The service has no disk space left.")
DRIVE_IS_BEING_CHECKED = _kind(
    "drive-is-being-checked", 409, "The commit of the drive still runs, and it takes no files meanwhile."
)
DRIVE_IS_CLOSED = _kind("drive-is-closed", 409, "The drive is committed, so its files and options are fixed.")
DRIVE_NOT_FOUND = _kind("drive-not-found", 404, "There is no such drive.")
DRIVE_NOT_READY = _kind("drive-not-ready", 409, "The drive must be committed first.")
DRIVE_NOT_USABLE = _kind("drive-not-usable", 422, "The drive has errors; `problems` lists them with their files.")
DRIVE_NOT_WHOLE = _kind("drive-not-whole", 410, "Files of a drive are no longer on the disk of the service.")
FAULT_OF_THE_SERVICE = _kind("fault-of-the-service", 500, "The service itself failed; its log has the details.")
FILE_MISSING = _kind("file-missing", 410, "The file is listed, but is no longer on the disk of the service.")
FILE_NOT_FOUND = _kind("file-not-found", 404, "There is no such file.")
FILE_NOT_KEPT = _kind(
    "file-not-kept", 410, "The file was reduced to what the method needs when the drive was committed."
)
FILTER_NOT_VALID = _kind(
    "filter-not-valid", 400, "The filter is not CQL2, or asks for what cannot be filtered here; `detail` says what."
)
FORMAT_NOT_INSTALLED = _kind("format-not-installed", 501, "The service lacks the package that writes this format.")
IDEMPOTENCY_KEY_USED_BEFORE = _kind(
    "idempotency-key-used-before", 422, "The Idempotency-Key was sent with another request."
)
JOB_NOT_ENDED = _kind("job-not-ended", 409, "The job must end before it can be removed.")
JOB_NOT_FOUND = _kind("job-not-found", 404, "There is no such job.")
LABELS_NOT_FOUND = _kind("labels-not-found", 422, "The drive has no labels of this folder.")
LIMIT_REACHED = _kind(
    "limit-reached", 422, "The work took more time or memory than it may; `limit` names the setting, `bound` its value."
)
MAP_IN_USE = _kind("map-in-use", 409, "A job that waits or runs needs the map.")
MAP_NEEDED = _kind("map-needed", 422, "The drive is to be placed on a map, and no map is given.")
MAP_NOT_FOUND = _kind("map-not-found", 422, "The map is not among the files of the drive.")
MODEL_NOT_USABLE = _kind("model-not-usable", 422, "The network that labels scans cannot be used.")
NAMES_IN_CONFLICT = _kind("names-in-conflict", 409, "The name of a file is in conflict with that of another.")
NO_RESULTS = _kind(
    "no-results", 404, "The job is of a kind that has no results, or no job of the drive was successful."
)
MAP_IS_OF_THE_SERVER = _kind("map-is-of-the-server", 409, "The map of all drives of the server is not deleted.")
NO_SUCH_MAP = _kind("no-such-map", 404, "There is no such map, or it does not have that yet.")
NO_SUCH_FINDING = _kind("no-such-finding", 404, "A map has no such finding.")
NO_SUCH_COLLECTION = _kind(
    "no-such-collection", 404, "There is no collection of this name; `detail` lists those that there are."
)
NO_SUCH_FEATURE = _kind("no-such-feature", 404, "The collection has no feature of this id.")
NO_SUCH_KEYFRAME = _kind("no-such-keyframe", 404, "The scan is not a keyframe of the job.")
NO_SUCH_RANGE = _kind("no-such-range", 416, "The range lies outside of the file.")
NOT_JSON = _kind("not-json", 415, "The Content-Type of the body is not application/json.", title="Not JSON")
NOT_A_MAP = _kind("not-a-map", 422, "The name of the map does not end as those of OpenStreetMap files do.")
NOT_AN_ARCHIVE = _kind("not-an-archive", 415, "The body is no archive of a kind that is unpacked here.")
NOT_FOUND = _kind("not-found", 404, "There is nothing at this address.")
NOT_GEOREFERENCED = _kind(
    "not-georeferenced", 404, "The drive has no georeference, so nothing of it has longitude and latitude."
)
NOT_IN_THE_TRASH = _kind("not-in-the-trash", 404, "The trash holds no such drive.")
NOT_IN_THIS_RESULT = _kind("not-in-this-result", 404, "The result has no such part.")
NOT_MULTIPART_FORM_DATA = _kind(
    "not-multipart-form-data", 415, "The body must be multipart/form-data.", title="Not multipart/form-data"
)
NOT_POSSIBLE = _kind("not-possible", 500, "What was asked for cannot be done with this drive; `detail` says why.")
NOT_SCORED = _kind("not-scored", 404, "The job was submitted without a map, so it has no evaluation.")
WEBHOOK_REFUSED = _kind("webhook-refused", 422, "The service does not call this address.")
SOURCE_REFUSED = _kind("source-refused", 422, "The service does not read drives from this address.")
NOT_USED = _kind("not-used", 422, "A member of the request has no effect without another one.")
OVERPASS_SWITCHED_OFF = _kind("overpass-switched-off", 422, "The service does not fetch maps.")
PART_OF_A_FILE = _kind("part-of-a-file", 400, "Files are taken whole only.")
PLACE_NEEDED = _kind("place-needed", 422, "The map of which place is to be fetched is not said.")
QUOTA_USED_UP = _kind("quota-used-up", 413, "The drives of this token keep as many bytes as it allows.")
REQUEST_NOT_VALID = _kind("request-not-valid", 422, "A parameter or the body is not valid; `problems` lists where.")
REQUEST_OF_ANOTHER_SITE = _kind(
    "request-of-another-site", 403, "The request came from a page of another site, which may not change anything here."
)
RESULT_DAMAGED = _kind("result-damaged", 500, "A file of the result is damaged.")
RESULT_IS_GONE = _kind("result-is-gone", 410, "The result is no longer on the disk of the service.")
RESULT_NOT_READY = _kind("result-not-ready", 409, "The job is not successful (yet); `state` is its state.")
SERVER_LOST = _kind("server-lost", 500, "The server that worked on the job was ended too often.")
STORAGE_READ_ONLY = _kind(
    "storage-read-only",
    503,
    "The disk of the service fails, or cannot be written to any more.",
    title="Storage read-only",
)
TOKEN_MAY_ONLY_READ = _kind(
    "token-may-only-read", 403, "The request would change something, and its token may only read."
)
TOKEN_NEEDED = _kind("token-needed", 401, "The service needs a valid API token.")
TOO_LARGE = _kind("too-large", 413, "A body or drive is larger than allowed.")
TOO_MANY_FILES = _kind("too-many-files", 413, "A request or drive has more files than allowed.")
TOO_MANY_JOBS = _kind("too-many-jobs", 429, "Too many jobs of this client wait or run.")
TOO_MANY_MAPS = _kind("too-many-maps", 429, "The client has as many maps of many drives as it may have.")
TOO_MANY_SESSIONS = _kind("too-many-sessions", 429, "The client has as many live sessions as it may have.")
TOO_MANY_UPLOADS = _kind("too-many-uploads", 429, "The client has as many drives that take files as it may have.")
UNKNOWN_HOST_NAME = _kind("unknown-host-name", 421, "The service does not answer under this host name.")
UNKNOWN_PARAMETER = _kind(
    "unknown-parameter", 400, "The address takes no query parameter of this name; `problems` lists which."
)
UPLOAD_BROKEN_OFF = _kind("upload-broken-off", 400, "The client closed the connection before the body was complete.")
WORKER_LOST = _kind("worker-lost", 500, "The worker process died of the work.")
WRONG_DIGEST = _kind("wrong-digest", 422, "The body has another SHA-256 than announced.")
