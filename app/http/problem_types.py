"""The kinds of problems: what each is called, and its status. Their types never change."""

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

    @property
    def type(self) -> str:
        """Type in problem documents: a URI reference below the service's own address."""
        return f"/problems/{self.name}" if self.name else UNTYPED


TYPES: dict[str, ProblemType] = {}
"""All of them by name, as the description of the API lists them."""


def _kind(name: str, status: int, title: str = "") -> ProblemType:
    if name in TYPES:
        raise ValueError(f"two kinds of problems are called {name}")
    TYPES[name] = ProblemType(name, status, title or f"{name[0].upper()}{name[1:].replace('-', ' ')}")
    return TYPES[name]


ARCHIVE_IS_BEING_UNPACKED = _kind("archive-is-being-unpacked", 409)
BAD_DIGEST = _kind("bad-digest", 422)
BAD_FILE_NAME = _kind("bad-file-name", 422)
BAD_PART = _kind("bad-part", 422)
BAD_SETTING = _kind("bad-setting", 422)
BODY_MALFORMED = _kind("body-malformed", 400)
BODY_REFUSED = _kind("body-refused", 413)
BUSY = _kind("busy", 503)
CANCELLED = _kind("cancelled", 409)
COMPRESSED_BODY = _kind("compressed-body", 415)
DATA_FOLDER_GONE = _kind("data-folder-gone", 503)
DATABASE_BUSY = _kind("database-busy", 503)
DIFFERENT_DRIVES = _kind("different-drives", 422)
DISK_FULL = _kind("disk-full", 507)
DRIVE_IS_BEING_CHECKED = _kind("drive-is-being-checked", 409)
DRIVE_IS_CLOSED = _kind("drive-is-closed", 409)
DRIVE_NOT_FOUND = _kind("drive-not-found", 404)
DRIVE_NOT_READY = _kind("drive-not-ready", 409)
DRIVE_NOT_USABLE = _kind("drive-not-usable", 422)
DRIVE_NOT_WHOLE = _kind("drive-not-whole", 410)
FAULT_OF_THE_SERVICE = _kind("fault-of-the-service", 500)
FILE_MISSING = _kind("file-missing", 410)
FILE_NOT_FOUND = _kind("file-not-found", 404)
FILE_NOT_KEPT = _kind("file-not-kept", 410)
FILTER_NOT_VALID = _kind("filter-not-valid", 400)
FORMAT_NOT_INSTALLED = _kind("format-not-installed", 501)
IDEMPOTENCY_KEY_USED_BEFORE = _kind("idempotency-key-used-before", 422)
JOB_NOT_ENDED = _kind("job-not-ended", 409)
JOB_NOT_FOUND = _kind("job-not-found", 404)
LABELS_NOT_FOUND = _kind("labels-not-found", 422)
LIMIT_REACHED = _kind("limit-reached", 422)
MAP_IN_USE = _kind("map-in-use", 409)
MAP_NEEDED = _kind("map-needed", 422)
MAP_NOT_FOUND = _kind("map-not-found", 422)
MODEL_NOT_USABLE = _kind("model-not-usable", 422)
NAMES_IN_CONFLICT = _kind("names-in-conflict", 409)
NO_RESULTS = _kind("no-results", 404)
MAP_IS_OF_THE_SERVER = _kind("map-is-of-the-server", 409)
NO_SUCH_MAP = _kind("no-such-map", 404)
NO_SUCH_FINDING = _kind("no-such-finding", 404)
NO_SUCH_COLLECTION = _kind("no-such-collection", 404)
NO_SUCH_FEATURE = _kind("no-such-feature", 404)
NO_SUCH_KEYFRAME = _kind("no-such-keyframe", 404)
NO_SUCH_RANGE = _kind("no-such-range", 416)
NOT_JSON = _kind("not-json", 415, title="Not JSON")
NOT_A_MAP = _kind("not-a-map", 422)
NOT_AN_ARCHIVE = _kind("not-an-archive", 415)
NOT_FOUND = _kind("not-found", 404)
NOT_GEOREFERENCED = _kind("not-georeferenced", 404)
NOT_IN_THE_TRASH = _kind("not-in-the-trash", 404)
NOT_IN_THIS_RESULT = _kind("not-in-this-result", 404)
NOT_MULTIPART_FORM_DATA = _kind("not-multipart-form-data", 415, title="Not multipart/form-data")
NOT_POSSIBLE = _kind("not-possible", 500)
NOT_SCORED = _kind("not-scored", 404)
WEBHOOK_REFUSED = _kind("webhook-refused", 422)
SOURCE_REFUSED = _kind("source-refused", 422)
NOT_USED = _kind("not-used", 422)
OVERPASS_SWITCHED_OFF = _kind("overpass-switched-off", 422)
PART_OF_A_FILE = _kind("part-of-a-file", 400)
PLACE_NEEDED = _kind("place-needed", 422)
QUOTA_USED_UP = _kind("quota-used-up", 413)
REQUEST_NOT_VALID = _kind("request-not-valid", 422)
REQUEST_OF_ANOTHER_SITE = _kind("request-of-another-site", 403)
RESULT_DAMAGED = _kind("result-damaged", 500)
RESULT_IS_GONE = _kind("result-is-gone", 410)
RESULT_NOT_READY = _kind("result-not-ready", 409)
SERVER_LOST = _kind("server-lost", 500)
STORAGE_READ_ONLY = _kind("storage-read-only", 503, title="Storage read-only")
TOKEN_MAY_ONLY_READ = _kind("token-may-only-read", 403)
TOKEN_NEEDED = _kind("token-needed", 401)
TOO_LARGE = _kind("too-large", 413)
TOO_MANY_FILES = _kind("too-many-files", 413)
TOO_MANY_JOBS = _kind("too-many-jobs", 429)
TOO_MANY_MAPS = _kind("too-many-maps", 429)
TOO_MANY_SESSIONS = _kind("too-many-sessions", 429)
TOO_MANY_UPLOADS = _kind("too-many-uploads", 429)
UNKNOWN_HOST_NAME = _kind("unknown-host-name", 421)
UNKNOWN_PARAMETER = _kind("unknown-parameter", 400)
UPLOAD_BROKEN_OFF = _kind("upload-broken-off", 400)
WORKER_LOST = _kind("worker-lost", 500)
WRONG_DIGEST = _kind("wrong-digest", 422)
