"""Filters in CQL2 (OGC 21-065): read and checked by the package cql2, bounded here before and after.

What a filter may hold is a tree of operators over the queryables of a collection; anything else is refused, and so is
what is too large or too deep. `app.ogc.evaluation` decides for all features at once whether they match.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import cql2

from app.http.parameters import refusal
from app.http.problem_types import FILTER_NOT_VALID
from app.http.problems import Problem
from app.ogc.collections import GEOMETRY, Collection

Language = Literal["cql2-text", "cql2-json", "cql-text"]
"""The last one is that of the draft of the standard, which GDAL speaks."""

MAX_CHARACTERS = 16_000
MAX_DEPTH = 24
MAX_NODES = 300
"""Operators, properties and values of a filter."""
MAX_SPATIAL = 8
"""Spatial operators of a filter."""
MAX_VERTICES = 2000
"""Vertices of all its geometries."""

_MAX_WORDS = 2 * MAX_NODES
_QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
_COORDINATES = re.compile(r"\([-+0-9.eE,()\s]*\)")
_CHAIN = re.compile(rf"(?:\bnot\s+|-\s*){{{MAX_DEPTH}}}", re.IGNORECASE)
_ILIKE = re.compile(r"\b(?P<name>\w+) +ILIKE +(?P<pattern>'(?:[^']|'')*')|'(?:[^']|'')*'", re.IGNORECASE)
_WORD = re.compile(r"\w[\w.]*|[^\w\s,()]")

CRS84 = "http://www.opengis.net/def/crs/OGC/1.3/CRS84"

LOGICAL = {"and", "or", "not"}
COMPARISONS = {"=", "<>", "<", ">", "<=", ">="}
OTHER_COMPARISONS = {"like", "between", "in", "isNull"}
SPATIAL = {
    "s_intersects",
    "s_disjoint",
    "s_within",
    "s_contains",
    "s_equals",
    "s_touches",
    "s_crosses",
    "s_overlaps",
}
TEMPORAL = {
    "t_after",
    "t_before",
    "t_contains",
    "t_disjoint",
    "t_during",
    "t_equals",
    "t_finishedBy",
    "t_finishes",
    "t_intersects",
    "t_meets",
    "t_metBy",
    "t_overlappedBy",
    "t_overlaps",
    "t_startedBy",
    "t_starts",
}
ARITHMETIC = {"+", "-", "*", "/", "%", "div", "^"}
CASES = {"casei", "accenti"}
_OPERATORS = LOGICAL | COMPARISONS | OTHER_COMPARISONS | SPATIAL | TEMPORAL | ARITHMETIC | CASES
_BY_LOWER = {name.lower(): name for name in _OPERATORS}
_ARGUMENTS = {"not": 1, "isNull": 1, "between": 3, **dict.fromkeys(CASES, 1)}
_BOOLEAN = LOGICAL | COMPARISONS | OTHER_COMPARISONS | SPATIAL | TEMPORAL


class BadFilterError(Exception):
    """The filter cannot be used; the text says why."""


@dataclass(frozen=True)
class Filter:
    """A filter that was checked."""

    tree: Any
    """Of CQL2 JSON."""
    kinds: Mapping[str, str]
    """Property -> int, float, bool, text or time."""
    area: tuple[float, float, float, float] | None = None
    """West, south, east, north of a box outside of which nothing matches."""
    equal: dict[str, str] = field(default_factory=dict)
    """Texts that properties must have."""


def read_filter(
    content: str | None, language: Language, collection: Collection, values: Mapping[str, str] | None = None
) -> Filter:
    """Read a filter on the features of a collection.

    Parameters
    ----------
    content
        What must be true of them.
    language
        That it is written in.
    collection
        Theirs.
    values
        Queryables with the values that they must have, too, as they stand in addresses.

    Raises
    ------
    Problem
        400: it is not CQL2, is too large, or names what there is not.
    """
    try:
        parts = [] if content is None else [_parse(content, language)]
        if language == "cql-text":
            parts = [_with_truth_values(part, collection) for part in parts]
        for name, text in (values or {}).items():
            parts.append({"op": "=", "args": [{"property": name}, _value(name, text, collection)]})
        tree = parts[0] if len(parts) == 1 else {"op": "and", "args": parts}
        _Check(collection).predicate(tree)
    except BadFilterError as error:
        raise bad_filter(str(error)) from None
    return Filter(tree, collection.queryables, _area_of(tree), dict(_equalities(tree)))


def bad_filter(found: str) -> Problem:
    """Return the problem of a filter that cannot be used."""
    return refusal(FILTER_NOT_VALID, "query.filter", found)


def _parse(content: str, language: Language) -> Any:  # noqa: ANN401 - JSON
    if len(content) > MAX_CHARACTERS:
        raise BadFilterError(f"It has {len(content):,} characters, more than {MAX_CHARACTERS:,}.")
    if language == "cql-text":
        content = _ILIKE.sub(_without_ilike, content)
    if _nesting(content) > MAX_DEPTH or _CHAIN.search(content):  # before any parser sees it: theirs are recursive
        raise BadFilterError(f"It is nested deeper than {MAX_DEPTH} levels.")
    if language != "cql2-json" and _words(content) > _MAX_WORDS:  # likewise
        raise BadFilterError(f"It is larger than {MAX_NODES} parts.")
    try:
        if language == "cql2-json":
            content = json.dumps(json.loads(content, parse_constant=_no_number))
        expression = cql2.parse_json(content) if language == "cql2-json" else cql2.parse_text(content)
        # Not what cql2 makes of numbers, which are all float64 there: as JSON, where NaN and infinity are null.
        return json.loads(json.dumps(expression.to_json()), parse_constant=_no_number)
    except (cql2.ParseError, cql2.ValidationError, ValueError, RecursionError) as error:
        raise BadFilterError(f"It is not {language}: {_short(error)}") from None


def _without_ilike(match: re.Match[str]) -> str:
    """Return texts as they are, and ILIKE, which CQL2 does not have, as LIKE of folded cases."""
    if match["name"] is None:
        return match[0]
    return f"CASEI({match['name']}) LIKE CASEI({match['pattern']})"


def _with_truth_values(tree: Any, collection: Collection) -> Any:  # noqa: ANN401 - JSON
    """Return a tree with true and false where a property that is one of them is compared with 1 or 0."""
    if not isinstance(tree, dict) or "args" not in tree:
        return tree
    arguments = [_with_truth_values(each, collection) for each in tree["args"]]
    names = [each["property"] for each in arguments if isinstance(each, dict) and "property" in each]
    if any(collection.queryables.get(name) == "bool" for name in names) and tree["op"] in {"=", "<>"}:
        arguments = [bool(each) if each in (0, 1) else each for each in arguments]
    return {**tree, "args": arguments}


def _value(name: str, text: str, collection: Collection) -> str | float | bool:
    """Return the value that a queryable must have, as its kind has it.

    Raises
    ------
    BadFilterError
        It has no such values.
    """
    kind = collection.queryables[name]
    if kind in {"text", "time"}:
        return text
    try:
        value = json.loads(text, parse_constant=_no_number)
        if isinstance(value, bool) == (kind == "bool") and isinstance(value, int | float) and math.isfinite(value):
            return value
    except (ValueError, OverflowError, RecursionError):
        pass
    raise BadFilterError(
        f"{name}={_shown(text)} is not valid. Expected {'true or false' if kind == 'bool' else 'a number'}."
    )


def _short(error: Exception) -> str:
    """Return what is wrong with a filter in one line."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    expected = [line for line in lines if line.startswith("= ")]
    place = lines[0].removeprefix("--> 1:") if lines and lines[0].startswith("--> 1:") else ""
    text = f"at character {place}, {expected[0][2:]}" if place and expected else (lines[0] if lines else "empty")
    return text[:200].rstrip(".") + "."


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is not a number that a filter can hold")


