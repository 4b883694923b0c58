"""Which features match a filter, decided for all of them at once.

What compares with null is neither true nor false (CQL2, 6.2). So truth is 1, falsehood is -1, and 0 is what is not
known: `and` is the minimum, `or` the maximum, `not` the negative.
"""

from __future__ import annotations

import json
import operator
import re
import time
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app.http.parameters import refusal
from app.http.problem_types import FILTER_NOT_VALID
from app.http.problems import Problem
from app.ogc.candidates import Candidates
from app.ogc.collections import GEOMETRY, Collection
from app.ogc.columns import Texts

MAX_SPATIAL = 8
"""Spatial operators of a filter."""
MAX_VERTICES = 2000
"""Vertices of all its geometries."""

_PATIENCE_S = 3.0
_SHAPES_AT_ONCE = 64
_GEOMETRY = {"property": GEOMETRY}

Truth = NDArray[np.int8]
"""1, 0 or -1 for each feature, (N,), or one of them for all, ()."""


@dataclass(frozen=True)
class Filter:
    """A filter that was checked."""

    tree: Any
    """Of CQL2 JSON."""
    collection: Collection
    area: tuple[float, ...] | None = None
    """West, south, east, north of a box outside of which nothing matches."""
    equal: dict[str, str] = field(default_factory=dict)
    """Texts that properties must have."""


@dataclass(frozen=True)
class _Number:
    """A number of each feature, or one for all; NaN for null."""

    value: Any
    is_flag: bool = False
    is_id: bool = False  # shown as a text


@dataclass(frozen=True)
class _Span:
    """Begin and end of each feature, seconds since 1970, or one for all; NaN for null."""

    begin: Any
    end: Any


_Value = Texts | str | _Number | _Span


def matching(filter_: Filter, features: Candidates) -> NDArray[np.bool_]:
    """Return which features match; a 400 where that takes too long."""
    with np.errstate(all="ignore"):
        truth = _Evaluation(filter_.collection, features).truth(filter_.tree)
        return np.broadcast_to(truth == 1, len(features))


def bad_filter(found: str) -> Problem:
    """Return the problem of a filter that cannot be used."""
    return refusal(FILTER_NOT_VALID, "query.filter", found)


def check(tree: Any, collection: Collection) -> None:  # noqa: ANN401 - JSON
    """Refuse (400) what cannot be evaluated, by evaluating it on no features."""
    _Evaluation(collection, Candidates(Session(), [], collection.is_point, collection.of_results)).truth(tree)


