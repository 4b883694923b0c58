"""The same documents for people: pages without scripts, which the policy of the service would not let run."""

from __future__ import annotations

import json
from collections.abc import Iterable
from html import escape
from typing import Any
from urllib.parse import quote

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<link rel="icon" href="data:image/svg+xml,{icon}">
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem; padding: 0 1rem; }}
table {{ border-collapse: collapse; display: block; overflow-x: auto; }}
th, td {{
  border-bottom: 1px solid color-mix(in srgb, currentcolor 20%, transparent);
  padding: 0.25rem 0.75rem 0.25rem 0;
  text-align: left;
}}
</style>
</head>
<body>
<h1>{title}</h1>
{content}
</body>
</html>
"""

_ICON = quote(
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" rx="7" fill="#0b6277"/>'
    '<path d="M16 3v26M3 11l26 8" stroke="#fff" stroke-width="5"/></svg>'
)
"""Within the page: what is sandboxed may not fetch that of the service."""

_NAMES = {
    "http://www.opengis.net/def/rel/ogc/1.0/schema": "schema",
    "http://www.opengis.net/def/rel/ogc/1.0/queryables": "queryables",
}


def page_of(document: dict[str, Any], title: str) -> str:
    """Return a document of the interface as HTML."""
    content = [f"<p>{escape(document[name])}</p>" for name in ("description", "attribution") if name in document]
    if "features" in document:
        matched, returned = document["numberMatched"], document["numberReturned"]
        content += [f"<p>{returned:,} of {matched:,} features.</p>", _features(document["features"])]
    elif "geometry" in document:
        content.append(_features([document]))
    elif "collections" in document:
        content.append(_list(_anchor(_own(each), each["title"]) for each in document["collections"]))
    elif "conformsTo" in document:
        content.append(_list(escape(each) for each in document["conformsTo"]))
    elif "paths" in document:
        content.append(
            _list(f"{escape(path)}: {escape(each['get']['summary'])}" for path, each in document["paths"].items())
        )
    elif "properties" in document:
        content.append(_schema(document["properties"]))
    if "links" in document:
        content += ["<h2>Links</h2>", _list(map(_described, _for_people(document["links"])))]
    return _PAGE.format(title=escape(document.get("title", title)), icon=_ICON, content="\n".join(content))


def _features(features: list[dict[str, Any]]) -> str:
    names = list(features[0]["properties"]) if features else []
    rows = [[each["id"], *(each["properties"].get(name) for name in names)] for each in features]
    return _table(["Feature", *names], rows)


def _schema(properties: dict[str, dict[str, Any]]) -> str:
    rows = [
        [name, each.get("type", each.get("format")), each.get("x-ogc-unit"), each.get("description")]
        for name, each in properties.items()
    ]
    return _table(["Property", "Type", "Unit", "Meaning"], rows)


def _table(head: list[str], rows: Iterable[list[Any]]) -> str:
    cells = "".join(f"<th>{escape(each)}</th>" for each in head)
    body = "\n".join("<tr>" + "".join(f"<td>{_text(each)}</td>" for each in row) + "</tr>" for row in rows)
    return f"<table>\n<tr>{cells}</tr>\n{body}\n</table>"


def _text(value: Any) -> str:  # noqa: ANN401 - of JSON
    if value is None:
        return ""
    return escape(value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))


def _list(items: Iterable[str]) -> str:
    return "<ul>\n" + "\n".join(f"<li>{each}</li>" for each in items) + "\n</ul>"


def _own(collection: dict[str, Any]) -> str:
    return next(str(link["href"]) for link in collection["links"] if link["rel"] == "self")


def _for_people(links: list[dict[str, str]]) -> Iterable[dict[str, str]]:
    """Yield the links of a document that lead on as pages, and one to the document for programs."""
    for link in links:
        if link["rel"] == "self":
            also = "&" if "?" in link["href"] else "?"
            yield {**link, "href": f"{link['href']}{also}f=json", "title": "This document, for programs"}
        elif link["rel"] != "alternate":
            yield link


def _described(link: dict[str, str]) -> str:
    return f"{escape(_NAMES.get(link['rel'], link['rel']))}: {_anchor(link['href'], link['title'])}"


def _anchor(address: str, text: str) -> str:
    return f'<a href="{escape(address)}">{escape(text)}</a>'