def _words(content: str) -> int:
    """Return the number of words, numbers and signs outside of texts and geometries: chains of them are nested, too."""
    return sum(1 for _ in _WORD.finditer(_COORDINATES.sub(" ", _QUOTED.sub("x", content))))


def _nesting(content: str) -> int:
    """Return how deep brackets are nested outside of quotes."""
    depth = deepest = 0
    quote = ""
    for character in content:
        if quote:
            quote = "" if character == quote else quote
        elif character in "'\"":
            quote = character
        elif character in "([{":
            depth += 1
            deepest = max(deepest, depth)
        elif character in ")]}":
            depth -= 1
    return deepest


class _Check:
    """Goes through a tree and refuses what cannot be evaluated."""

    def __init__(self, collection: Collection) -> None:
        self._collection = collection
        self._nodes = self._spatial = self._vertices = 0

    def predicate(self, node: Any, depth: int = 0) -> None:  # noqa: ANN401 - JSON
        """Refuse what is not true or false."""
        if isinstance(node, dict) and "property" in node:
            if self._kind(node["property"]) != "bool":
                raise BadFilterError(f"{node['property']} alone is not true or false. Compare it with a value.")
        elif not isinstance(node, bool) and not (isinstance(node, dict) and self._operator(node) in _BOOLEAN):
            raise BadFilterError(f"{_shown(node)} is not true or false.")
        self._walk(node, depth)

    def _walk(self, node: Any, depth: int) -> None:  # noqa: ANN401
        self._nodes += 1
        if self._nodes > MAX_NODES or depth > MAX_DEPTH:
            limit = f"nested deeper than {MAX_DEPTH} levels" if depth > MAX_DEPTH else f"larger than {MAX_NODES} parts"
            raise BadFilterError(f"It is {limit}.")
        if isinstance(node, dict):
            if "op" in node:
                self._operation(node, depth)
            elif "property" in node:
                self._kind(node["property"])
            elif not (node.keys() <= {"timestamp", "date", "interval"} and len(node) == 1):
                raise BadFilterError(f"{_shown(node)} cannot stand here.")
            if len(node.get("interval", "ab")) != 2:
                raise BadFilterError("An interval has two ends.")
            for member in node.get("interval", ()):
                if isinstance(member, dict):
                    self._walk(member, depth + 1)
        elif not isinstance(node, str | bool | int | float):
            raise BadFilterError(f"{_shown(node)} cannot stand here.")

    def _operation(self, node: dict[str, Any], depth: int) -> None:
        name, arguments = self._operator(node), node["args"]
        node["op"] = name
        expected = _ARGUMENTS.get(name, 2)
        is_right = isinstance(arguments, list) and (
            len(arguments) > 1 if name in {"and", "or"} else len(arguments) == expected
        )
        if not is_right:
            raise BadFilterError(f"{name} takes {expected} arguments.")
        if name in SPATIAL:
            self._spatial_operation(name, arguments)
        elif name in LOGICAL:
            for each in arguments:
                self.predicate(each, depth + 1)
        elif name == "in":
            self._walk(arguments[0], depth + 1)
            if not isinstance(arguments[1], list):
                raise BadFilterError("in takes a list of values.")
            for each in arguments[1]:
                self._walk(each, depth + 1)
        elif name == "isNull" and arguments[0] == {"property": GEOMETRY}:
            pass
        else:
            for each in arguments:
                self._walk(each, depth + 1)

    def _spatial_operation(self, name: str, arguments: list[Any]) -> None:
        self._spatial += 1
        if self._spatial > MAX_SPATIAL:
            raise BadFilterError(f"It has more than {MAX_SPATIAL} spatial operators.")
        literal = next((each for each in arguments if each != {"property": GEOMETRY}), None)
        if {"property": GEOMETRY} not in arguments or not isinstance(literal, dict):
            raise BadFilterError(f"{name} compares {GEOMETRY} with a geometry that the filter holds.")
        self._vertices += sum(1 for _ in positions_of(literal))
        if self._vertices > MAX_VERTICES:
            raise BadFilterError(f"Its geometries have more than {MAX_VERTICES:,} vertices.")

    def _operator(self, node: dict[str, Any]) -> str:
        name = node.get("op")
        if not isinstance(name, str) or name.lower() not in _BY_LOWER:
            raise BadFilterError(f"There is no operator or function {_shown(name)} here.")
        return _BY_LOWER[name.lower()]

    def _kind(self, name: Any) -> str:  # noqa: ANN401
        kinds = self._collection.queryables
        if name not in kinds:
            hint = f" {GEOMETRY} can be compared by spatial operators only." if name == GEOMETRY else ""
            raise BadFilterError(
                f"{self._collection.id} has no property {_shown(name)} for filters.{hint} There are "
                f"{', '.join(sorted(kinds))}."
            )
        return kinds[name]