class _Evaluation:
    def __init__(self, collection: Collection, features: Candidates) -> None:
        self._collection = collection
        self._features = features
        self._deadline = time.monotonic() + _PATIENCE_S
        self._spatials = self._vertices = 0

    def truth(self, node: Any) -> Truth:  # noqa: ANN401 - JSON
        """Return of which features a part of the filter is true."""
        self._refuse_if_late()
        if isinstance(node, bool):
            return _decided(node)
        if isinstance(node, dict) and "property" in node:
            flag = self._property(node["property"])
            if not isinstance(flag, _Number) or not flag.is_flag:
                raise bad_filter(f"{node['property']} alone is not true or false. Compare it with a value.")
            return _decided(flag.value == 1.0, flag.value)
        name, arguments = self._operation(node) if isinstance(node, dict) else ("", [])
        if name in _COMPARISONS:
            return self._compare(name, *arguments)
        if name in SPATIAL:
            return self._spatial(name, *arguments)
        if name in _TEMPORAL:
            return self._temporal(name, *arguments)
        others: dict[str, Callable[..., Truth]] = {
            "and": lambda *parts: reduce(np.minimum, map(self.truth, parts)),
            "or": lambda *parts: reduce(np.maximum, map(self.truth, parts)),
            "not": lambda part: np.negative(self.truth(part)),
            "isNull": self._is_null,
            "like": self._like,
            "between": lambda value, low, high: np.minimum(
                self._compare("<=", low, value), self._compare("<=", value, high)
            ),
            "in": self._in,
        }
        if name not in others:
            raise bad_filter(f"{shown(node)} is not true or false.")
        return others[name](*arguments)

    def _operation(self, node: dict[str, Any]) -> tuple[str, list[Any]]:
        """Return an operator, as the standard spells it, and its arguments."""
        name = _BY_LOWER.get(str(node.get("op")).lower())
        if name is None:
            raise bad_filter(f"There is no operator or function {shown(node.get('op'))} here.")
        arguments, expected = node.get("args"), _ARGUMENTS.get(name, 2)
        count = len(arguments) if isinstance(arguments, list) else 0
        if not (count > 1 if name in {"and", "or"} else count == expected):
            raise bad_filter(f"{name} takes {expected} arguments.")
        return name, node["args"]

    def _refuse_if_late(self) -> None:
        if time.monotonic() > self._deadline:
            raise bad_filter("It takes too long. Ask for less of it at a time, or for a smaller bbox.")

    # Values

    def _value(self, node: Any) -> _Value:  # noqa: ANN401
        if isinstance(node, str):
            return node
        if isinstance(node, int | float):
            return _Number(float(node), is_flag=isinstance(node, bool))
        if isinstance(node, dict) and "property" in node:
            return self._property(node["property"])
        if isinstance(node, dict) and "op" in node:
            return self._computed(*self._operation(node))
        if isinstance(node, dict) and len(node) == 1 and node.keys() <= {"timestamp", "date"}:
            return _span_of(node)
        raise bad_filter(f"{shown(node)} cannot stand here.")

    def _property(self, name: Any) -> _Value:  # noqa: ANN401
        kinds = self._collection.queryables
        kind = kinds.get(name) if isinstance(name, str) else None
        if kind is None:
            hint = f" {GEOMETRY} can be compared by spatial operators only." if name == GEOMETRY else ""
            raise bad_filter(
                f"{self._collection.id} has no property {shown(name)} for filters.{hint} There are "
                f"{', '.join(sorted(kinds))}."
            )
        if kind == "text":
            return self._features.texts(name)
        numbers = self._features.numbers(name)
        if kind == "time":
            return _Span(numbers, numbers)
        return _Number(numbers, is_flag=kind == "bool", is_id=kind == "id")

    def _computed(self, name: str, arguments: list[Any]) -> _Value:
        values = [self._value(each) for each in arguments]
        if name in _CASES:
            (text,) = values
            change = str.casefold if name == "casei" else _without_accents
            if isinstance(text, str):
                return change(text)
            if isinstance(text, Texts):
                return Texts([change(each) for each in text.values], text.codes)
            raise bad_filter(f"{name} takes a text.")
        numbers = [each.value for each in values if isinstance(each, _Number) and not each.is_flag]
        if name not in _ARITHMETIC or len(numbers) != 2:
            raise bad_filter(f"{name} takes two numbers here.")
        return _Number(_ARITHMETIC[name](*numbers))

    # Comparisons

    def _compare(self, name: str, left: Any, right: Any) -> Truth:  # noqa: ANN401
        compare = _COMPARISONS[name]
        one, other = self._value(left), self._value(right)
        if isinstance(one, str) and isinstance(other, _Span):
            one = _instant(one)
        if isinstance(other, str) and isinstance(one, _Span):
            other = _instant(other)
        one, other = _id_like(one, other), _id_like(other, one)
        if isinstance(one, _Number) and isinstance(other, _Number) and one.is_flag == other.is_flag:
            return _decided(compare(one.value, other.value), one.value, other.value)
        if isinstance(one, _Span) and isinstance(other, _Span):
            return _decided(compare(one.begin, other.begin), one.begin, other.begin)
        if isinstance(one, Texts) and isinstance(other, Texts):
            pairs = [np.array([*each.values, ""], dtype=object)[each.codes] for each in (one, other)]
            return _decided(compare(*pairs)) * ((one.codes >= 0) & (other.codes >= 0))
        if isinstance(one, Texts | str) and isinstance(other, str):
            return _of_texts(one, lambda text: compare(text, other))
        if isinstance(one, str) and isinstance(other, Texts):
            return _of_texts(other, lambda text: compare(one, text))
        raise bad_filter(f"{name} compares two values of different types.")

    def _in(self, value: Any, values: Any) -> Truth:  # noqa: ANN401
        if not isinstance(values, list):
            raise bad_filter("in takes a list of values.")
        return reduce(np.maximum, (self._compare("=", value, each) for each in values), _decided(False))

    def _is_null(self, node: Any) -> Truth:  # noqa: ANN401
        if node == _GEOMETRY:
            return _decided(np.isnan(self._features.boxes()[:, 0]))
        value = self._value(node)
        if isinstance(value, Texts | str):
            return _decided(isinstance(value, Texts) and value.codes < 0)
        return _decided(np.isnan(value.begin if isinstance(value, _Span) else value.value))

    def _like(self, node: Any, pattern: Any) -> Truth:  # noqa: ANN401
        text, like = self._value(node), self._value(pattern)
        if isinstance(text, _Number) and text.is_id:
            text = _as_texts(text)
        if not isinstance(text, Texts | str) or not isinstance(like, str):
            raise bad_filter("like compares a text with a pattern.")
        fits = _pattern(like)
        return _of_texts(text, lambda each: fits.fullmatch(each) is not None)

    # Time

    def _temporal(self, name: str, left: Any, right: Any) -> Truth:  # noqa: ANN401
        one, other = self._span(left), self._span(right)
        ends = one.begin, one.end, other.begin, other.end
        return _decided(_TEMPORAL[name](*ends), *ends)

    def _span(self, node: Any) -> _Span:  # noqa: ANN401
        if isinstance(node, dict) and "interval" in node:
            if not isinstance(node["interval"], list) or len(node["interval"]) != 2:
                raise bad_filter("An interval has two ends.")
            first, last = node["interval"]
            return _Span(
                -np.inf if first == ".." else self._span(first).begin, np.inf if last == ".." else self._span(last).end
            )
        value = self._value(node)
        if isinstance(value, str):
            value = _instant(value)
        if not isinstance(value, _Span):
            raise bad_filter(f"{shown(node)} is not a time.")
        return value

    # Space

    def _spatial(self, name: str, left: Any, right: Any) -> Truth:  # noqa: ANN401
        import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

        given = right if left == _GEOMETRY else left
        if _GEOMETRY not in (left, right) or not isinstance(given, dict) or given == _GEOMETRY:
            raise bad_filter(f"{name} compares {GEOMETRY} with a geometry that the filter holds.")
        literal = geometry_of(given)
        self._spatials, self._vertices = self._spatials + 1, self._vertices + shapely.get_num_coordinates(literal)
        if self._spatials > MAX_SPATIAL:
            raise bad_filter(f"It has more than {MAX_SPATIAL} spatial operators.")
        if self._vertices > MAX_VERTICES:
            raise bad_filter(f"Its geometries have more than {MAX_VERTICES:,} vertices.")
        if left == _GEOMETRY:  # the prepared geometry comes first
            name = {"s_within": "s_contains", "s_contains": "s_within"}.get(name, name)
        boxes = self._features.boxes()
        west, south, east, north = literal.bounds
        near = (boxes[:, 0] <= east) & (boxes[:, 2] >= west) & (boxes[:, 1] <= north) & (boxes[:, 3] >= south)
        places = np.flatnonzero(near)
        test = getattr(shapely, name.removeprefix("s_"))
        shapely.prepare(literal)
        yes = ~near if name == "s_disjoint" else np.zeros(len(boxes), dtype=np.bool_)
        has_vertices = np.any(boxes[places, 0] != boxes[places, 2])  # they are no points: there may be many
        at_once = _SHAPES_AT_ONCE * (1 if has_vertices else 256)
        for start in range(0, len(places), at_once):
            self._refuse_if_late()
            some = places[start : start + at_once]
            yes[some] = test(literal, self._features.shapes(some))
        return _decided(yes, boxes[:, 0])


