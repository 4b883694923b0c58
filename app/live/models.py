"""What a sender says at first, and what is told about a session."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, TypeAdapter

from app.http.patterns import ID, Body


class Begin(Body):
    """Begins a session."""

    type: Literal["begin"]
    name: str = Field(min_length=1, max_length=200, description="Name of the drive.")
    preset: Literal["default", "paper"] = Field("default", description="Settings to start from.")
    config: dict[str, Any] | None = Field(
        None, description="Settings that differ; `keyframes.lookahead` is the number of keyframes an answer waits for."
    )
    label_scheme: str = Field(
        "semantickitti", max_length=200, description="Scheme of the labels, or the ids of road with commas between."
    )
    keep: bool = Field(False, description="Make a drive of the keyframes; at the end it is checked, and a job runs.")


class Continue(Body):
    """Goes on with a session after a broken connection."""

    type: Literal["continue"]
    session: str = Field(pattern=ID)
    answered: int = Field(-1, ge=-1, description="Last scan whose answer arrived: those after it come again.")


class End(Body):
    """Ends the session: the last keyframes are answered, then the map."""

    type: Literal["end"]


SENT = TypeAdapter[Begin | Continue | End](Annotated[Begin | Continue | End, Field(discriminator="type")])
"""Texts that a sender may send."""


class LiveModel(BaseModel):
    """A live session."""

    id: str
    name: str
    state: Literal["driving", "waiting", "ended"] = Field(
        description="driving; waiting: the sender is away, and may go on with it; ended."
    )
    georeferenced: bool = Field(description="Whether places are longitude and latitude, else metres of W.")
    keyframes: int
    dropped: int = Field(description="Scans that were dropped because the session fell behind.")
    intersections: int
    links: dict[str, str] = Field(description="`events`: what happens, as server-sent events.")


class LiveList(BaseModel):
    """The live sessions of this server, the newest first."""

    sessions: list[LiveModel]
