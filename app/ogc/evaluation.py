"""Which features match a filter, decided for all of them at once.

What compares with null is neither true nor false (CQL2, 6.2): `Truth` keeps both, so that `not` of it is neither, too.
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
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

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
from interloc.arrays import FloatArray

_PATIENCE_S = 3.0
_SHAPES_AT_ONCE = 64

Mask = NDArray[np.bool_]


class Features(Protocol):
    """The features that are asked about."""

    def __len__(self) -> int:
        """Return how many there are."""

    def numbers(self, name: str) -> FloatArray:
        """Return a property that is a number, a flag or a time (seconds since 1970), NaN for null."""

    def texts(self, name: str) -> Texts:
        """Return a property that is a text."""

    def boxes(self) -> FloatArray:
        """Return west, south, east, north of each, (N, 4); NaN without geometry."""

    def shapes(self, places: NDArray[np.int64]) -> NDArray[np.object_]:
        """Return the geometries of some."""


@dataclass(frozen=True)
class Truth:
    """Of which features something is true, and of which false; neither where it is not known.

    Attributes
    ----------
    yes, no : (N,) bool
    """

    yes: Mask
    no: Mask


@dataclass(frozen=True)
class _Text:
    """A text of each feature, or one for all."""

    value: Texts | str

    def mapped(self, function: Callable[[str], str]) -> _Text:
        """Return it with each text changed."""
        if isinstance(self.value, str):
            return _Text(function(self.value))
        return _Text(Texts([function(each) for each in self.value.values], self.value.codes))


@dataclass(frozen=True)
class _Number:
    """A number of each feature, or one for all."""

    value: Any
    kind: str


@dataclass(frozen=True)
class _Span:
    """Begin and end of each feature, seconds since 1970, or one for all."""

    begin: Any
    end: Any


def matching(filter_: Filter, features: Features) -> Mask:
    """Return which features match.

    Raises
    ------
    Problem
        400: the filter compares what cannot be compared, or takes too long.
    """
    try:
        with np.errstate(all="ignore"):
            return _Evaluation(filter_, features).truth(filter_.tree).yes
    except BadFilterError as error:
        raise bad_filter(str(error)) from None


class _Evaluation:
    def __init__(self, filter_: Filter, features: Features) -> None:
        self._kinds = filter_.kinds
        self._features = features
        self._deadline = time.monotonic() + _PATIENCE_S

    def truth(self, node: Any) -> Truth:  # noqa: ANN401 - JSON
        """Return of which features a part of the filter is true."""
        self._refuse_if_late()
        if isinstance(node, bool):
            return self._known(np.full(len(self._features), node))
        if "property" in node:
            flags = self._features.numbers(node["property"])
            return Truth(flags == 1.0, flags == 0.0)
        name, arguments = node["op"], node["args"]
        if name in COMPARISONS:
            return self._compare(name, *arguments)
        if name in SPATIAL:
            return self._spatial(name, arguments)
        if name in TEMPORAL:
            return self._temporal(name, *arguments)
        others: dict[str, Callable[..., Truth]] = {
            "and": self._and,
            "or": lambda *parts: _not(self._and(*({"op": "not", "args": [part]} for part in parts))),
            "not": lambda part: _not(self.truth(part)),
            "isNull": lambda value: self._known(self._is_null(value)),
            "like": self._like,
            "between": self._between,
            "in": self._in,
        }
        return others[name](*arguments)

    def _refuse_if_late(self) -> None:
        if time.monotonic() > self._deadline:
            raise BadFilterError("It takes too long. Ask for less of it at a time, or for a smaller bbox.")

    def _and(self, *parts: Any) -> Truth:  # noqa: ANN401
        truths = [self.truth(each) for each in parts]
        return Truth(
            reduce(operator.and_, (each.yes for each in truths)), reduce(operator.or_, (each.no for each in truths))
        )

    def _between(self, value: Any, low: Any, high: Any) -> Truth:  # noqa: ANN401
        above, below = self._compare("<=", low, value), self._compare("<=", value, high)
        return Truth(above.yes & below.yes, above.no | below.no)

    def _in(self, value: Any, values: list[Any]) -> Truth:  # noqa: ANN401
        parts = [self._compare("=", value, each) for each in values]
        yes = reduce(operator.or_, (each.yes for each in parts), np.zeros(len(self._features), dtype=np.bool_))
        no = reduce(operator.and_, (each.no for each in parts), np.ones(len(self._features), dtype=np.bool_))
        return Truth(yes, no)

    def _known(self, yes: Mask) -> Truth:
        return Truth(yes, ~yes)

    # Values

    def _value(self, node: Any) -> _Text | _Number | _Span:  # noqa: ANN401
        if isinstance(node, bool):
            return _Number(float(node), "bool")
        if isinstance(node, int | float):
            return _Number(float(node), "number")
        if isinstance(node, str):
            return _Text(node)
        if "property" in node:
            return self._property(node["property"])
        if "op" in node:
            return self._computed(node["op"], node["args"])
        return _span_of(node)

    def _property(self, name: str) -> _Text | _Number | _Span:
        kind = self._kinds[name]
        if kind == "text":
            return _Text(self._features.texts(name))
        numbers = self._features.numbers(name)
        if kind == "time":
            return _Span(numbers, numbers)
        return _Number(numbers, "bool" if kind == "bool" else "number")

    def _computed(self, name: str, arguments: list[Any]) -> _Text | _Number:
        values = [self._value(each) for each in arguments]
        if name in CASES:
            (text,) = values
            if not isinstance(text, _Text):
                raise BadFilterError(f"{name} takes a text.")
            return text.mapped(str.casefold if name == "casei" else _without_accents)
        one, other = values if name in ARITHMETIC else (None, None)
        if not isinstance(one, _Number) or not isinstance(other, _Number) or "bool" in {one.kind, other.kind}:
            raise BadFilterError(f"{name} takes two numbers here.")
        return _Number(_ARITHMETIC[name](one.value, other.value), "number")

    # Comparisons

    def _compare(self, name: str, left: Any, right: Any) -> Truth:  # noqa: ANN401
        one, other = self._alike(self._value(left), self._value(right))
        if isinstance(one, _Text) and isinstance(other, _Text):
            return self._compare_texts(name, one, other)
        if isinstance(one, _Number) and isinstance(other, _Number) and one.kind == other.kind:
            return self._compare_numbers(name, one.value, other.value)
        if isinstance(one, _Span) and isinstance(other, _Span):
            return self._compare_numbers(name, one.begin, other.begin)
        raise BadFilterError(f"{name} compares two values of different types.")

    def _alike(self, one: Any, other: Any) -> tuple[Any, Any]:  # noqa: ANN401
        """Return two values, a text as a time where the other one is a time."""
        if isinstance(one, _Span) and isinstance(other, _Text) and isinstance(other.value, str):
            return one, _instant(other.value)
        if isinstance(other, _Span) and isinstance(one, _Text) and isinstance(one.value, str):
            return _instant(one.value), other
        return one, other

    def _compare_numbers(self, name: str, one: Any, other: Any) -> Truth:  # noqa: ANN401
        size = len(self._features)
        yes = np.broadcast_to(_COMPARISONS[name](one, other), size)
        known = np.broadcast_to(~(np.isnan(one) | np.isnan(other)), size)
        return Truth(yes & known, ~yes & known)

    def _compare_texts(self, name: str, one: _Text, other: _Text) -> Truth:
        compare = _COMPARISONS[name]
        left, right = one.value, other.value
        if isinstance(left, str) and isinstance(right, str):
            return self._known(np.full(len(self._features), compare(left, right)))
        if isinstance(right, str):
            assert not isinstance(left, str)
            return _of_texts(left, lambda each: compare(each, right))
        if isinstance(left, str):
            return _of_texts(right, lambda each: compare(left, each))
        known = (left.codes >= 0) & (right.codes >= 0)
        pairs = [np.array([*each.values, ""], dtype=object)[each.codes] for each in (left, right)]
        yes = np.asarray(compare(*pairs), dtype=np.bool_)
        return Truth(yes & known, ~yes & known)

    def _is_null(self, node: Any) -> Mask:  # noqa: ANN401
        if node == {"property": GEOMETRY}:
            return np.isnan(self._features.boxes()[:, 0])
        value = self._value(node)
        if isinstance(value, _Text):
            is_one = isinstance(value.value, str)
            return np.zeros(len(self._features), dtype=np.bool_) if is_one else value.value.codes < 0  # type: ignore[union-attr]
        numbers = value.begin if isinstance(value, _Span) else value.value
        return np.array(np.broadcast_to(np.isnan(numbers), len(self._features)))

    def _like(self, node: Any, pattern: Any) -> Truth:  # noqa: ANN401
        text, like = self._value(node), self._value(pattern)
        if not isinstance(text, _Text) or not isinstance(like, _Text) or not isinstance(like.value, str):
            raise BadFilterError("like compares a text with a pattern.")
        fits = _pattern(like.value)
        if isinstance(text.value, str):
            return self._known(np.full(len(self._features), fits(text.value)))
        return _of_texts(text.value, fits)

    # Time

    def _temporal(self, name: str, left: Any, right: Any) -> Truth:  # noqa: ANN401
        one, other = self._span(left), self._span(right)
        size = len(self._features)
        yes = np.broadcast_to(_TEMPORAL[name](one.begin, one.end, other.begin, other.end), size)
        known = np.ones(size, dtype=np.bool_)
        for each in (one.begin, one.end, other.begin, other.end):
            known = known & ~np.isnan(each)
        return Truth(yes & known, ~yes & known)

    def _span(self, node: Any) -> _Span:  # noqa: ANN401
        if isinstance(node, dict) and "interval" in node:
            begin, end = (
                self._end_of_interval(each, last=last) for each, last in zip(node["interval"], (0, 1), strict=True)
            )
            return _Span(begin, end)
        value = self._value(node)
        if isinstance(value, _Text) and isinstance(value.value, str):
            value = _instant(value.value)
        if not isinstance(value, _Span):
            raise BadFilterError(f"{_shown_time(node)} is not a time.")
        return value

    def _end_of_interval(self, node: Any, *, last: int) -> Any:  # noqa: ANN401
        if node == "..":
            return np.inf if last else -np.inf
        span = self._span(node if isinstance(node, dict) else _typed(node))
        return span.end if last else span.begin

    # Space

    def _spatial(self, name: str, arguments: list[Any]) -> Truth:
        import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

        is_swapped = arguments[0] != {"property": GEOMETRY}
        literal = _geometry(arguments[0] if is_swapped else arguments[1])
        if is_swapped:
            name = {"s_within": "s_contains", "s_contains": "s_within"}.get(name, name)
        boxes = self._features.boxes()
        known = ~np.isnan(boxes[:, 0])
        west, south, east, north = literal.bounds
        near = (boxes[:, 0] <= east) & (boxes[:, 2] >= west) & (boxes[:, 1] <= north) & (boxes[:, 3] >= south)
        places = np.flatnonzero(near)
        test = getattr(shapely, name.removeprefix("s_"))
        shapely.prepare(literal)
        yes = np.zeros(len(boxes), dtype=np.bool_)
        if name == "s_disjoint":
            yes[known & ~near] = True
        at_once = _SHAPES_AT_ONCE * (1 if self._has_parts(places) else 256)
        for start in range(0, len(places), at_once):
            self._refuse_if_late()
            some = places[start : start + at_once]
            shapes = self._features.shapes(some)
            mirrored = {"s_within": shapely.contains, "s_contains": shapely.within}
            # The prepared geometry comes first.
            yes[some] = mirrored[name](literal, shapes) if name in mirrored else test(literal, shapes)
        return Truth(yes & known, ~yes & known)

    def _has_parts(self, places: NDArray[np.int64]) -> bool:
        """Return whether geometries may have many vertices: they are no points."""
        boxes = self._features.boxes()[places]
        return bool(np.any(boxes[:, 0] != boxes[:, 2]))


def _not(truth: Truth) -> Truth:
    return Truth(truth.no, truth.yes)


def _of_texts(texts: Texts, holds: Callable[[str], bool]) -> Truth:
    """Return for which features something holds that is looked at once for each different text."""
    held = np.array([*(holds(each) for each in texts.values), False], dtype=np.bool_)
    yes, known = held[texts.codes], texts.codes >= 0
    return Truth(yes & known, ~yes & known)


def _pattern(pattern: str) -> Callable[[str], bool]:
    r"""Return the test of a pattern: % is any text, _ one character, \ takes the next one as it is.

    The texts between % are looked for one after the other, so that no pattern takes long.
    """
    pieces: list[list[str]] = [[]]  # regular expressions of one character each
    is_escaped = False
    for character in pattern:
        if is_escaped or character not in "%_\\":
            pieces[-1].append(re.escape(character))
            is_escaped = False
        elif character == "\\":
            is_escaped = True
        elif character == "_":
            pieces[-1].append(".")
        else:
            pieces.append([])
    first, *middle = (re.compile("".join(piece), re.DOTALL) for piece in pieces)
    if not middle:
        return lambda text: first.fullmatch(text) is not None
    last, tail = middle.pop(), len(pieces[-1])

    def fits(text: str) -> bool:
        found = first.match(text)
        for each in middle:
            found = found and each.search(text, found.end())
        return found is not None and len(text) - tail >= found.end() and last.match(text, len(text) - tail) is not None

    return fits


def _without_accents(text: str) -> str:
    return "".join(each for each in unicodedata.normalize("NFD", text) if not unicodedata.combining(each))


def _typed(text: str) -> dict[str, str]:
    return {"timestamp" if "T" in text.upper() else "date": text}


def _shown_time(node: Any) -> str:  # noqa: ANN401
    return str(node)[:60]


def _instant(text: str) -> _Span:
    return _span_of(_typed(text))


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
    """Return a geometry of a filter."""
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
