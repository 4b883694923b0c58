import bz2
import gzip
import lzma
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import osmium
import pytest

from interloc.errors import MapError
from interloc.osm.graph import RoadGraph
from interloc.osm.intersections import intersection_nodes
from interloc.osm.reader import read_osm


def read(folder: Path, content: str | bytes, name: str = "map.osm") -> RoadGraph:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_osm(path)


def test_highways_become_edges(tmp_path: Path, crossing: str) -> None:
    roads = read(tmp_path, crossing)
    assert roads.node_id.tolist() == [1, 2, 3, 4, 5]  # 9 belongs to a house
    assert roads.lonlat[1].tolist() == [8.4, 49.001]
    assert roads.node_id[roads.edges].tolist() == [[1, 2], [2, 3], [4, 2], [2, 5]]
    assert roads.ways.highway == ("residential", "tertiary")
    assert roads.ways.name == ("Weg", "K 1")
    assert roads.ways.id[roads.edge_way].tolist() == [10, 10, 11, 11]
    assert roads.degree().tolist() == [1, 4, 1, 1, 1]
    assert (roads.source, roads.bounds, roads.date, roads.clipped_ways) == ("map.osm", None, None, 0)


@pytest.mark.parametrize(
    ("name", "pack"), [("map.osm.gz", gzip.compress), ("map.osm.bz2", bz2.compress), ("gzip_named.osm", gzip.compress)]
)
def test_the_content_tells_how_it_is_packed(tmp_path: Path, crossing: str, name: str, pack: object) -> None:
    assert callable(pack)
    assert len(read(tmp_path, pack(crossing.encode()), name).edges) == 4


def test_a_pbf_file_is_read_like_any_other(tmp_path: Path) -> None:
    path = tmp_path / "map.osm.pbf"
    header = osmium.io.Header()
    header.set("osmosis_replication_timestamp", "2024-05-01T00:00:00Z")
    header.add_box(osmium.osm.Box(8.3, 48.9, 8.5, 49.1))
    with osmium.SimpleWriter(str(path), header=header) as writer:
        for number, place in enumerate([(8.4, 49.0), (8.4, 49.001), (8.4, 49.002), (8.401, 49.001)], start=1):
            writer.add_node(osmium.osm.mutable.Node(id=number, location=place, version=1))
        writer.add_way(osmium.osm.mutable.Way(id=7, nodes=[1, 2, 3], tags={"highway": "residential"}, version=1))
        writer.add_way(osmium.osm.mutable.Way(id=8, nodes=[2, 4], tags={"highway": "residential"}, version=1))
        writer.add_way(osmium.osm.mutable.Way(id=9, nodes=[3, 4], tags={"barrier": "fence"}, version=1))
    roads = read_osm(path)
    assert len(roads.edges) == 3
    assert roads.date == "2024-05-01T00:00:00Z"
    assert roads.bounds == (8.3, 48.9, 8.5, 49.1)
    assert intersection_nodes(roads).osm_id.tolist() == [2]

    path = path.rename(tmp_path / "region.osm")
    assert len(read_osm(path).edges) == 3, "the content decides"

    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(MapError, match="is damaged"):
        read_osm(path)


def test_a_clipped_way_is_cut_into_the_pieces_that_exist(tmp_path: Path, crossing: str) -> None:
    long = "".join(f'<nd ref="{i}"/>' for i in (1, 77, 2, 3, 78, 4, 5, 79))
    roads = read(tmp_path, crossing.replace('<nd ref="1"/><nd ref="2"/><nd ref="3"/>', long))
    assert roads.node_id[roads.edges].tolist() == [[2, 3], [4, 5], [4, 2], [2, 5]]
    assert roads.clipped_ways == 1
    assert intersection_nodes(roads).osm_id.tolist() == [2, 4, 5]  # two neighbours with a place, and one without


def test_a_road_that_goes_on_beyond_the_extract_still_leaves_its_junction(tmp_path: Path, crossing: str) -> None:
    cut = "\n".join(line for line in crossing.splitlines() if not line.startswith(('  <node id="4"', '  <node id="5"')))
    roads = read(tmp_path, cut)
    assert roads.node_id[roads.edges].tolist() == [[1, 2], [2, 3]]
    assert sorted(roads.loose_ends.tolist()) == [[1, 4, 1], [1, 5, 1]]
    assert roads.degree().tolist() == [1, 4, 1]
    assert roads.degree(np.array([True, False])).tolist() == [1, 2, 1]
    assert intersection_nodes(roads).osm_id.tolist() == [2]
    again = replace(roads, loose_ends=np.array([[1, 4, 0], [1, 4, 1], [1, 5, 1]]))
    assert again.degree().tolist() == [1, 4, 1], "two ways that go on to one node have one neighbour there"


