"""Filters in CQL2 (OGC 21-065): read by the package cql2, bounded here before and after.

What a filter may hold is a tree of operators over the queryables of a collection. `app.ogc.evaluation` decides for all
features at once whether they match; anything that it does not know is refused there, when the filter is read.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any, Literal

import cql2

from app.ogc.collections import GEOMETRY, Collection
from app.ogc.evaluation import SPATIAL, Filter, bad_filter, box_of, check, geometry_of, shown

Language = Literal["cql2-text", "cql2-json", "cql-text"]
"""The last one is that of the draft of the standard, which GDAL speaks."""

MAX_CHARACTERS = 16_000
MAX_DEPTH = 24
MAX_NODES = 300
"""Operators, properties and values of a filter."""

_MAX_WORDS = 2 * MAX_NODES
_QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
_COORDINATES = re.compile(r"\([-+0-9.eE,()\s]*\)")
_CHAIN = re.compile(rf"(?:\bnot\s+|-\s*){{{MAX_DEPTH}}}", re.IGNORECASE)
_ILIKE = re.compile(r"\b(?P<name>\w+) +ILIKE +(?P<pattern>'(?:[^']|'')*')|'(?:[^']|'')*'", re.IGNORECASE)
_WORD = re.compile(r"\w[\w.]*|[^\w\s,()]")

CRS84 = "http://www.opengis.net/def/crs/OGC/1.3/CRS84"


def read_filter(
    content: str | None, language: Language, collection: Collection, values: Mapping[str, str] | None = None
) -> Filter:
    """Read a filter on the features of a collection; a 400 where it is not CQL2, too large, or names what there is not.

    Parameters
    ----------
    values
        Queryables with the values that they must have, too, as they stand in addresses.
    """
    parts = [] if content is None else [_parse(content, language)]
    if language == "cql-text":
        parts = [_with_truth_values(part, collection) for part in parts]
    for name, text in (values or {}).items():
        parts.append({"op": "=", "args": [{"property": name}, _value(name, text, collection)]})
    tree = parts[0] if len(parts) == 1 else {"op": "and", "args": parts}
    _refuse_large(tree)
    check(tree, collection)
    return Filter(tree, collection, _area_of(tree), dict(_equalities(tree)))


def _parse(content: str, language: Language) -> Any:  # noqa: ANN401 - JSON
    if len(content) > MAX_CHARACTERS:
        raise bad_filter(f"It has {len(content):,} characters, more than {MAX_CHARACTERS:,}.")
    if language == "cql-text":
        content = _ILIKE.sub(_without_ilike, content)
    if _nesting(content) > MAX_DEPTH or _CHAIN.search(content):  # before any parser sees it: theirs are recursive
        raise bad_filter(f"It is nested deeper than {MAX_DEPTH} levels.")
    if language != "cql2-json" and _words(content) > _MAX_WORDS:  # likewise
        raise bad_filter(f"It is larger than {MAX_NODES} parts.")
    try:
        if language == "cql2-json":
            content = json.dumps(json.loads(content, parse_constant=_no_number))
        expression = cql2.parse_json(content) if language == "cql2-json" else cql2.parse_text(content)
        # Not what cql2 makes of numbers, which are all float64 there: as JSON, where NaN and infinity are null.
        return json.loads(json.dumps(expression.to_json()), parse_constant=_no_number)
    except (cql2.ParseError, cql2.ValidationError, ValueError, RecursionError) as error:
        raise bad_filter(f"It is not {language}: {_short(error)}") from None


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
    """Return the value that a queryable must have, as its kind has it; a 400 where it has no such values."""
    kind = collection.queryables[name]
    if kind in {"text", "time"}:
        return text
    try:
        value = json.loads(text, parse_constant=_no_number)
        if isinstance(value, bool) == (kind == "bool") and isinstance(value, int | float) and math.isfinite(value):
            return value
    except (ValueError, OverflowError, RecursionError):
        pass
    raise bad_filter(
        f"{name}={shown(text)} is not valid. Expected {'true or false' if kind == 'bool' else 'a number'}."
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
    members = [node.get(name) for name in ("args", "interval")] if isinstance(node, dict) else []
    for each in (part for member in members if isinstance(member, list) for part in member):
        yield from each if isinstance(each, list) else (each,)


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


def _area_of(tree: Any) -> tuple[float, ...] | None:  # noqa: ANN401
    """Return the box around what features must touch."""
    for each in _conjuncts(tree):
        if isinstance(each, dict) and each.get("op") in SPATIAL - {"s_disjoint"}:
            (literal,) = (a for a in each["args"] if a != {"property": GEOMETRY})
            return box_of(literal) if "bbox" in literal else geometry_of(literal).bounds
    return None
