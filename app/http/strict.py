"""Types of bodies that take what their schema says: no number as text, no 0 for false; names, notes and ids."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Strict, StringConstraints

from app.http.patterns import NAME, NOTE


class Body(BaseModel):
    """What a client sends: a member that it does not have is refused."""

    model_config = ConfigDict(extra="forbid")


def _refuse_text(value: object) -> object:
    if isinstance(value, str | bool):
        raise ValueError(f"{str(value)[:40]!r} is not a number")  # noqa: TRY004 - pydantic expects it
    return value


def _refuse_number(value: object) -> object:
    if not isinstance(value, bool):
        raise ValueError("expected true")  # noqa: TRY004 - pydantic expects it
    return value


Flag = Annotated[bool, Strict()]
Yes = Annotated[Literal[True], BeforeValidator(_refuse_number)]
Whole = Annotated[int, BeforeValidator(_refuse_text)]
"""A whole number; 3.0 is one in JSON."""
Number = Annotated[float, BeforeValidator(_refuse_text)]

Name = Annotated[
    str,
    StringConstraints(
        strip_whitespace=True,
        min_length=1,
        max_length=200,
        pattern=NAME,
    ),
]
Note = Annotated[
    str,
    StringConstraints(strip_whitespace=True, max_length=2000, pattern=NOTE),
    AfterValidator(lambda note: note or None),
]
"""Some lines of text; without any it is None."""


def strictly(model: type[BaseModel]) -> BeforeValidator:
    """Read a field of this model strictly, though the model itself is lax: the command line gives it text."""

    def read(value: object) -> object:
        return model.model_validate(value, strict=True) if isinstance(value, dict) else value

    return BeforeValidator(read)