def test_declared_date_and_bounds_are_kept(tmp_path: Path, crossing: str) -> None:
    head = (
        '<meta osm_base="2015-02-17T11:18:02Z"/><bounds minlat="48.9" minlon="8.3" maxlat="49.0" maxlon="8.5"/>'
        '<bounds minlat="49.0" minlon="8.3" maxlat="49.1" maxlon="8.4"/>'
    )
    roads = read(tmp_path, crossing.replace('generator="hand">', f'generator="hand">{head}'))
    assert roads.date == "2015-02-17T11:18:02Z"
    assert roads.bounds == (8.3, 48.9, 8.5, 49.1)


def test_what_lies_in_none_of_several_bounds_is_not_covered(tmp_path: Path, crossing: str) -> None:
    head = (
        '<bounds minlat="48.9" minlon="8.3" maxlat="49.0005" maxlon="8.5"/>'
        '<bounds minlat="49.0015" minlon="8.3" maxlat="49.1" maxlon="8.5"/>'
    )
    path = tmp_path / "map.osm"
    path.write_text(crossing.replace('generator="hand">', f'generator="hand">{head}'))
    roads = read_osm(path)
    assert roads.inside_bounds.tolist() == [True, False, True, False, False]
    assert len(intersection_nodes(roads)) == 0
    cut = read_osm(path, (8.0, 48.9995, 8.4005, 49.0007))  # leaves the second street out
    assert (cut.areas, cut.warnings) == (((8.3, 48.9995, 8.4005, 49.0005),), ())
    path.write_text(path.read_text().replace('<bounds minlat="49.0015"', '<bounds minlat="59.0015"'))
    assert "declares bounds that hold none" in read_osm(path).warnings[0]


def test_without_declared_date_the_latest_edit_is_known(tmp_path: Path, crossing: str) -> None:
    edited = crossing.replace('way id="10"', 'way id="10" timestamp="2011-01-27T18:05:52Z"').replace(
        'way id="11"', 'way id="11" timestamp="2012-04-11T13:34:03Z"'
    )
    assert read(tmp_path, edited).date == "2012-04-11T13:34:03Z"


def test_a_drive_can_be_cut_out_of_a_large_map(tmp_path: Path, crossing: str) -> None:
    path = tmp_path / "map.osm"
    path.write_text(crossing)
    roads = read_osm(path, (8.3995, 48.9995, 8.4005, 49.0005))  # node 1 only, hence way 10
    assert roads.ways.id.tolist() == [10]
    assert roads.inside_bounds.tolist() == [True, False, False]
    with pytest.raises(MapError, match=r"no highways within lon 1\.0.* it covers lon 8\.3.*swapped in geo\.csv"):
        read_osm(path, (1.0, 1.0, 2.0, 2.0))


def test_a_map_that_reaches_no_further_than_the_bounds_is_as_without_them(tmp_path: Path, crossing: str) -> None:
    head = '<bounds minlat="48.9" minlon="8.3" maxlat="49.1" maxlon="8.5"/>'
    path = tmp_path / "map.osm"
    path.write_text(crossing.replace('generator="hand">', f'generator="hand">{head}'))
    whole, around = read_osm(path), read_osm(path, (8.0, 48.0, 9.0, 50.0))
    assert around.bounds == whole.bounds == (8.3, 48.9, 8.5, 49.1)
    assert around.node_id.tolist() == whole.node_id.tolist()
    assert around.edges.tolist() == whole.edges.tolist()
    cut = read_osm(path, (8.0, 48.9995, 8.4005, 49.0005))
    assert cut.bounds == (8.3, 48.9995, 8.4005, 49.0005)  # what the file declares, within the bounds


def test_what_comes_twice_counts_once(tmp_path: Path, crossing: str) -> None:
    start, end = crossing.index("<node"), crossing.rindex("</osm>")
    once, twice = read(tmp_path, crossing), read(tmp_path, crossing[:end] + crossing[start:])
    assert twice.ways.id.tolist() == once.ways.id.tolist()
    assert twice.edges.tolist() == once.edges.tolist()


