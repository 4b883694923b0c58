"""The list of the files of a result."""

from __future__ import annotations

from pydantic import BaseModel, Field


class ResultFile(BaseModel):
    """A file of a result."""

    name: str = Field(examples=["figures/map.svg"])
    size_bytes: int
    media_type: str = Field(examples=["image/svg+xml"])
    href: str = Field(examples=["/api/v1/jobs/9b1e44f00c7a2d53/files/figures/map.svg"])


class ResultFileList(BaseModel):
    """All files of a result: the result folder exactly as the command line writes it."""

    files: list[ResultFile]
