"""Maps of OpenStreetMap, written plainly."""

from collections.abc import Iterable, Sequence

from interloc.arrays import FloatArray


def osm_text(lonlat: FloatArray, ways: Iterable[Sequence[int]]) -> str:
    """Write nodes, whose ids are their rows from 1, and streets through nodes of these ids."""
    nodes = [f'<node id="{id_}" lat="{lat:.9f}" lon="{lon:.9f}"/>' for id_, (lon, lat) in enumerate(lonlat, 1)]
    streets = [
        f'<way id="{id_}">' + "".join(f'<nd ref="{ref}"/>' for ref in refs) + '<tag k="highway" v="residential"/></way>'
        for id_, refs in enumerate(ways, 1000)
    ]
    return "\n".join(['<?xml version="1.0"?>', '<osm version="0.6">', *nodes, *streets, "</osm>", ""])