STREET = '<way id="10"{}><nd ref="1"/><nd ref="2"/><nd ref="3"/><tag k="{}" v="residential"/></way>'


@pytest.mark.parametrize("order", [1, -1], ids=["old first", "new first"])
def test_of_maps_of_two_days_the_higher_version_counts(tmp_path: Path, crossing: str, order: int) -> None:
    start = crossing.index('  <way id="10"')
    rest = crossing[crossing.index('  <way id="11"') :]
    old = STREET.replace('<nd ref="2"/>', "").format(' version="1"', "highway")
    new, removed = (STREET.format(' version="2"', key) for key in ("highway", "was:highway"))
    roads = read(tmp_path, crossing[:start] + "".join([old, new][::order]) + rest)
    assert roads.node_id[roads.edges].tolist() == [[1, 2], [2, 3], [4, 2], [2, 5]]
    roads = read(tmp_path, crossing[:start] + "".join([old, removed][::order]) + rest)
    assert roads.ways.id.tolist() == [11]

    moved = '<node id="2" version="2" lat="49.0011" lon="8.4"/>'
    nodes = [moved, crossing[crossing.index("<node") : start]][::order]
    roads = read(tmp_path, '<osm version="0.6">' + "".join(nodes) + crossing[start:])
    assert roads.lonlat[1].tolist() == [8.4, 49.0011]
    assert not roads.warnings


def test_two_places_under_one_id_are_named(tmp_path: Path, crossing: str) -> None:
    another = '<node id="2" lat="49.0051" lon="8.4"/>'
    (warning,) = read(tmp_path, crossing.replace("</osm>", f"{another}</osm>")).warnings
    assert "1 nodes at two places under one id and version" in warning


def test_a_file_of_the_whole_history_is_refused_with_the_way_out(tmp_path: Path, crossing: str) -> None:
    gone = '<way id="11" version="2" visible="false"/>'
    for content, name in ((crossing.replace("</osm>", gone + "</osm>"), "map.osm"), (crossing, "map.osh")):
        with pytest.raises(MapError, match=rf"full history file.* osmium time-filter {name} -o"):
            read(tmp_path, content, name)
    path = tmp_path / "map.osh.pbf"
    with osmium.SimpleWriter(str(path)) as writer:  # the ending makes it say so in the head of the file
        writer.add_node(osmium.osm.mutable.Node(id=1, location=(8.4, 49.0), version=1))
    with pytest.raises(MapError, match="full history file"):
        read_osm(path.rename(tmp_path / "map.osm.pbf"))


def test_pieces_of_one_way_under_its_id_are_all_taken_and_named(tmp_path: Path, crossing: str) -> None:
    start, rest = crossing.index('  <way id="10"'), crossing[crossing.index('  <way id="11"') :]
    pieces = [STREET.replace(f'<nd ref="{left_out}"/>', "").format("", "highway") for left_out in (3, 1, 1)]
    roads = read(tmp_path, crossing[:start] + "".join(pieces) + rest)
    assert roads.ways.id.tolist() == [10, 10, 11]
    assert intersection_nodes(roads).osm_id.tolist() == [2]
    assert roads.degree().tolist() == [1, 4, 1, 1, 1]
    (warning,) = roads.warnings
    assert "holds 1 highways under ids that others of the same version have" in warning


@pytest.mark.parametrize("quote", ["'", '"'])
def test_what_was_deleted_in_josm_is_gone(tmp_path: Path, crossing: str, quote: str) -> None:
    head = 'way id="11" action="delete" visible="true" version="3"'
    roads = read(tmp_path, crossing.replace('way id="11"', head).replace('"', quote))
    assert roads.ways.id.tolist() == [10]
    assert roads.ways.name == ("Weg",)
    assert roads.source == "map.osm"


@pytest.mark.parametrize(
    "odd", ['timestamp="2024-05-01T02:00:00+02:00"', 'timestamp="May"', 'uid="12345678901" user="x"']
)
@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_values_that_no_road_depends_on_do_not_stop_reading(
    tmp_path: Path, crossing: str, odd: str, pack: Callable[[bytes], bytes]
) -> None:
    roads = read(tmp_path, pack(crossing.replace("<way", f"<way {odd}").encode()))
    assert len(roads.edges) == 4
    assert roads.date == ("2024-05-01T00:00:00Z" if "2024" in odd else None)


