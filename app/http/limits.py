"""Limits of uploads: the answer names the limit that was exceeded, and what is allowed."""

from sqlalchemy import func, select
from sqlalchemy.orm import Session
from starlette.requests import Request

from app.context import Context
from app.http.problem_types import COMPRESSED_BODY, PART_OF_A_FILE, QUOTA_USED_UP, TOO_LARGE, TOO_MANY_FILES
from app.http.problems import Problem, disk_full
from app.settings import MB
from app.store.models import CityMap, Drive, Token

CLOSE = {"Connection": "close"}
"""Sent when a body is refused before it is read: the rest of it would be taken for the next request."""


def declared_length(request: Request, limit: int, what: str) -> int | None:
    """Return the Content-Length, None where the body comes in chunks; refuse one above the limit (413).

    A body that is a part of a file is a 400, a compressed one a 415.
    """
    if "content-range" in request.headers:  # RFC 9110, section 14.5: it may not be ignored
        raise Problem(
            PART_OF_A_FILE,
            "Content-Range: files are taken whole only. To resume an upload, send the files that "
            "GET /api/v1/drives/{id}/files does not list.",
            headers=CLOSE,
        )
    coding = request.headers.get("content-encoding", "identity").strip().lower()
    transfer = request.headers.get("transfer-encoding", "chunked").strip().lower()
    is_plain = coding in {"", "identity"}
    if not is_plain or transfer != "chunked":
        raise Problem(
            COMPRESSED_BODY,
            f"{f'Transfer-Encoding: {transfer}' if is_plain else f'Content-Encoding: {coding}'}. Send the file as it "
            "is; files that are compressed themselves (map.osm.gz) need no Content-Encoding.",
            headers={"Accept-Encoding": "identity", **CLOSE},
        )
    text = request.headers.get("content-length")
    if text is None:
        return None
    length = int(text)  # the HTTP parser has refused everything else
    if length > limit:
        raise too_large(what, limit)
    return length


def too_large(what: str, limit: int) -> Problem:
    """Return the problem that a body is larger than allowed."""
    size = f"{limit / MB:,.0f} MB" if limit >= MB else f"{limit:,} bytes"
    return Problem(TOO_LARGE, f"{what} may have {size} at most. Nothing was kept.", headers=CLOSE)


def check_free_space(context: Context, needed: int) -> None:
    """Refuse (507) what would leave too little space on the disk."""
    if context.storage.free_bytes() - needed < context.settings.min_free_bytes:
        raise disk_full(headers=CLOSE)


def check_drive(context: Context, files: int, size: int) -> None:
    """Refuse (413) what makes a drive too large, by the files and bytes that it would have."""
    settings = context.settings
    if size > settings.max_drive_bytes:
        raise too_large("All files of a drive together", settings.max_drive_bytes)
    if files > settings.max_drive_files:
        raise Problem(
            TOO_MANY_FILES,
            f"A drive may have {settings.max_drive_files:,} files at most. Leave out what the method does not need "
            "(images), or cut the drive.",
            headers=CLOSE,
        )


def check_quota(context: Context, session: Session, owner: str, sender: str, more: int) -> None:
    """Refuse (413) what a client may not store any more by its token: a drive or map counts for its owner.

    Whose token has a limit sends to its own drives only, or it would have none. The transaction is the one that stores
    it: those of one client come here one after the other.
    """
    if sender != owner and context.tokens.named(sender).max_bytes is not None:
        detail = f"The token of {sender} has a limit of bytes, so it sends to drives and maps of its own only."
        raise Problem(QUOTA_USED_UP, detail, headers=CLOSE)
    allowed = context.tokens.named(owner).max_bytes
    if allowed is None or more <= 0:
        return
    session.execute(select(Token.name).where(Token.name == owner).with_for_update())
    sums = select(func.sum(Drive.stored_bytes)), select(func.sum(CityMap.osm_bytes))
    owners = Drive.owner, CityMap.owner
    kept = sum(int(session.scalar(of.where(by == owner)) or 0) for of, by in zip(sums, owners, strict=True))
    if kept + more > allowed:
        raise Problem(
            QUOTA_USED_UP,
            f"What {owner} keeps takes {kept / MB:,.0f} MB; with {more / MB:,.1f} MB more it would exceed the "
            f"{allowed / MB:,.0f} MB that its token allows. Nothing was kept; delete drives that are no longer needed.",
            headers=CLOSE,
        )


def job_limit(context: Context, owner: str) -> int:
    """Return how many jobs of one kind a client may have that wait or run."""
    allowed = context.tokens.named(owner).max_jobs
    limit = context.settings.max_queued_jobs
    return limit if allowed is None else min(limit, allowed)
