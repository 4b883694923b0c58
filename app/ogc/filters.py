"""Filters in CQL2 (OGC 21-065): read by the package cql2, bounded, and translated to SQL.

The truth of SQL is that of CQL2: what compares with null is neither true nor false. A spatial condition is one on the
box of a feature, which is the feature itself where it is a point.
"""

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import accumulate
from operator import eq, ge, gt, le, lt, ne
from typing import Any, Literal

import cql2
from sqlalchemy import ColumnElement, and_, false, func, literal, not_, or_, true

from app.http.parameters import Box, refusal
from app.http.problem_types import FILTER_NOT_VALID
from app.http.problems import Problem
from app.ogc.collections import GEOMETRY, Collection
from app.ogc.work import time_text
from interloc.arrays import JsonObject

Language = Literal["cql2-text", "cql2-json", "cql-text"]
"""The last one is that of the draft of the standard, which GDAL speaks."""

MAX_CHARACTERS = 16_000
MAX_DEPTH = 24
MAX_NODES = 300
"""Operators, properties and values of a filter."""

CRS84 = "http://www.opengis.net/def/crs/OGC/1.3/CRS84"

_MAX_WORDS = 2 * MAX_NODES
_QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
_ILIKE = re.compile(r"\b(?P<name>\w+) +ILIKE +(?P<pattern>'(?:[^']|'')*')|'(?:[^']|'')*'", re.IGNORECASE)
_WORD = re.compile(r"\w[\w.]*|[^\w\s,()]")
_GEOMETRY = {"property": GEOMETRY}


def bad_filter(found: str) -> Problem:
    """Return the problem of a filter that cannot be used."""
    return refusal(FILTER_NOT_VALID, "query.filter", found)


def read_filter(content: str, language: Language) -> Any:  # noqa: ANN401 - JSON
    """Read a filter as CQL2 JSON; a 400 where it is none, or too large."""
    if len(content) > MAX_CHARACTERS:
        raise bad_filter(f"It has {len(content):,} characters, more than {MAX_CHARACTERS:,}.")
    if language == "cql-text":
        content = _ILIKE.sub(_without_ilike, content)
    plain = _QUOTED.sub("x", content)
    nesting = accumulate((each in "([{") - (each in ")]}") for each in plain)
    if max(nesting, default=0) > MAX_DEPTH:  # before any parser sees it: theirs are recursive
        raise bad_filter(f"It is nested deeper than {MAX_DEPTH} levels.")
    # Chains of words are nested, too.
    if language != "cql2-json" and sum(1 for _ in _WORD.finditer(plain)) > _MAX_WORDS:
        raise bad_filter(f"It is larger than {MAX_NODES} parts.")
    try:
        if language == "cql2-json":
            content = json.dumps(json.loads(content, parse_constant=_no_number))
        expression = cql2.parse_json(content) if language == "cql2-json" else cql2.parse_text(content)
        # Not what cql2 makes of numbers, which are all float64 there: as JSON, where NaN and infinity are null.
        tree = json.loads(json.dumps(expression.to_json()), parse_constant=_no_number)
    except (cql2.ParseError, cql2.ValidationError, ValueError, RecursionError) as error:
        raise bad_filter(f"It is not {language}: {_short(error)}") from None
    _refuse_large(tree)
    return tree


def _without_ilike(match: re.Match[str]) -> str:
    """Return texts as they are, and ILIKE, which CQL2 does not have, as LIKE of folded cases."""
    if match["name"] is None:
        return match[0]
    return f"CASEI({match['name']}) LIKE CASEI({match['pattern']})"


def equals(name: str, text: str, kind: str) -> Any:  # noqa: ANN401 - JSON
    """Return the filter that a property has a value, which stands in the address; a 400 where it has no such values."""
    with suppress(ValueError, TypeError, OverflowError, RecursionError):
        value = text if kind in {"text", "time"} else json.loads(text, parse_constant=_no_number)
        if isinstance(value, str) or (isinstance(value, bool) == (kind == "bool") and math.isfinite(value)):
            return {"op": "=", "args": [{"property": name}, value]}
    expected = "true or false" if kind == "bool" else "a number"
    raise bad_filter(f"{name}={_shown(text)} is not valid. Expected {expected}.")