def test_places_may_stand_in_the_ways(tmp_path: Path, crossing: str) -> None:
    """As by `out geom` of Overpass, and by osmium add-locations-to-ways, which drops nodes without tags."""
    places = {1: "49.000,8.400", 2: "49.001,8.400", 3: "49.002,8.400", 4: "49.001,8.399", 5: "49.001,8.401"}
    body = "".join(line for line in crossing.splitlines() if "<node" not in line)
    for number, place in places.items():
        lat, lon = place.split(",")
        body = body.replace(f'<nd ref="{number}"/>', f'<nd ref="{number}" lat="{lat}" lon="{lon}"/>')
    path = tmp_path / "map.osm"
    body = re.sub("<way [^>]*>", r'\g<0><bounds minlat="49.1" minlon="8.4" maxlat="49.1" maxlon="8.5"/>', body)
    path.write_text(body.replace("<way", '<node id="4" version="1" lat="49.001" lon="8.398"/><way', 1))
    for roads in (read_osm(path), read_osm(path, (8.39, 48.99, 8.41, 49.01))):
        assert (roads.areas[1:], roads.warnings) == ((), ()), "the boxes of the ways declare nothing"
        assert roads.node_id.tolist() == [1, 2, 3, 4, 5]
        assert roads.lonlat[3].tolist() == [8.398, 49.001]  # a node of its own comes first
        assert intersection_nodes(roads).osm_id.tolist() == [2]
        assert (roads.clipped_ways, roads.loose_ends.tolist()) == (0, [])

    written = osmium.SimpleWriter(osmium.io.File(str(tmp_path / "map.osm.pbf"), "pbf,locations_on_ways=true"))
    for way in osmium.FileProcessor(str(path), osmium.osm.WAY):
        written.add(way)
    written.close()
    assert intersection_nodes(read_osm(tmp_path / "map.osm.pbf", (8.39, 48.99, 8.41, 49.01))).osm_id.tolist() == [2]


def test_streets_that_share_no_node_are_named(tmp_path: Path) -> None:
    nodes = "".join(f'<node id="{i}" lat="49.00{i % 2}" lon="8.4{i // 2}"/>' for i in range(12))
    ways = "".join(
        f'<way id="{i}"><nd ref="{2 * i}"/><nd ref="{2 * i + 1}"/><tag k="highway" v="road"/></way>' for i in range(6)
    )
    (warning,) = read(tmp_path, f'<osm version="0.6">{nodes}{ways}</osm>').warnings
    assert warning.startswith("None of the 6 highways of map.osm has a node in common with another")


def test_levels_are_read(tmp_path: Path, crossing: str) -> None:
    def layers(tags: str) -> list[int]:
        layer = read(tmp_path, crossing.replace('<tag k="name" v="Weg"/>', tags)).ways.layer
        return layer.tolist()

    assert layers('<tag k="bridge" v="yes"/>') == [1, 0]
    assert layers('<tag k="bridge" v="yes"/><tag k="layer" v="2"/>') == [2, 0]
    assert layers(f'<tag k="layer" v="{10**30}"/>') == [99, 0]
    assert layers('<tag k="tunnel" v="yes"/>') == [-1, 0]
    assert layers('<tag k="tunnel" v="building_passage"/><tag k="layer" v="roof"/>') == [0, 0]


@pytest.mark.parametrize(("what", "maximum"), [("MAX_NODES", 3), ("MAX_WAYS", 1)])
def test_more_than_any_place_has_is_refused(
    tmp_path: Path, crossing: str, monkeypatch: pytest.MonkeyPatch, what: str, maximum: int
) -> None:
    monkeypatch.setattr(f"interloc.osm.reader.{what}", maximum)
    path = tmp_path / "map.osm"
    path.write_text(crossing)
    with pytest.raises(MapError, match=f"holds more than {maximum} (nodes|highways) around the drive"):
        read_osm(path, (8.0, 48.0, 9.0, 50.0))
    assert len(read_osm(path).ways) == 2  # who gives no bounds wants all


def swapped(text: str) -> str:
    nodes, ways = ("".join(line for line in text.splitlines() if tag in line) for tag in ("<node", "<way"))
    return f'<osm version="0.6">{ways}{nodes}</osm>'


