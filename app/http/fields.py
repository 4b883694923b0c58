"""Fields of what clients send: their patterns, what a refusal asks for, and bodies that take no more."""

from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Strict,
    StringConstraints,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)

from interloc.drives.options import CRS_PATTERN, PART_PATTERN

_UNSEEN = r"\x00-\x1f\x7f\u2028-\u202e\u2066-\u2069"  # the last of them turn around the text that follows
_PRINTED = rf"[^{_UNSEEN}]*"
_NUMBER = r"[+-]?([0-9]{1,12}(\.[0-9]{0,30})?|\.[0-9]{1,30})([eE][+-]?[0-9]{1,3})?"

TEXT = r"^[^\x00]*$"
NAME = rf"^{_PRINTED}[^\s{_UNSEEN}]{_PRINTED}$"  # not only blanks
NOTE = r"^[^\x00-\x08\x0b-\x1f\x7f]*$"
NETWORK = r"^[^./\\\x00-\x1f][^/\\\x00-\x1f]*$"
ID = r"^[A-Za-z0-9_-]{1,64}$"
"""What ids of drives and jobs look like; there may be one or not."""
BOX = rf"^ *{_NUMBER}( *, *{_NUMBER}){{3}}(( *, *{_NUMBER}){{2}})? *$"
"""Four numbers, or six with heights, as OGC API - Features has them."""

EXPECTED = {
    TEXT: "text without zero characters",
    NAME: "a name in one line, not only blanks and without control characters",
    NOTE: "text without control characters other than tabs and line ends",
    NETWORK: "the name of a network as GET /api/v1/models lists it",
    ID: "an id: 1 to 64 letters, digits, hyphens and underscores",
    PART_PATTERN: "a part of the drive by scan numbers, as 200:1400",
    CRS_PATTERN: "a coordinate system by authority and code, as EPSG:25832",
    BOX: "west,south,east,north in degrees: longitudes from -180 to 180, latitudes from -90 to 90, south not above "
    "north. Usual mistake: latitude first",
}


class Body(BaseModel, extra="forbid"):
    """What a client sends: a member that it does not have is refused."""


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

Name = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=200, pattern=NAME)]
Note = Annotated[
    str,
    StringConstraints(strip_whitespace=True, max_length=2000, pattern=NOTE),
    AfterValidator(lambda note: note or None),
]
"""Some lines of text; without any it is None."""


def one_of(expected: str) -> WrapValidator:
    """Read one of several models; pydantic would tell what is none of them once for each, by its name in Python."""

    def read(value: object, handler: ValidatorFunctionWrapHandler) -> object:
        try:
            return handler(value)
        except ValidationError:
            raise ValueError(f"found {repr(value)[:60]}; expected {expected}") from None

    return WrapValidator(read)


def strictly(model: type[BaseModel]) -> BeforeValidator:
    """Read a field of this model strictly, though the model itself is lax: the command line gives it text."""

    def read(value: object) -> object:
        return model.model_validate(value, strict=True) if isinstance(value, dict) else value

    return BeforeValidator(read)
