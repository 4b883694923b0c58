"""Types of bodies that take what their schema says: no number as text, no 0 for false; and ids in addresses."""

from __future__ import annotations

import json
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, Strict

Flag = Annotated[bool, Strict()]
Whole = Annotated[int, Strict()]
Number = Annotated[float, Strict()]

ID_PATTERN = r"^[A-Za-z0-9_-]{1,64}$"
"""What ids of drives and jobs look like; there may be one or not."""


def strictly(model: type[BaseModel]) -> BeforeValidator:
    """Read a field of this model as strict JSON, though the model itself is lax: the command line gives it text."""

    def read(value: object) -> object:
        return model.model_validate_json(json.dumps(value), strict=True) if isinstance(value, dict) else value

    return BeforeValidator(read)