def _short(error: Exception) -> str:
    """Return what is wrong with a filter in one line."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    expected = [line for line in lines if line.startswith("= ")]
    place = lines[0].removeprefix("--> 1:") if lines and lines[0].startswith("--> 1:") else ""
    text = f"at character {place}, {expected[0][2:]}" if place and expected else (lines[0] if lines else "empty")
    return text[:200].rstrip(".") + "."


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is not a number that a filter can hold")


def _refuse_large(tree: Any) -> None:  # noqa: ANN401
    """Refuse a tree of too many parts, or too deep."""
    level, parts, depth = [tree], 1, 0
    while level:
        if parts > MAX_NODES or depth > MAX_DEPTH:
            limit = f"nested deeper than {MAX_DEPTH} levels" if depth > MAX_DEPTH else f"larger than {MAX_NODES} parts"
            raise bad_filter(f"It is {limit}.")
        level = [part for node in level for part in _parts_of(node)]
        parts, depth = parts + len(level), depth + 1


def _parts_of(node: Any) -> Iterator[Any]:  # noqa: ANN401
    arguments = node.get("args") if isinstance(node, dict) else None
    for each in arguments if isinstance(arguments, list) else ():
        yield from each if isinstance(each, list) else (each,)


def conjuncts(tree: Any) -> Iterator[Any]:  # noqa: ANN401
    """Yield the parts of a filter that must all hold."""
    parts = tree.get("args") if isinstance(tree, dict) and tree.get("op") == "and" else None
    if isinstance(parts, list) and parts:
        for each in parts:
            yield from conjuncts(each)
    else:
        yield tree


def equalities(tree: Any) -> Iterator[tuple[str, str | float]]:  # noqa: ANN401
    """Yield properties with values that they must have."""
    for each in conjuncts(tree):
        arguments = each.get("args") if isinstance(each, dict) and each.get("op") == "=" else None
        if isinstance(arguments, list):
            names = [a["property"] for a in arguments if isinstance(a, dict) and isinstance(a.get("property"), str)]
            values = [a for a in arguments if isinstance(a, str | float | int)]
            if names and values:
                yield names[0], values[0]


@dataclass(frozen=True)
class _Value:
    kind: str
    """number, id, bool, text or time."""
    sql: ColumnElement[Any]
    text: str | None = None
    """Of a text that the filter holds."""
    number: float | None = None
    """Of a number that it holds."""
    column: ColumnElement[Any] | None = None
    """Of a property, whatever the case of its letters."""


@dataclass
class Translator:
    """Turns a filter into conditions of SQL."""

    collection: Collection
    columns: Mapping[str, ColumnElement[Any]]
    """Of each queryable."""
    near: Callable[[Box], ColumnElement[bool]]
    """Returns the condition that the box of a feature touches another one."""
    is_sqlite: bool
    used: set[str] = field(default_factory=set)
    """Names of the properties in the conditions."""

    def condition(self, node: Any) -> ColumnElement[bool]:  # noqa: ANN401 - JSON
        """Return the condition of a filter; a 400 for what it cannot hold."""
        if isinstance(node, bool):
            return true() if node else false()
        name, arguments = self._operation(node) if isinstance(node, dict) else ("", [])
        if name in _COMPARISONS:
            return self._compared(name, *map(self._value, arguments))
        if name == "s_intersects":
            return self._near(*arguments)
        others: dict[str, Callable[..., ColumnElement[bool]]] = {
            "and": lambda *parts: and_(*map(self.condition, parts)),
            "or": lambda *parts: or_(*map(self.condition, parts)),
            "not": lambda part: not_(self.condition(part)),
            "isnull": lambda part: (self.columns[GEOMETRY] if part == _GEOMETRY else self._value(part).sql).is_(None),
            "like": self._like,
            "between": lambda *nodes: self._between(*map(self._value, nodes)),
            "in": self._in,
        }
        if name not in others:
            raise bad_filter(f"{_shown(node)} is not true or false.")
        return others[name](*arguments)

    def _between(self, value: _Value, low: _Value, high: _Value) -> ColumnElement[bool]:
        return and_(self._compared(">=", value, low), self._compared("<=", value, high))

    def _in(self, node: Any, among: Any) -> ColumnElement[bool]:  # noqa: ANN401
        if not isinstance(among, list):
            raise bad_filter("in takes a list of values.")
        value = self._value(node)
        return or_(false(), *(self._compared("=", value, self._value(each)) for each in among))

    def _operation(self, node: JsonObject) -> tuple[str, list[Any]]:
        """Return the name of an operator, in small letters, and its arguments."""
        name, arguments = str(node.get("op")).lower(), node.get("args")
        if name not in _OPERATORS:
            known = ", ".join(sorted(_OPERATORS))
            raise bad_filter(f"There is no operator or function {_shown(node.get('op'))} here. There are {known}.")
        expected = _OPERATORS[name]
        count = len(arguments) if isinstance(arguments, list) else 0
        if not (count > 1 if name in {"and", "or"} else count == expected):
            raise bad_filter(f"{name} takes {expected} arguments.")
        return name, node["args"]

    def _value(self, node: Any) -> _Value:  # noqa: ANN401
        if isinstance(node, bool):
            return _Value("bool", true() if node else false())
        if isinstance(node, str):
            text = node.replace("\0", "")
            return _Value("text", literal(text), text=text)
        if isinstance(node, int | float):
            return _Value("number", literal(float(node)), number=float(node))
        if isinstance(node, dict) and "property" in node:
            return self._property(node["property"])
        if isinstance(node, dict) and len(node) == 1 and node.keys() <= {"timestamp", "date"}:
            return _time_of(str(*node.values()))
        if isinstance(node, dict) and "op" in node:
            name, arguments = self._operation(node)
            value = self._value(arguments[0]) if name == "casei" else None
            if value is not None and value.kind == "text":
                lower = None if value.text is None else value.text.lower()
                sql = value.sql if self.is_sqlite else value.sql.collate("default")  # of which "C" knows ASCII only
                return _Value("text", func.lower(sql), text=lower, column=value.column)
        raise bad_filter(f"{_shown(node)} cannot stand here.")

    def _property(self, name: Any) -> _Value:  # noqa: ANN401
        kinds = self.collection.queryables
        kind = kinds.get(name) if isinstance(name, str) else None
        if kind is None:
            hint = f" {GEOMETRY} can be compared by s_intersects only." if name == GEOMETRY else ""
            raise bad_filter(
                f"{self.collection.id} has no property {_shown(name)} for filters.{hint} There are "
                f"{', '.join(sorted(kinds))}."
            )
        self.used.add(name)
        column = self.columns[name]
        return _Value("number" if kind in {"int", "float"} else kind, column, column=column)

    def _compared(self, name: str, one: _Value, other: _Value) -> ColumnElement[bool]:
        one, other = _as_other(one, other), _as_other(other, one)
        if one.kind != other.kind:
            raise bad_filter(f"{name} compares two values of different types.")
        found: ColumnElement[bool] = _COMPARISONS[name](one.sql, other.sql)
        return found

    def _like(self, node: Any, pattern: Any) -> ColumnElement[bool]:  # noqa: ANN401
        value, like = self._value(node), self._value(pattern)
        text = value.sql
        if value.kind != "text" or like.text is None:
            raise bad_filter("like compares a text with a pattern.")
        pieces = re.findall(r"\\(.?)|([%_])|([^\\])", like.text, re.DOTALL)
        if self.is_sqlite:
            signs = {"%": "*", "_": "?"}  # of GLOB: LIKE does not tell upper from lower case there
            globs = [signs[sign] if sign else re.sub(r"([*?[])", r"[\1]", one + other) for one, sign, other in pieces]
            found = text.bool_op("GLOB")("".join(globs))
        else:
            plain = [sign or re.sub(r"([%_\\])", r"\\\1", one + other) for one, sign, other in pieces]
            found = text.like("".join(plain), escape="\\")
        # As true as what is found, but a range of an index that holds no features without a text.
        return found if value.column is None else and_(value.column >= "", found)

    def _near(self, left: Any, right: Any) -> ColumnElement[bool]:  # noqa: ANN401
        """Return the condition that the box of a feature touches a box or a point that the filter holds."""
        given = right if left == _GEOMETRY else left
        if _GEOMETRY not in (left, right) or not isinstance(given, dict):
            raise bad_filter(f"s_intersects compares {GEOMETRY} with a BBOX or a POINT.")
        return self.near(_box_of(given))


def _as_other(value: _Value, other: _Value) -> _Value:
    """Return a value that a filter holds as the kind that it is compared with."""
    if other.kind == "bool" and value.number in {0.0, 1.0}:
        return _Value("bool", true() if value.number else false())  # as GDAL writes it
    if other.kind == "text" and value.number is not None and value.number.is_integer():  # an id
        return _Value("text", literal(str(int(value.number))))
    return _time_of(value.text) if other.kind == "time" and value.text is not None else value


def _time_of(text: str) -> _Value:
    """Return a time of a filter; a date is the begin of the day."""
    try:
        moment = datetime.fromisoformat(text)
        return _Value("time", literal(time_text(moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC))))
    except ValueError:
        raise bad_filter(f"{_shown(text)} is not a time as 2026-01-31T12:00:00Z, or a date.") from None
    except OverflowError:
        raise bad_filter(f"{_shown(text)} is too far away.") from None


def _box_of(given: JsonObject) -> Box:
    """Return the box that a filter holds, or that of its point; a 400 where it is none of longitudes and latitudes."""
    place = given.get("bbox", given.get("coordinates") if given.get("type") == "Point" else None)
    numbers = place if isinstance(place, list) and all(isinstance(each, int | float) for each in place) else []
    corners = {2: (0, 1, 0, 1), 3: (0, 1, 0, 1), 4: (0, 1, 2, 3), 6: (0, 1, 3, 4)}.get(len(numbers))
    if corners is None:
        raise bad_filter(f"s_intersects takes a BBOX or a POINT here, and found {_shown(given)}.")
    box = Box(*(float(numbers[each]) for each in corners))
    if not box.is_on_earth:
        raise bad_filter("Positions are longitude and latitude, degrees; the south of a BBOX is not above its north.")
    return box


def _shown(value: Any) -> str:  # noqa: ANN401
    """Return a part of a filter as a message names it."""
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else f"{text[:60]}..."


_COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {"=": eq, "<>": ne, "<": lt, ">": gt, "<=": le, ">=": ge}
_OPERATORS = {
    **dict.fromkeys((*_COMPARISONS, "and", "or", "like", "in", "s_intersects"), 2),
    "not": 1,
    "isnull": 1,
    "casei": 1,
    "between": 3,
}
"""Name -> number of arguments."""
