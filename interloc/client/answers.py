"""The answers of the service, as far as the client reads them; members that it does not know are ignored."""

from __future__ import annotations

from typing import Any, Literal, TypeVar

import httpx
from pydantic import BaseModel, Field, ValidationError

from interloc.errors import NetworkError

Model = TypeVar("Model", bound=BaseModel)

PROBLEM_TYPE = "application/problem+json"
_SHOWN_PROBLEMS = 20


class DriveAnswer(BaseModel):
    """A drive."""

    id: str = Field(pattern=r"^[\w-]{1,64}$")
    name: str
    state: str
    report: dict[str, Any] | None = None


class DrivesAnswer(BaseModel):
    """A page of drives."""

    drives: list[DriveAnswer]


class FileAnswer(BaseModel):
    """A file of a drive."""

    path: str
    size_bytes: int
    sha256: str


class FilesAnswer(BaseModel):
    """A page of files."""

    files: list[FileAnswer]
    next: str | None = None


class ProgressAnswer(BaseModel):
    """The progress of a job."""

    done: int = 0
    total: int | None = None


class FileProblemAnswer(BaseModel):
    """A problem with one file of a drive."""

    severity: str = "error"
    path: str = ""
    message: str = ""

    def __str__(self) -> str:
        return f"{self.path}: {self.message}" if self.path else self.message


class ProblemAnswer(BaseModel):
    """A problem document (RFC 9457)."""

    title: str = ""
    status: int = 0
    detail: str = ""
    problems: list[FileProblemAnswer] | None = None

    def __str__(self) -> str:
        text = ": ".join(dict.fromkeys(part for part in (self.title, self.detail) if part)) or f"status {self.status}"
        errors = [str(problem) for problem in self.problems or () if problem.severity == "error"]
        new = [error for error in errors if error.rstrip(".") not in text]
        rest = len(new) - _SHOWN_PROBLEMS
        more = [f"and {rest} more"] if rest > 0 else []
        return "\n  ".join([text, *new[:_SHOWN_PROBLEMS], *more])


class JobAnswer(BaseModel):
    """A job."""

    id: str = Field(pattern=r"^[\w-]{1,64}$")
    drive_id: str
    drive_name: str = ""
    state: Literal["accepted", "running", "successful", "failed", "dismissed"]
    stage: str = ""
    message: str | None = None
    progress: ProgressAnswer = ProgressAnswer()
    error: ProblemAnswer | None = None
    summary: dict[str, Any] | None = None
    version: int = 0
    request: dict[str, Any] = {}

    @property
    def is_final(self) -> bool:
        """True when the job will not change any more."""
        return self.state in {"successful", "failed", "dismissed"}


class JobsAnswer(BaseModel):
    """Some jobs."""

    jobs: list[JobAnswer] = Field(max_length=1000)


class ResultFileAnswer(BaseModel):
    """A file of a result."""

    name: str = Field(min_length=1, max_length=512)
    size_bytes: int = Field(ge=0)


class ResultFilesAnswer(BaseModel):
    """All files of a result."""

    files: list[ResultFileAnswer] = Field(max_length=100_000)


class Refusal(NetworkError):  # noqa: N818 - an answer of the server, not a fault
    """The service did not do what was asked, and says why.

    Attributes
    ----------
    status : int
        Status code of HTTP.
    problem : ProblemAnswer
    """

    def __init__(self, status: int, problem: ProblemAnswer, hint: str = "") -> None:
        super().__init__(f"{problem} {hint}".strip())
        self.status = status
        self.problem = problem


def check(response: httpx.Response, server: str) -> httpx.Response:
    """Return an answer that is a success.

    Raises
    ------
    Refusal
        The service refuses and says why.
    NetworkError
        Something other than a service of InterLoc answered.
    """
    if response.is_success:
        return response
    if media_type(response) == PROBLEM_TYPE:
        problem = parse(response, ProblemAnswer, server)
        hint = "Give a token of this server by INTERLOC_TOKEN or --token." if response.status_code == 401 else ""
        raise Refusal(response.status_code, problem, hint)
    if response.is_redirect:
        target = response.headers.get("location", "elsewhere")
        raise NetworkError(f"{server} redirects to {target}. Give the address that it moved to as the server.")
    raise NetworkError(
        f"{server} answered {response.status_code} {response.reason_phrase} to {response.request.method} "
        f"{response.request.url.path}, which is not how an InterLoc server answers. Expected the address of one, "
        "such as http://127.0.0.1:8000. Usual cause: the address of another server, or a proxy before it that refuses "
        "large bodies or is restarting."
    )


def parse(response: httpx.Response, model: type[Model], server: str) -> Model:
    """Read the JSON of an answer.

    Raises
    ------
    NetworkError
        The answer is not what an InterLoc server sends.
    """
    try:
        return model.model_validate_json(response.content)
    except ValidationError as error:
        found = media_type(response) or "nothing"
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise NetworkError(
            f"{server} answered {response.request.method} {response.request.url.path} with {found} that is not what an "
            f"InterLoc server answers ({where + ': ' if where else ''}{first['msg']}). Usual cause: the address of "
            "another server, or one of another version."
        ) from None


def media_type(response: httpx.Response) -> str:
    """Return the media type of an answer, without its parameters."""
    return str(response.headers.get("content-type", "")).partition(";")[0].strip().lower()
