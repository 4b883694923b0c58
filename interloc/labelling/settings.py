"""Settings from the YAML files of a model; nothing in them is trusted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

from pydantic import BeforeValidator, Field, StrictBool, StrictStr, TypeAdapter, ValidationError

from interloc.errors import ModelError, install
from interloc.files import reason_of

MAX_BYTES = 64 * 1024
"""Of a file of settings; published ones have 3 to 6 KB."""

MAX_DEPTH = 20

T = TypeVar("T")


@dataclass(frozen=True)
class Kind(Generic[T]):
    """What a field must be."""

    type: Any
    """Of pydantic."""
    expected: str
    """How messages call it."""
    each: str = ""
    """How they call a part of it, where it is a list or a table."""


def _no_flag(value: Any) -> Any:  # noqa: ANN401 - whatever the file says
    if isinstance(value, bool):
        raise ValueError("a flag is no number")  # noqa: TRY004 - pydantic turns it into its own error
    return value


@cache
def whole(lowest: int, highest: int) -> Kind[int]:
    """Return the kind of whole numbers within bounds."""
    bounded = Annotated[int, Field(ge=lowest, le=highest), BeforeValidator(_no_flag)]
    return Kind(bounded, f"a whole number from {lowest:,} to {highest:,}")


@cache
def number(lowest: float, highest: float) -> Kind[float]:
    """Return the kind of numbers within bounds; to YAML, 1e-3 is a word."""
    bounded = Annotated[float, Field(ge=lowest, le=highest, allow_inf_nan=False), BeforeValidator(_no_flag)]
    return Kind(bounded, f"a number from {lowest:g} to {highest:g}")


def numbers(lowest: float, highest: float) -> Kind[list[float]]:
    """Return the kind of lists of numbers within bounds."""
    each = number(lowest, highest)
    return Kind(list[each.type], "a list of numbers", each.expected)  # type: ignore[name-defined]


def table(highest_key: int, highest_value: int) -> Kind[dict[int, int]]:
    """Return the kind of tables from whole numbers to whole numbers, both from 0 on."""
    key, value = whole(0, highest_key), whole(0, highest_value)
    rows = Annotated[dict[key.type, value.type], Field(min_length=1)]  # type: ignore[name-defined]
    return Kind(rows, "a table of ids (0: 0, 1: 10, ...)", value.expected)


FLAG: Kind[bool] = Kind(StrictBool, "true or false")
WORDS: Kind[list[str]] = Kind(list[StrictStr], "a list of words", "a word")


@dataclass(frozen=True)
class SettingsFile:
    """What stands in a YAML file, asked for field by field."""

    path: Path
    values: dict[Any, Any]
    """As parsed."""

    def find(self, field: str) -> Any:  # noqa: ANN401 - whatever the file says
        """Return what stands in a field such as ``post.KNN.use``; None where it is missing or empty."""
        value: Any = self.values
        for name in field.split("."):
            value = value.get(int(name) if name.isdigit() else name) if isinstance(value, dict) else None
        return value

    def read(self, field: str, kind: Kind[T], default: T | None = None) -> T:
        """Return a field of a kind.

        Raises
        ------
        ModelError
            It is missing and has no default, is something else, or out of bounds.
        """
        value = self.find(field)
        if value is None and default is not None:
            return default
        if value is None:
            raise self.fault(
                field,
                f"is missing; expected {kind.expected}. Usual cause: a file of another kind "
                "(arch_cfg.yaml describes the sensor and the image, data_cfg.yaml the classes).",
            )
        try:
            found: T = TypeAdapter(kind.type).validate_python(value)
        except ValidationError as error:
            wrong = error.errors(include_url=False)[0]
            at, expected = wrong["loc"], kind.each if wrong["loc"] else kind.expected
            if at:
                field += ", a key" if at[-1] == "[key]" else f"[{at[0]}]"
            raise self.fault(field, f"{_shown(wrong['input'])}; expected {expected}.") from None
        return found

    def fault(self, field: str, message: str) -> ModelError:
        """Return the error to raise about a field: what was found, what was expected, the usual mistake."""
        return ModelError(f"{self.path}: {field}: {message}")


def read_settings(path: Path) -> SettingsFile:
    """Read a YAML file of settings.

    Raises
    ------
    ModelError
        It is missing, unreadable, larger than any such file, not YAML, uses aliases (which can unfold without bounds),
        or holds no table. Or PyYAML is not installed.
    """
    try:
        import yaml  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise ModelError(f"labels by a network need PyYAML, which is not installed: {install('label')}") from error

    data = _read_bytes(path)
    try:
        _check_structure(path, yaml.parse(data, yaml.SafeLoader), yaml)
        values = yaml.safe_load(data)
    except (yaml.YAMLError, ValueError, OverflowError, TypeError, AttributeError, KeyError, IndexError) as error:
        raise ModelError(f"{path} is not YAML that can be read: {' '.join(str(error).split())[:300]}") from None
    if not isinstance(values, dict):
        raise ModelError(f"{path}: expected a table of settings (name: value); {_shown(values)}.")
    return SettingsFile(path, values)


def _check_structure(path: Path, events: Iterator[Any], yaml: Any) -> None:  # noqa: ANN401 - a module without types
    """Refuse, before anything is made of it, what could unfold or take very long."""
    depth = 0
    for event in events:
        if isinstance(event, yaml.events.AliasEvent):
            raise ModelError(f"{path} uses aliases (*name), which can unfold without bounds. Write the values out.")
        depth += isinstance(event, yaml.events.CollectionStartEvent) - isinstance(event, yaml.events.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise ModelError(f"{path} is nested more than {MAX_DEPTH} deep, which no file of settings is.")


def _read_bytes(path: Path) -> bytes:
    try:
        if path.exists() and not path.is_file():
            raise ModelError(f"{path} is a folder, pipe or device; a file of settings was expected.")
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise ModelError(
            f"{path} is missing. A model is a folder with model.onnx, arch_cfg.yaml and data_cfg.yaml, as the "
            "RangeNet++ / lidar-bonnetal family publishes it."
        ) from None
    except OSError as error:
        raise ModelError(f"{path} cannot be read: {reason_of(error)}.") from error
    if len(data) > MAX_BYTES:
        raise ModelError(f"{path} is larger than {MAX_BYTES // 1024} KB; settings of a model have a few KB.")
    return data


def _shown(value: object) -> str:
    """Return a value as messages show it, shortened."""
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > 64:
        return "a number of many digits"
    text = (
        repr(value)
        if not isinstance(value, list | dict) or len(value) <= 8
        else f"{type(value).__name__} of {len(value)}"
    )
    return f"found {text if len(text) <= 60 else text[:57] + '...'}"
