"""Settings from the YAML files of a model; nothing in them is trusted."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from interloc.errors import ModelError, install
from interloc.files import reason_of

MAX_BYTES = 64 * 1024
"""Of a file of settings; published ones have 3 to 6 KB."""

MAX_DEPTH = 20

_MISSING = object()


@dataclass(frozen=True)
class SettingsFile:
    """What stands in a YAML file, asked for field by field.

    Attributes
    ----------
    path : Path
    values : dict
        As parsed.
    """

    path: Path
    values: dict[Any, Any]

    def has(self, field: str) -> bool:
        """Return whether a field such as ``post.KNN.use`` is there and not empty."""
        return self._find(field) not in (_MISSING, None)

    def is_whole(self, field: str) -> bool:
        """Return whether a field is a whole number."""
        return isinstance(self._find(field), int)

    def whole(self, field: str, lowest: int, highest: int) -> int:
        """Return a whole number.

        Raises
        ------
        ModelError
            It is missing, something else, or out of bounds.
        """
        value = self._get(field, f"a whole number from {lowest:,} to {highest:,}")
        return self._as_whole(field, value, lowest, highest)

    def number(self, field: str, lowest: float, highest: float) -> float:
        """Return a number.

        Raises
        ------
        ModelError
            It is missing, something else, or out of bounds.
        """
        value = self._get(field, f"a number from {lowest:g} to {highest:g}")
        return self._as_number(field, value, lowest, highest)

    def numbers(self, field: str, lowest: float, highest: float) -> tuple[float, ...]:
        """Return the numbers of a list.

        Raises
        ------
        ModelError
            It is missing, no list, or a number is out of bounds.
        """
        values = self._list(field, "a list of numbers")
        return tuple(self._as_number(f"{field}[{i}]", value, lowest, highest) for i, value in enumerate(values))

    def words(self, field: str) -> tuple[str, ...]:
        """Return the words of a list.

        Raises
        ------
        ModelError
            It is missing, no list, or holds something else.
        """
        values = self._list(field, "a list of words")
        for value in values:
            if not isinstance(value, str):
                raise self.fault(field, f"{_shown(value)} is no word.")
        return tuple(values)

    def flag(self, field: str, *, default: bool) -> bool:
        """Return true or false.

        Raises
        ------
        ModelError
            It is something else.
        """
        value = self._find(field)
        if value is _MISSING or value is None:
            return default
        if not isinstance(value, bool):
            raise self.fault(field, f"{_shown(value)}; expected true or false.")
        return value

    def flag_of(self, field: str, key: int, *, default: bool) -> bool:
        """Return true or false for one row of a table of such.

        Raises
        ------
        ModelError
            It is something else.
        """
        rows = self._find(field)
        value = rows.get(key, default) if isinstance(rows, dict) else default
        if not isinstance(value, bool):
            raise self.fault(f"{field}[{key}]", f"{_shown(value)}; expected true or false.")
        return value

    def table(self, field: str, highest_key: int, highest_value: int) -> dict[int, int]:
        """Return a table from whole numbers to whole numbers, both from 0 on.

        Raises
        ------
        ModelError
            It is missing, something else, or a number is out of bounds.
        """
        value = self._get(field, "a table of ids")
        if not isinstance(value, dict) or not value:
            raise self.fault(field, f"{_shown(value)}; expected a table of ids (0: 0, 1: 10, ...).")
        table = {}
        for key, each in value.items():
            row = self._as_whole(f"{field}, a key", key, 0, highest_key)
            table[row] = self._as_whole(f"{field}[{row}]", each, 0, highest_value)
        return table

    def fault(self, field: str, message: str) -> ModelError:
        """Return the error to raise about a field: what was found, what was expected, the usual mistake."""
        return ModelError(f"{self.path}: {field}: {message}")

    def _get(self, field: str, expected: str) -> Any:  # noqa: ANN401 - whatever the file says
        value = self._find(field)
        if value is _MISSING or value is None:
            raise self.fault(
                field,
                f"is missing; expected {expected}. Usual cause: a file of another kind "
                "(arch_cfg.yaml describes the sensor and the image, data_cfg.yaml the classes).",
            )
        return value

    def _find(self, field: str) -> Any:  # noqa: ANN401 - whatever the file says
        value: Any = self.values
        for name in field.split("."):
            if not isinstance(value, dict):
                return _MISSING
            value = value.get(name, _MISSING)
        return value

    def _list(self, field: str, expected: str) -> list[Any]:
        value = self._get(field, expected)
        if not isinstance(value, list):
            raise self.fault(field, f"{_shown(value)}; expected {expected}.")
        return value

    def _as_whole(self, field: str, value: object, lowest: int, highest: int) -> int:
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int) or not lowest <= value <= highest:
            raise self.fault(field, f"{_shown(value)}; expected a whole number from {lowest:,} to {highest:,}.")
        return value

    def _as_number(self, field: str, value: object, lowest: float, highest: float) -> float:
        number = math.nan
        if isinstance(value, int | float | str) and not isinstance(value, bool):
            try:
                number = float(value)  # to YAML, 1e-3 is a word
            except (ValueError, OverflowError):
                number = math.nan
        if not lowest <= number <= highest:  # NaN is not
            raise self.fault(field, f"{_shown(value)}; expected a number from {lowest:g} to {highest:g}.")
        return number


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