def _decided(yes: Any, *values: Any) -> Truth:  # noqa: ANN401 - bool, or (N,) bool
    """Return what is true and what is false; neither where one of these values is NaN."""
    truth = 2 * np.asarray(yes, dtype=np.int8) - np.int8(1)
    for each in values:
        truth = truth * ~np.isnan(each)
    return truth


def _of_texts(texts: Texts | str, holds: Callable[[str], bool]) -> Truth:
    """Return for which features something holds that is looked at once for each different text."""
    if isinstance(texts, str):
        return _decided(holds(texts))
    return np.append(_decided([holds(each) for each in texts.values]), np.int8(0))[texts.codes]


def _id_like(value: _Value, other: _Value) -> _Value:
    """Return an id that a filter holds as a text as the number that it is, where it is compared with a property."""
    if isinstance(value, str) and isinstance(other, _Number) and other.is_id:
        return _Number(float(value) if re.fullmatch(r"[+-]?\d{1,15}", value) else np.nan)
    return value


def _as_texts(ids: _Number) -> Texts:
    known, codes = np.unique(ids.value, return_inverse=True)  # NaN comes last
    known = known[~np.isnan(known)]
    codes = np.where(codes < len(known), codes, -1)
    return Texts([f"{each:.0f}" for each in known.tolist()], codes.astype(np.int32))


def _pattern(pattern: str) -> re.Pattern[str]:
    r"""Return a pattern as a regular expression: % is any text, _ one character, \ takes the next one as it is.

    The texts between % are looked for one after the other and never again (atomic groups): no pattern takes long.
    """
    pieces = [""]
    for escaped, sign, plain in re.findall(r"\\(.?)|([%_])|([^\\])", pattern, re.DOTALL):
        if sign == "%":
            pieces.append("")
        else:
            pieces[-1] += "." if sign else re.escape(escaped + plain)
    first, *middle = pieces
    last = f".*{middle.pop()}" if middle else ""
    return re.compile("".join([first, *(f"(?>.*?{piece})" for piece in middle if piece), last]), re.DOTALL)


def _without_accents(text: str) -> str:
    return "".join(each for each in unicodedata.normalize("NFD", text) if not unicodedata.combining(each))


def _instant(text: str) -> _Span:
    return _span_of({"timestamp" if "T" in text.upper() else "date": text})