def positions_of(geometry: dict[str, Any]) -> Iterator[tuple[float, float]]:
    """Yield the positions of a geometry of a filter.

    Raises
    ------
    BadFilterError
        It is not a geometry of longitudes and latitudes.
    """
    if "bbox" in geometry:
        box = geometry["bbox"]
        if not isinstance(box, list) or len(box) not in {4, 6} or not all(map(_is_number, box)):
            raise BadFilterError(f"{_shown(box)} is not a bbox: it has 4 or 6 numbers.")
        half = len(box) // 2
        yield from ((box[0], box[1]), (box[half], box[half + 1]))
    elif "geometries" in geometry:
        for each in geometry["geometries"]:
            yield from positions_of(each)
    elif "coordinates" in geometry:
        yield from _positions_in(geometry["coordinates"])
    else:
        raise BadFilterError(f"{_shown(geometry)} is not a geometry.")


def _positions_in(coordinates: Any, depth: int = 0) -> Iterator[tuple[float, float]]:  # noqa: ANN401
    if not isinstance(coordinates, list) or not coordinates or depth > 4:
        raise BadFilterError("The coordinates of a geometry are lists of numbers.")
    if isinstance(coordinates[0], list):
        for each in coordinates:
            yield from _positions_in(each, depth + 1)
    elif len(coordinates) in {2, 3} and all(map(_is_number, coordinates)):
        yield coordinates[0], coordinates[1]
    else:
        raise BadFilterError(f"{_shown(coordinates)} is not a position: longitude and latitude.")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < float("inf")


