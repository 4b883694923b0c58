"""Which features match a filter, decided for all of them at once.

What compares with null is neither true nor false (CQL2, 6.2). So truth is 1, falsehood is -1, and 0 is what is not
known: `and` is the minimum, `or` the maximum, `not` the negative.
"""

from __future__ import annotations

import operator
import re
import time
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.ogc.candidates import Candidates
from app.ogc.collections import GEOMETRY
from app.ogc.columns import Texts
from app.ogc.filters import (
    ARITHMETIC,
    CASES,
    COMPARISONS,
    SPATIAL,
    TEMPORAL,
    BadFilterError,
    Filter,
    bad_filter,
    positions_of,
)

_PATIENCE_S = 3.0
_SHAPES_AT_ONCE = 64
_GEOMETRY = {"property": GEOMETRY}

Truth = NDArray[np.int8]
"""1, 0 or -1 for each feature, (N,), or one of them for all, ()."""


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
    """Return which features match.

    Raises
    ------
    Problem
        400: the filter compares what cannot be compared, or takes too long.
    """
    try:
        with np.errstate(all="ignore"):
            truth = _Evaluation(filter_, features).truth(filter_.tree)
            return np.broadcast_to(truth == 1, len(features))
    except BadFilterError as error:
        raise bad_filter(str(error)) from None


class _Evaluation:
    def __init__(self, filter_: Filter, features: Candidates) -> None:
        self._kinds = filter_.kinds
        self._features = features
        self._deadline = time.monotonic() + _PATIENCE_S

    def truth(self, node: Any) -> Truth:  # noqa: ANN401 - JSON
        """Return of which features a part of the filter is true."""
        self._refuse_if_late()
        if isinstance(node, bool):
            return _decided(node)
        if "property" in node:
            flags = self._features.numbers(node["property"])
            return _decided(flags == 1.0, flags)
        name, arguments = node["op"], node["args"]
        if name in COMPARISONS:
            return self._compare(name, *arguments)
        if name in SPATIAL:
            return self._spatial(name, *arguments)
        if name in TEMPORAL:
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
            "in": lambda value, values: reduce(
                np.maximum, (self._compare("=", value, each) for each in values), _decided(False)
            ),
        }
        return others[name](*arguments)

    def _refuse_if_late(self) -> None:
        if time.monotonic() > self._deadline:
            raise BadFilterError("It takes too long. Ask for less of it at a time, or for a smaller bbox.")

    # Values

    def _value(self, node: Any) -> _Value:  # noqa: ANN401
        if isinstance(node, str):
            return node
        if isinstance(node, int | float):
            return _Number(float(node), is_flag=isinstance(node, bool))
        if "property" in node:
            return self._property(node["property"])
        if "op" in node:
            return self._computed(node["op"], node["args"])
        return _span_of(node)

    def _property(self, name: str) -> _Value:
        kind = self._kinds[name]
        if kind == "text":
            return self._features.texts(name)
        numbers = self._features.numbers(name)
        if kind == "time":
            return _Span(numbers, numbers)
        return _Number(numbers, is_flag=kind == "bool", is_id=kind == "id")

    def _computed(self, name: str, arguments: list[Any]) -> _Value:
        values = [self._value(each) for each in arguments]
        if name in CASES:
            (text,) = values
            change = str.casefold if name == "casei" else _without_accents
            if isinstance(text, str):
                return change(text)
            if isinstance(text, Texts):
                return Texts([change(each) for each in text.values], text.codes)
            raise BadFilterError(f"{name} takes a text.")
        numbers = [each.value for each in values if isinstance(each, _Number) and not each.is_flag]
        if name not in ARITHMETIC or len(numbers) != 2:
            raise BadFilterError(f"{name} takes two numbers here.")
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
        raise BadFilterError(f"{name} compares two values of different types.")

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
            raise BadFilterError("like compares a text with a pattern.")
        fits = _pattern(like)
        return _of_texts(text, lambda each: fits.fullmatch(each) is not None)

    # Time

    def _temporal(self, name: str, left: Any, right: Any) -> Truth:  # noqa: ANN401
        one, other = self._span(left), self._span(right)
        ends = one.begin, one.end, other.begin, other.end
        return _decided(_TEMPORAL[name](*ends), *ends)

    def _span(self, node: Any) -> _Span:  # noqa: ANN401
        if isinstance(node, dict) and "interval" in node:
            first, last = node["interval"]
            return _Span(
                -np.inf if first == ".." else self._span(first).begin, np.inf if last == ".." else self._span(last).end
            )
        value = self._value(node)
        if isinstance(value, str):
            value = _instant(value)
        if not isinstance(value, _Span):
            raise BadFilterError(f"{_shown_time(node)} is not a time.")
        return value

    # Space

    def _spatial(self, name: str, left: Any, right: Any) -> Truth:  # noqa: ANN401
        import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

        literal = _geometry(right if left == _GEOMETRY else left)
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


def _shown_time(node: Any) -> str:  # noqa: ANN401
    return str(node)[:60]


def _instant(text: str) -> _Span:
    return _span_of({"timestamp" if "T" in text.upper() else "date": text})


def _span_of(node: dict[str, Any]) -> _Span:
    """Return a time of a filter; a date is the day."""
    text = node.get("timestamp", node.get("date"))
    try:
        begin = datetime.fromisoformat(str(text))
    except ValueError:
        raise BadFilterError(f"{_shown_time(text)} is not a time as 2026-01-31T12:00:00Z, or a date.") from None
    begin = begin if begin.tzinfo is not None else begin.replace(tzinfo=UTC)
    try:
        end = begin if "timestamp" in node else begin + timedelta(days=1) - timedelta(microseconds=1)
        return _Span(begin.timestamp(), end.timestamp())
    except OverflowError:
        raise BadFilterError(f"{_shown_time(text)} is too far away.") from None


def _geometry(literal: dict[str, Any]) -> Any:  # noqa: ANN401 - a geometry of shapely
    import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

    corners = list(positions_of(literal))
    if not all(abs(value) <= 540.0 for corner in corners for value in corner):
        raise BadFilterError("Positions are longitude and latitude, degrees.")
    if "bbox" in literal:
        (west, south), (east, north) = corners
        if south > north:
            raise BadFilterError("The south of a bbox is not above its north.")
        if west <= east:
            return shapely.box(west, south, east, north)
        return shapely.union(shapely.box(west, south, east + 360.0, north), shapely.box(-180.0, south, east, north))
    try:
        geometry = shapely.geometry.shape(literal)
    except (shapely.errors.ShapelyError, ValueError, TypeError, KeyError, AttributeError):
        raise BadFilterError("It holds a geometry with too few positions, or with rings that do not close.") from None
    if geometry.is_empty or not geometry.is_valid:
        raise BadFilterError(f"It holds a geometry that is not valid: {shapely.is_valid_reason(geometry)[:100]}.")
    return geometry


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