def _span_of(node: dict[str, Any]) -> _Span:
    """Return a time of a filter; a date is the day."""
    text = node.get("timestamp", node.get("date"))
    try:
        begin = datetime.fromisoformat(str(text))
    except ValueError:
        raise bad_filter(f"{shown(text)} is not a time as 2026-01-31T12:00:00Z, or a date.") from None
    begin = begin if begin.tzinfo is not None else begin.replace(tzinfo=UTC)
    try:
        end = begin if "timestamp" in node else begin + timedelta(days=1) - timedelta(microseconds=1)
        return _Span(begin.timestamp(), end.timestamp())
    except OverflowError:
        raise bad_filter(f"{shown(text)} is too far away.") from None


def geometry_of(literal: dict[str, Any]) -> Any:  # noqa: ANN401 - a geometry of shapely
    """Return a geometry that a filter holds; a 400 where it is not one of longitudes and latitudes."""
    import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

    geometry: Any
    try:
        if "bbox" in literal:
            west, south, east, north = box_of(literal)
            geometry = shapely.box(west, south, east + 360.0 * (west > east), north)
            if west > east:
                geometry = shapely.union(geometry, shapely.box(-180.0, south, east, north))
            if south > north:
                raise bad_filter("The south of a bbox is not above its north.")
        else:
            geometry = shapely.geometry.shape(literal)
    except (shapely.errors.ShapelyError, ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError):
        raise bad_filter(
            f"{shown(literal)} is not a geometry, or has too few positions or rings that do not close."
        ) from None
    if not (np.abs(shapely.get_coordinates(geometry)) <= 540.0).all():
        raise bad_filter("Positions are longitude and latitude, degrees.")
    if geometry.is_empty or not geometry.is_valid:
        raise bad_filter(f"It holds a geometry that is not valid: {shapely.is_valid_reason(geometry)[:100]}.")
    return geometry


def box_of(literal: dict[str, Any]) -> tuple[float, ...]:
    """Return west, south, east, north of a bbox of 4 numbers, or of 6 with heights."""
    box = literal["bbox"]
    if not isinstance(box, list) or len(box) not in {4, 6}:
        raise bad_filter(f"{shown(box)} is not a bbox: it has 4 or 6 numbers.")
    numbers, half = [float(each) for each in box], len(box) // 2
    return (*numbers[:2], *numbers[half : half + 2])


def shown(value: Any) -> str:  # noqa: ANN401
    """Return a part of a filter as a message names it."""
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else f"{text[:60]}..."


_COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {
    "=": operator.eq,
    "<>": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
}
_ARITHMETIC: dict[str, Callable[[Any, Any], Any]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "%": np.fmod,
    "div": lambda a, b: np.trunc(np.divide(a, b)),
    "^": np.power,
}
# Begin and end of one time and of the other (CQL2, table 7).
_TEMPORAL: dict[str, Callable[[Any, Any, Any, Any], Any]] = {
    "t_after": lambda a, _b, _c, d: a > d,
    "t_before": lambda _a, b, c, _d: b < c,
    "t_contains": lambda a, b, c, d: (a < c) & (b > d),
    "t_disjoint": lambda a, b, c, d: (a > d) | (b < c),
    "t_during": lambda a, b, c, d: (a > c) & (b < d),
    "t_equals": lambda a, b, c, d: (a == c) & (b == d),
    "t_finishedBy": lambda a, b, c, d: (a < c) & (b == d),
    "t_finishes": lambda a, b, c, d: (a > c) & (b == d),
    "t_intersects": lambda a, b, c, d: (a <= d) & (b >= c),
    "t_meets": lambda _a, b, c, _d: b == c,
    "t_metBy": lambda a, _b, _c, d: a == d,
    "t_overlappedBy": lambda a, b, c, d: (a > c) & (a < d) & (b > d),
    "t_overlaps": lambda a, b, c, d: (a < c) & (b > c) & (b < d),
    "t_startedBy": lambda a, b, c, d: (a == c) & (b > d),
    "t_starts": lambda a, b, c, d: (a == c) & (b < d),
}
SPATIAL = {f"s_{name}" for name in ("intersects", "disjoint", "within", "contains", "equals")}
SPATIAL |= {"s_touches", "s_crosses", "s_overlaps"}
_CASES = ("casei", "accenti")
_BY_LOWER = {
    name.lower(): name
    for name in (
        *("and", "or", "not", "like", "between", "in", "isNull"),
        *_CASES,
        *SPATIAL,
        *_COMPARISONS,
        *_TEMPORAL,
        *_ARITHMETIC,
    )
}
_ARGUMENTS = {"not": 1, "isNull": 1, "between": 3, **dict.fromkeys(_CASES, 1)}