def _conjuncts(tree: Any) -> Iterator[Any]:  # noqa: ANN401
    """Yield the parts of a filter that must all hold."""
    if isinstance(tree, dict) and tree.get("op") == "and":
        for each in tree["args"]:
            yield from _conjuncts(each)
    else:
        yield tree


def _equalities(tree: Any) -> Iterator[tuple[str, str]]:  # noqa: ANN401
    for each in _conjuncts(tree):
        if isinstance(each, dict) and each.get("op") == "=":
            names = [a["property"] for a in each["args"] if isinstance(a, dict) and "property" in a]
            texts = [a for a in each["args"] if isinstance(a, str)]
            if names and texts:
                yield names[0], texts[0]


def _area_of(tree: Any) -> tuple[float, float, float, float] | None:  # noqa: ANN401
    """Return the box around what features must touch."""
    for each in _conjuncts(tree):
        if isinstance(each, dict) and each.get("op") in SPATIAL - {"s_disjoint"}:
            (literal,) = (a for a in each["args"] if a != {"property": GEOMETRY})
            lon, lat = zip(*positions_of(literal), strict=True)
            if "bbox" in literal and lon[0] > lon[1]:
                return lon[0], lat[0], lon[1], lat[1]
            return min(lon), min(lat), max(lon), max(lat)
    return None


def _shown(value: Any) -> str:  # noqa: ANN401
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else f"{text[:60]}..."
