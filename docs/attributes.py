"""docs/attributes.md, made from the layers: `python docs/attributes.py > docs/attributes.md`."""

from __future__ import annotations

import sys

from interloc.output.layers import CITY_LAYERS, DERIVED, LAYERS, Layer
from interloc.output.properties import Attribute

_HEAD = """# The attributes of the result layers

Made by `make attributes` from `interloc/output/properties.py`; change the text there.

Every layer is a GeoJSON file of the result folder, an address of the API (with hyphens: `osm-nodes`), and a table of
the GeoPackage; `interloc export` and `export.*` of the API also give each as FlatGeobuf, KML and CSV. Positions are
longitude and latitude (EPSG:4326) with 7 decimals, 1 cm. A GeoPackage holds these titles and descriptions
(`gpkg_data_columns`), and whose data each layer is; GeoJSON says that in `attribution` and `license`.

W is the frame of the first LiDAR pose (x forward, y to the left), L that of the LiDAR at a keyframe, levelled. Bearings
and headings are degrees clockwise from north. Without a georeference the files `*.local.json` hold metres of W, and
bearings from its +y.

## Score and confidence

`score` belongs to a detection: how clear the intersection was at that keyframe. Half of it is the agreement of the
branches, exp(-(spread / 2 m)^2), where the spread says how far (root mean square) their lines pass the position. The
other half is the length of the third longest branch, from 0 m (0) to 15 m and more (1). The settings are those of
`score`.

`confidence` belongs to an intersection of the map: the probability that a road junction, a node of policy `drive`, lies
within 10 m. It rises with the share of the keyframes near enough to see it that did, and falls with the uncertainty of
the position that its branches leave: lines that meet in no point, or at an acute angle, are often no junction. The
settings `calibration` were fitted to drives whose truth is known; docs/accuracy.md says how true they are. A junction
with a service road that the policy leaves out has a high confidence, and is wrong against OpenStreetMap. Intersections
that under 30 % of the keyframes near enough saw (a prior of half a sighting and one and a half misses added, up to
30 % taken away for low scores) are not written; with preset `paper`, which has no calibration, that share is the
confidence.

`position_cov_m2` is the covariance of the position: of the georeference (as OXTS state it of themselves, else 0.3 m),
of the lines of the branches, which is largest along the bisector of an acute pair, and of the scatter of the sightings.
`position_std_m` sums it up as one sigma along each axis; the layer `uncertainty` draws the ellipse of 95 %. With preset
`paper` both hold the scatter alone. Who puts several drives together needs its parts: the one of the georeference
(`fix_std_m`) is shared by all intersections of a drive, that of the lines (`shape_cov_m2`) by all drives that saw the
intersection, and that of the scatter (`scatter_std_m`) by nothing: only the first and the last get smaller with more
drives.
"""

_KINDS = {
    "int": "whole number",
    "float": "number",
    "bool": "true or false",
    "text": "text",
    "time": "time",
    "list": "list of numbers",
}


def render() -> str:
    """Return the text of docs/attributes.md."""
    parts = [_HEAD, *(_section(layer) for layer in LAYERS.values())]
    parts.append("## Made by exports\n\nThese two are made of the intersections when a result is exported.\n")
    parts += [_section(layer) for layer in DERIVED.values()]
    parts.append("## Of many drives\n\nThese are the files of a map that `interloc merge` makes of several results.\n")
    parts += [_section(layer) for layer in CITY_LAYERS.values()]
    return "\n".join(parts)


def _section(layer: Layer) -> str:
    lines = [
        f"## `{layer.name}`: {layer.title}",
        "",
        f"{layer.description} Geometry: {layer.geometry}.",
        "",
        "| attribute | title | kind | unit | meaning |",
        "|---|---|---|---|---|",
        *(_row(each) for each in layer.attributes),
    ]
    return "\n".join(lines) + "\n"


def _row(attribute: Attribute) -> str:
    cells = [
        f"`{attribute.name}`",
        attribute.title,
        _KINDS[attribute.kind],
        attribute.unit or "",
        attribute.description,
    ]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    sys.stdout.write(render())