VARIANTS = {
    "nodes follow the ways": (swapped, [10, 11], 4),
    "ids of an editor": (lambda text: text.replace('id="2"', 'id="-2"').replace('ref="2"', 'ref="-2"'), [10, 11], 4),
    "a deleted way": (lambda text: text.replace('way id="11"', 'way id="11" version="3" visible="false"'), [10], 2),
    "a node without place": (lambda text: text.replace('lat="49.002"', 'lat="149.002"'), [10, 11], 3),
}


@pytest.mark.parametrize(("change", "ways", "edges"), VARIANTS.values(), ids=VARIANTS.keys())
def test_maps_may_be_written_otherwise(
    tmp_path: Path, crossing: str, change: Callable[[str], str], ways: list[int], edges: int
) -> None:
    roads = read(tmp_path, change(crossing))
    assert (roads.ways.id.tolist(), len(roads.edges)) == (ways, edges)
    assert roads.clipped_ways == (edges == 3)
    assert set(np.abs(intersection_nodes(roads).osm_id)) == ({2} if len(ways) == 2 else set())


BAD = {
    "no_xml": (b"this is not a map", "is not an OSM file"),
    "binary": (bytes(range(256)), "is not an OSM file"),
    "empty": (b"", "is empty"),
    "empty.gz": (gzip.compress(b""), "holds nothing once unpacked"),
    "page": (b"<!DOCTYPE html>\n<html><head></head></html>", "web page"),
    "old_page": (b"<html><body>503</body></html>", "web page"),
    "page_of_old": (b'<!DOCTYPE HTML PUBLIC "-//W3C//DTD HTML 4.01//EN">\n<HTML></HTML>', "web page"),
    "json": (b'{"version": 0.6, "elements": []}', r"\[out:xml\]"),
    "zip": (b"PK\x03\x04rest", "ZIP"),
    "o5m": (b"\xff\xe0\x04o5m2\x00", r"\.o5m file.*osmium cat"),
    "xz": (lzma.compress(b"<osm/>"), "compressed by xz.*unpack"),
    "zst": (b"\x28\xb5\x2f\xfd\x00", "compressed by zstd.*unpack"),
    "query": (b"[out:xml];way[highway](48.9,8.3,49.0,8.4);(._;>;);out;", "is an Overpass query"),
    "timed_out": (
        b"<osm version='0.6'><node id='1' lat='49' lon='8.4'/><remark> runtime error: Query timed out. </remark></osm>",
        r"Overpass gave up on this query \(runtime error: Query timed out",
    ),
    "lanes": (b'<osm generator="VMB"><MetaInfo format_version="1"/><node id="1" lat="" lon=""/></osm>', "Lanelet2 map"),
    "lanes_of_josm": (b"<osm version='0.6'><relation id='2'><tag k='type' v='lanelet'/></relation></osm>", "Lanelet2"),
    "augmented": (b'<osm version="0.6"><action type="modify"><old/></action></osm>', "change file"),
    "of_old": (b'<osm version="0.5"><node id="1" lat="49" lon="8.4"/></osm>', "old version of the format"),
    "change": (b'<osmChange version="0.6"></osmChange>', "change file"),
    "gpx": (b'<gpx version="1.1"></gpx>', "is a track"),
    "graphml": (b'<graphml xmlns="http://graphml.graphdrawing.org/xmlns"></graphml>', "save_graph_xml"),
    "gpkg": (b"SQLite format 3\x00rest", "GeoPackage"),
    "md5": (b"d41d8cd98f00b204e9800998ecf8427e  map.osm.pbf\n", "is a checksum"),
    "md5_bare": (b"d41d8cd98f00b204e9800998ecf8427e", "is a checksum"),
    "border": (b"none\n1\n   8.0E+00   4.9E+01\nEND\nEND\n", "is a border"),
    "no_version": (b"<osm><node/></osm>", "declares no version"),
    "nothing_in_it": (b'<osm version="0.6"></osm>', "no highways"),
    "center": (b'<osm version="0.6"><way id="1"><center lat="49" lon="8.4"/></way></osm>', "by `out center`"),
    "bad_ref": (b'<osm version="0.6"><way id="1"><nd ref="x"/></way></osm>', "id is not a whole number"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_map_is_refused_in_words(tmp_path: Path, name: str) -> None:
    content, reason = BAD[name]
    with pytest.raises(MapError, match=reason) as caught:
        read(tmp_path, content, f"{name}.osm")
    assert f"{name}.osm" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder_are_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="no such file"):
        read_osm(tmp_path / "none.osm")
    with pytest.raises(MapError, match="is a folder"):
        read_osm(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads every file")
def test_an_unreadable_file_is_refused_in_words(tmp_path: Path, crossing: str) -> None:
    path = tmp_path / "map.osm"
    path.write_text(crossing)
    path.chmod(0)
    with pytest.raises(MapError, match="Permission denied"):
        read_osm(path)


def flipped(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 0xFF]) + content[middle + 1 :]


DAMAGED = {
    "gzip ends early": (lambda text: gzip.compress(text)[:-30], "map.osm.gz", "ends early"),
    "bzip2 ends early": (lambda text: bz2.compress(text)[:-30], "map.osm.bz2", "ends early"),
    "XML ends early": (lambda text: text[:-30], "map.osm", "is damaged"),
    "gzip is damaged": (lambda text: flipped(gzip.compress(text)), "map.osm.gz", r"map\.osm\.gz"),
    "a node is nowhere": (lambda text: text.replace(b'"49.001"', b'"4900.1"'), "map.osm", "not in decimal degrees"),
    "a node is no number": (lambda text: text.replace(b'"49.001"', b'"nan"'), "map.osm", "not in decimal degrees"),
    "a node is a word": (lambda text: text.replace(b'"49.001"', b'"north"'), "map.osm", "not in decimal degrees"),
}


@pytest.mark.parametrize(("damage", "name", "words"), DAMAGED.values(), ids=DAMAGED.keys())
def test_a_damaged_file_is_refused_in_words(
    tmp_path: Path, crossing: str, damage: Callable[[bytes], bytes], name: str, words: str
) -> None:
    with pytest.raises(MapError, match=words):
        read(tmp_path, damage(crossing.encode()), name)


@pytest.mark.parametrize(
    "head",
    [
        '<!DOCTYPE osm SYSTEM "http://example.org/osm.dtd">\n',
        '<!DOCTYPE osm [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>\n',
        '<!DOCTYPE osm [<!ENTITY secret SYSTEM "file:///etc/hostname">]>\n',
    ],
)
@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_declarations_are_refused(tmp_path: Path, crossing: str, head: str, pack: object) -> None:
    assert callable(pack)
    with pytest.raises(MapError, match="DOCTYPE"):
        read(tmp_path, pack(crossing.replace("<osm", head + "<osm").encode()))


def test_a_small_file_that_unpacks_without_end_is_refused(tmp_path: Path, crossing: str) -> None:
    path = tmp_path / "bomb.osm.gz"
    path.write_bytes(gzip.compress(crossing.replace("</osm>", "<node/>" * 1_000_000 + "</osm>").encode()))
    with pytest.raises(MapError, match=r"unpacks to more than 0\.0 GB"):
        read_osm(path, max_unpacked_bytes=4_000_000)


def test_a_tag_without_end_is_refused(tmp_path: Path, crossing: str) -> None:
    endless = crossing.replace("</osm>", f'<node id="{"1" * 5_000_000}"/></osm>')
    with pytest.raises(MapError, match="tag longer than"):
        read(tmp_path, gzip.compress(endless.encode()), "bomb.osm.gz")


def test_ways_without_their_nodes_name_the_usual_query(tmp_path: Path) -> None:
    body = '<way id="1"><nd ref="1"/><nd ref="2"/><tag k="highway" v="road"/></way>'
    with pytest.raises(MapError, match=r"\(\._;>;\);"):
        read(tmp_path, f'<osm version="0.6">{body}</osm>')
    with pytest.raises(MapError, match=r"\(\._;>;\);"):
        read_osm(tmp_path / "map.osm", (8.0, 48.0, 9.0, 50.0))


def test_the_maps_of_kitti_are_read(data: Callable[[str], Path]) -> None:
    roads = read_osm(data("kitti/osm/00.osm.gz"))
    assert (len(roads.ways), roads.date, roads.bounds) == (350, "2015-02-17T11:18:02Z", None)
    assert len(np.unique(roads.node_id)) == len(roads.node_id)
    roads = read_osm(data("kitti/osm_buildings/00.osm.gz"))
    assert roads.bounds == (8.3816242, 48.9772313, 8.4044552, 48.9917075)
    assert roads.date == "2012-04-11T13:34:03Z"
    assert (len(roads.ways), int((~roads.inside_bounds).sum()) > 0) == (600, True)
