"""The states of drives and jobs, the kinds of jobs, the scopes of tokens: values of the database and of REST."""

from enum import StrEnum


class DriveState(StrEnum):
    """The state of a drive."""

    UPLOADING = "uploading"
    """It takes files."""
    CHECKING = "checking"
    """Its commit job waits or runs."""
    READY = "ready"
    """It was committed: jobs can use it, and it takes no files but maps."""


class JobState(StrEnum):
    """The state of a job."""

    ACCEPTED = "accepted"
    RUNNING = "running"
    SUCCESSFUL = "successful"
    FAILED = "failed"
    DISMISSED = "dismissed"


ACTIVE = (JobState.ACCEPTED, JobState.RUNNING)
FINAL = (JobState.SUCCESSFUL, JobState.FAILED, JobState.DISMISSED)
"""States that do not change any more."""


class JobKind(StrEnum):
    """What a job does."""

    INTERSECTIONS = "intersections"
    COMMIT = "commit"
    UNPACK = "unpack"
    DEMO = "demo"


class Scope(StrEnum):
    """What the holder of a token may do."""

    READ = "read"
    """Look at everything, change nothing."""
    WRITE = "write"
