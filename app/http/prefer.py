"""How long a client wants to wait for work (RFC 7240): ``Prefer: wait=10`` or ``respond-async``."""

from __future__ import annotations

import re

DEFAULT_S = 50
MAX_S = 300


def wait_of(prefer: str | None) -> int:
    """Return the seconds that a request may wait for the end of its work; what is not understood is ignored."""
    seconds = DEFAULT_S
    for preference in (prefer or "").split(","):
        name, _, value = preference.split(";")[0].strip().lower().partition("=")
        if name.strip() == "respond-async":
            seconds = 0
        elif name.strip() == "wait" and re.fullmatch(r'\s*"?\d{1,9}"?\s*', value):
            return min(int(value.strip(' "')), MAX_S)
    return seconds
