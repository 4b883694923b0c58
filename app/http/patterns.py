"""Patterns of the texts that clients send, and what they ask for in words: a refusal says these."""

from __future__ import annotations

from interloc.drives.options import CRS_PATTERN, PART_PATTERN

_PRINTED = r"[^\x00-\x1f\x7f]*"
_NUMBER = r"[+-]?([0-9]{1,12}(\.[0-9]{0,30})?|\.[0-9]{1,30})([eE][+-]?[0-9]{1,3})?"

TEXT = r"^[^\x00]*$"
NAME = rf"^{_PRINTED}[^\s\x00-\x1f\x7f]{_PRINTED}$"  # not only blanks
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
