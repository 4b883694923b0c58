"""What is in the trash."""

from __future__ import annotations

from datetime import datetime
from typing import Literal

from pydantic import BaseModel, Field

TrashKind = Literal["drives", "jobs"]


class TrashItem(BaseModel):
    """A deleted drive, with its jobs and their results; or a deleted job, with its results."""

    kind: TrashKind
    id: str = Field(examples=["5f0c2b7d9a41e386"])
    name: str = Field(description="Name of the drive, also for a job.")
    title: str | None = Field(None, description="What a job is called; null for a drive.")
    owner: str
    size_bytes: int = Field(description="Size of what is kept of it.")
    deleted_at: datetime
    deleted_by: str | None = Field(description="Client that deleted it; null for an upload that expired.")
    purged_at: datetime = Field(description="When it is deleted for good, unless it is restored.")


class TrashList(BaseModel):
    """A page of the trash, the last deleted first."""

    items: list[TrashItem]
    next: str | None = Field(None, description="Value of `after` for the next page; null on the last page.")
