"""What OpenStreetMap lacks, has elsewhere or has too much, along one street; and how receivers of findings know them.

The street runs east. Side roads leave it to the north; drives saw all of them, as road 6 m wide.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from interloc.city.audit import Audit, audit
from interloc.city.citymap import CityMap, merge
from interloc.city.drives import Pass
from interloc.city.maproulette import FINDINGS_FILE, MAPROULETTE_FILE, known_findings, write_audit
from interloc.city.models import AuditConfig, judgement_of
from interloc.city.osm_plane import joined
from interloc.geometry import lonlat_from_enu
from interloc.mapping.mosaic import Mosaic, Raster
from interloc.osm.graph import RoadGraph
from interloc.osm.reader import read_osm
from interloc.output.geojson import read_json
from tests.city.towns import ORIGIN, drive

SIDES_M = (-300.0, -200.0, -100.0, 0.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0)
"""x of the side roads."""

_END = (100.0, 60.0)
_SIDE = ((_END, 12),)
ALL_KINDS = AuditConfig(kinds=("missing_junction", "missing_branch", "moved"))
NOON = datetime(2026, 11, 25, 12, tzinfo=UTC)


@cache
def road_seen(bias_m: tuple[float, float], at_100_m: tuple[tuple[tuple[float, float], int], ...] = _SIDE) -> Mosaic:
    """Paint what a drive saw: the street and its sides, and other ground on both sides of them.

    Of the side at x = 100 m: to where it leads in pieces, and how wide they are in cells of half a metre.
    """
    plane = merge([drive(np.array([[0.0, 0.0], [10.0, 0.0]]), "plane")])
    lines = [((-400.0, 0.0), (700.0, 0.0)), *(((x, 0.0), (x, 60.0)) for x in SIDES_M if x != _END[0])]
    starts = [(_END[0], 0.0), *(to for to, _ in at_100_m)]
    pieces = [((start, to), cells) for start, (to, cells) in zip(starts, at_100_m, strict=False)]
    rasters = [Raster(0.5) for _ in range(2)]
    size = 3000
    left, top = plane.plane(np.array([list(ORIGIN[::-1])]))[0] + [-500.0, 500.0]
    row, col = round(-top / 0.5), round(left / 0.5)
    images = []
    for width in (12, 60):  # cells
        image = np.zeros((size, size), np.uint8)
        for line, cells in [*((each, 12) for each in lines), *pieces]:
            lonlat = lonlat_from_enu(*ORIGIN, np.array(line) + bias_m)
            ends = (plane.plane(lonlat) / 0.5 - [col, -row]) * [1, -1]
            cv2.line(image, *(tuple(np.rint(end).astype(int).tolist()) for end in ends), 1, max(width, cells))
        images.append(image)
    rasters[0].add(row, col, images[0])
    rasters[1].add(row, col, images[1] & ~images[0] & 1)
    return Mosaic(rasters[0], plane.epsg, rasters[1])


def passes(count: int = 2, sides_m: Sequence[float] = SIDES_M) -> list[Pass]:
    nodes = np.array([(x, 0.0) for x in sides_m])
    track = np.stack([np.arange(-400.0, 700.0, 2.0), np.zeros(550)], axis=-1)
    found = []
    for number in range(count):
        bias = (0.5 * number, -0.5 * number)
        seen = drive(nodes, f"d{number}", bias_m=bias, noise_m=0.1)
        found.append(
            replace(
                seen,
                bearings_deg=(np.array([0.0, 90.0, 270.0]),) * len(seen),
                widths_m=(np.full(3, 6.0),) * len(seen),
                shape_cov_m2=np.tile([0.04, 0.0, 0.04], (len(seen), 1)),
                track_lonlat=lonlat_from_enu(*ORIGIN, track + bias),
                track_along_m=np.arange(550) * 2.0,
                along_m=nodes[:, 0] + 400.0,
                road=road_seen(bias),
            )
        )
    return found


def node(number: int, x: float, y: float) -> str:
    lon, lat = lonlat_from_enu(*ORIGIN, np.array([x, y])).tolist()
    return f'<node id="{number}" version="1" lat="{lat:.8f}" lon="{lon:.8f}"/>'


def way(number: int, refs: Sequence[int], tags: str = "", highway: str = "residential") -> str:
    of = "".join(f'<nd ref="{each}"/>' for each in refs)
    return f'<way id="{number}" version="1">{of}<tag k="highway" v="{highway}"/>{tags}</way>'


def osm(
    folder: Path,
    sides: Sequence[tuple[float, float]] = tuple((x, 0.0) for x in SIDES_M),
    extra: str = "",
    tags: str = "",
) -> RoadGraph:
    """Return a map with the street through the feet of its side roads, (x, y), of which each goes north for 60 m.

    Streets beside it show that the map goes on there: a comb alone looks as if it were cut off at its teeth.
    """
    feet = [(-400.0, 0.0), *sorted(sides), (700.0, 0.0)]
    parts = [node(number, *at) for number, at in enumerate(feet, 1)]
    parts += [node(100 + foot, feet[foot - 1][0], 60.0) for foot in range(2, len(feet))]
    parts += [node(first + i, -400.0 + 100.0 * i, y) for first, y in ((500, -150.0), (600, 150.0)) for i in range(12)]
    parts += [way(1000, range(1, len(feet) + 1), tags)]
    parts += [way(999 + foot, (foot, 100 + foot)) for foot in range(2, len(feet))]
    parts += [way(1000 + one, (one, one + 1)) for first in (500, 600) for one in range(first, first + 11)]
    (folder / "map.osm").write_text(f'<osm version="0.6">{"".join(parts)}{extra}</osm>')
    return read_osm(folder / "map.osm")


def told(found: Audit) -> list[tuple[str, int]]:
    """Return the kind of each finding, and x of where it is on the street, to 10 m."""
    first = merge(passes(1)).plane(np.array([ORIGIN[::-1]]))[0]
    return sorted((each.kind, int(round((each.xy[0] - first[0]) / 10.0) * 10)) for each in found.findings)


@pytest.fixture(scope="module")
def city() -> CityMap:
    return merge(passes())


def all_but(*missing_m: float) -> list[tuple[float, float]]:
    return [(x, 0.0) for x in SIDES_M if x not in missing_m]


def test_a_right_map_has_no_findings(city: CityMap, tmp_path: Path) -> None:
    found = audit(city, osm(tmp_path), ALL_KINDS)
    assert (found.findings, found.junctions) == ([], 10)


def test_what_the_map_lacks_and_has_elsewhere_is_found(city: CityMap, tmp_path: Path) -> None:
    sides = [*all_but(100.0, 300.0), (308.0, -9.0)]
    found = audit(city, osm(tmp_path, sides))
    assert told(found) == [("missing_junction", 100), ("moved", 300)]
    missing, moved = sorted(found.findings, key=lambda each: each.kind)
    assert missing.branch_bearings_deg == [0.0]
    assert missing.passes == 2
    assert moved.distance_m == pytest.approx(12.0, abs=0.5)
    assert moved.osm_node is not None


def test_a_junction_of_a_one_way_street_lies_elsewhere_but_not_one_of_two_carriageways(
    city: CityMap, tmp_path: Path
) -> None:
    sides, one_way = [*all_but(300.0), (308.0, -9.0)], '<tag k="oneway" v="yes"/>'
    assert told(audit(city, osm(tmp_path, sides, tags=one_way))) == [("moved", 300)]
    back = node(900, 700.0, -20.0) + node(901, -400.0, -20.0) + way(2000, (900, 901), one_way)
    assert told(audit(city, osm(tmp_path, sides, extra=back, tags=one_way))) == []


def test_a_branch_that_a_junction_lacks_is_found(tmp_path: Path) -> None:
    crossing = [
        replace(
            each,
            bearings_deg=(np.array([0.0, 90.0, 180.0, 270.0]),) * len(each),
            widths_m=(np.full(4, 6.0),) * len(each),
        )
        for each in passes()
    ]
    assert told(audit(merge(crossing), osm(tmp_path))) == []  # no road was seen to the south
    south = node(900, 200.0, -60.0) + way(2000, (6, 900))  # node 6 is the one at 100
    half = osm(tmp_path, all_but(200.0), extra=south)
    assert told(audit(merge(passes()), half)) == [("missing_junction", 200)]


@pytest.mark.parametrize(("highway", "tags", "kind"), [
    ("residential", "", "no_node"), ("residential", '<tag k="bridge" v="yes"/>', None), ("service", "", None)
])  # fmt: skip
def test_a_junction_that_a_slip_of_the_map_hides_is_found(
    city: CityMap, tmp_path: Path, highway: str, tags: str, kind: str | None
) -> None:
    side = node(900, 100.0, -30.0) + node(901, 100.0, 60.0) + way(2000, (900, 901), tags, highway)
    assert told(audit(city, osm(tmp_path, all_but(100.0), extra=side))) == ([(kind, 100)] if kind else [])
    apart = node(900, 100.0, 0.1) + node(901, 100.0, 60.0) + way(2000, (900, 901), tags, highway)
    assert told(audit(city, osm(tmp_path, all_but(100.0), extra=apart))) == ([("not_joined", 100)] if kind else [])


@pytest.mark.parametrize(("pieces", "found"), [
    ((((100.0, 28.0), 12),), []),  # as long as a drive, where the other sides lead on
    ((((100.0, 14.0), 12), ((100.0, 60.0), 60)), []),  # a yard behind a gate as wide as a road
    ((((100.0, 20.0), 12), ((110.0, 60.0), 12)), [("missing_junction", 100)]),  # it bends
])  # fmt: skip
def test_only_what_leads_on_like_the_side_roads_of_the_map_is_a_road(
    tmp_path: Path, pieces: tuple[tuple[tuple[float, float], int], ...], found: list[tuple[str, int]]
) -> None:
    seen = [replace(each, road=road_seen((0.5 * i, -0.5 * i), pieces)) for i, each in enumerate(passes())]
    assert told(audit(merge(seen), osm(tmp_path, all_but(100.0)))) == found


def test_a_lane_that_leaves_along_the_road_is_no_branch(tmp_path: Path) -> None:
    def leaving(bearing_deg: float) -> list[tuple[str, int]]:
        bearings = (np.array([bearing_deg, 90.0, 270.0]),) * 10
        end = (100.0 + 60.0 * np.sin(np.radians(bearing_deg)), 60.0 * np.cos(np.radians(bearing_deg)))
        seen = [
            replace(each, bearings_deg=bearings, road=road_seen((0.5 * i, -0.5 * i), ((end, 12),)))
            for i, each in enumerate(passes())
        ]
        found = audit(merge(seen), osm(tmp_path, all_but(100.0)))
        return [each for each in told(found) if each[1] == 100]

    assert leaving(30.0) == [("missing_junction", 100)]
    assert leaving(50.0) == []


def test_one_pass_is_not_enough_unless_asked_for(tmp_path: Path) -> None:
    graph = osm(tmp_path, all_but(100.0))
    assert told(audit(merge(passes(1)), graph)) == []
    assert told(audit(merge(passes(1)), graph, AuditConfig(min_passes=1))) == [("missing_junction", 100)]


def test_a_pass_that_lost_scans_is_none(tmp_path: Path) -> None:
    graph, (whole, other) = osm(tmp_path, all_but(100.0)), passes()
    holes = replace(other, dropped_m=np.array([[0.0, 40.0], [300.0, 330.0]]))  # of 1,098 m
    merged = merge([whole, holes])
    assert told(audit(merged, graph)) == []
    assert set(merged.places.passes.tolist()) == {1}
    small = replace(other, dropped_m=np.array([[0.0, 40.0]]))
    assert told(audit(merge([whole, small]), graph)) == [("missing_junction", 100)]


def test_passes_need_not_agree_on_a_junction_where_all_saw_its_road(tmp_path: Path) -> None:
    one, other = passes()[0], passes(2, [x for x in SIDES_M if x != 100.0])[1]
    graph = osm(tmp_path, all_but(100.0))
    (finding,) = audit(merge([one, other]), graph).findings
    assert (finding.kind, finding.passes, finding.drives) == ("missing_junction", 2, ("d0", "d1"))
    assert other.road is not None
    blind = replace(other, road=replace(other.road, raster=Raster(0.5)))
    assert audit(merge([one, blind]), graph).findings == []  # came by, and saw no road


def test_a_junction_that_has_gone_since_is_not_missing(tmp_path: Path) -> None:
    left = passes(4, [x for x in SIDES_M if x != 100.0])[2:]
    days = [replace(each, span_s=1.8e9 + 86400.0 * (day + np.array([0.0, 0.01]))) for day, each in enumerate(passes())]
    for first, found in ((2, []), (-2, [("missing_junction", 100)])):  # it has gone, or come
        later = [replace(each, span_s=days[0].span_s + 86400.0 * (first + i)) for i, each in enumerate(left)]
        assert told(audit(merge([*days, *later]), osm(tmp_path, all_but(100.0)))) == found


def test_pieces_of_one_drive_are_one_pass(tmp_path: Path) -> None:
    graph = osm(tmp_path, all_but(100.0))
    for pause_s, found in ((60.0, []), (3600.0, [("missing_junction", 100)])):
        spans = np.array([[0.0, 900.0], [900.0 + pause_s, 1800.0 + pause_s]]) + 1.8e9
        pieces = [replace(each, span_s=span) for each, span in zip(passes(), spans, strict=True)]
        assert told(audit(merge(pieces), graph)) == found


def test_a_junction_beside_which_passes_drove_straight_on_lies_elsewhere(tmp_path: Path) -> None:
    unseen = merge(passes(2, [x for x in SIDES_M if x != 300.0]))
    (finding,) = audit(unseen, osm(tmp_path, [*all_but(300.0), (300.0, -12.0)])).findings
    assert (finding.kind, finding.uid, finding.passes) == ("moved", None, 2)
    assert finding.distance_m == pytest.approx(12.0, abs=0.5)
    assert audit(unseen, osm(tmp_path, [*all_but(300.0), (300.0, -4.0)])).findings == []


def test_a_corner_that_passes_cut_is_no_junction_elsewhere(tmp_path: Path) -> None:
    """They turn from the west to the north 8 m before the node of the map."""
    corner = np.array(
        [[x, 0.0] for x in np.arange(-400.0, -8.0, 2.0)] + [[-4.0, 4.0]] + [[0.0, y] for y in range(8, 60)]
    )
    both = enumerate(passes(2, [-300.0, -200.0]))
    found = [replace(each, track_lonlat=lonlat_from_enu(*ORIGIN, corner + 0.01 * i)) for i, each in both]
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(corner, axis=0).T)))
    turning = [replace(each, track_along_m=along, along_m=np.array([100.0, 200.0])) for each in found]
    assert told(audit(merge(turning), osm(tmp_path, [(x, 0.0) for x in (-300.0, -200.0, 4.0)]))) == []


@pytest.mark.parametrize(
    ("tags", "reason"),
    [
        ('<tag k="bridge" v="yes"/>', "bridge or levels"),
        ('<tag k="tunnel" v="yes"/>', "tunnel"),
        ('<tag k="junction" v="roundabout"/>', "roundabout"),
    ],
)
def test_levels_and_roundabouts_are_looked_at_before_anything_is_claimed(
    city: CityMap, tmp_path: Path, tags: str, reason: str
) -> None:
    found = audit(city, osm(tmp_path, all_but(100.0), tags=tags))
    assert found.findings == []
    assert found.held_back == {reason: 1}


def test_a_driveway_on_the_map_is_nothing_missing(city: CityMap, tmp_path: Path) -> None:
    private = way(2000, (900, 901), '<tag k="access" v="private"/>', "service")
    extra = node(900, 100.0, 0.0) + node(901, 100.0, 60.0) + private
    assert told(audit(city, osm(tmp_path, all_but(100.0), extra=extra))) == []


def test_nothing_is_said_of_what_a_made_up_map_lacks(city: CityMap, tmp_path: Path) -> None:
    found = audit(city, replace(osm(tmp_path, all_but(100.0)), is_made_up=True), ALL_KINDS)
    assert (found.findings, found.held_back) == ([], {"made-up map": 10})


def test_nothing_is_missing_far_from_any_road_of_the_map(city: CityMap, tmp_path: Path) -> None:
    """Without bounds, as extracts of Overpass are: the file of another drive, or one that ends on the way."""
    whole = osm(tmp_path)
    there = np.isin(whole.ways.id, [1001, 1002])[whole.edge_way]  # the first two side roads alone
    found = audit(city, replace(whole, edges=whole.edges[there], edge_way=whole.edge_way[there]))
    assert found.held_back["edge of the map"] >= 6
    assert all(x <= 100 for _, x in told(found))


def test_a_place_is_compared_with_the_maps_of_its_own_drives(tmp_path: Path) -> None:
    whole = osm(tmp_path)

    def without(*sides_m: float) -> RoadGraph:
        ways = [np.flatnonzero(whole.ways.id == 1001 + SIDES_M.index(x))[0] for x in sides_m]
        left = ~np.isin(whole.edge_way, ways)
        return replace(whole, edges=whole.edges[left], edge_way=whole.edge_way[left])

    lacks, older = without(100.0), without(100.0, 300.0)
    city = merge(passes(3))
    both = [("missing_junction", 100), ("missing_junction", 300)]
    assert told(audit(city, [(older, ["d0"]), (lacks, ["d1", "d2"])])) == both[:1], "what any of them has is there"
    assert told(audit(city, [(older, ["d0", "d1", "d2"])])) == both
    assert told(audit(city, [(whole, ["d0"]), (lacks, ["d1"])])) == []
    elsewhere = audit(city, [(lacks, ["a drive of another town"])])
    assert (elsewhere.findings, elsewhere.held_back) == ([], {"no map of these drives": 1})
    made_up = replace(whole, is_made_up=True)
    assert told(audit(city, [(lacks, ["d0"]), (made_up, ["d1", "d2"])])) == both[:1], "made up is nothing"


def test_several_maps_are_one(tmp_path: Path) -> None:
    graph = osm(tmp_path)
    west, east = (graph.lonlat[:, 0] < 8.4035, graph.lonlat[:, 0] > 8.4005)
    parts = []
    for inside in (west, east):
        kept = inside[graph.edges].all(axis=1)
        cut = graph.edges[inside[graph.edges].any(axis=1) & ~kept]
        ends = np.column_stack([cut[:, :1], graph.node_id[cut[:, 1]], np.zeros(len(cut), np.int64)])
        ends = ends[inside[cut[:, 0]]] if len(cut) else ends
        parts.append(replace(graph, edges=graph.edges[kept], edge_way=graph.edge_way[kept], loose_ends=ends))
    moved = parts[1].lonlat.copy()
    moved[0] += 1e-5
    whole, _ = joined([parts[0], replace(parts[1], lonlat=moved)])
    assert np.array_equal(whole.degree(), graph.degree()), "roads that both have count once, and no end is loose"
    assert whole.lonlat[0].tolist() == moved[0].tolist(), "the last one says where a node lies"
    assert (whole.ways.highway, whole.ways.tags) == (graph.ways.highway, graph.ways.tags)


def test_a_track_with_a_hole_drove_straight_past_nothing(tmp_path: Path) -> None:
    """Scans were lost for 60 m around the junction: the line between is no evidence that it lies elsewhere."""
    found = []
    for each in passes(2, [x for x in SIDES_M if x != 300.0]):
        seen = np.abs(each.track_along_m - 700.0) > 30.0
        found.append(replace(each, track_lonlat=each.track_lonlat[seen], track_along_m=each.track_along_m[seen]))
    graph = osm(tmp_path, [*all_but(300.0), (300.0, -12.0)])
    assert audit(merge(found), graph).findings == []


# receivers ------------------------------------------------------------------------------------------------------------


def task_names(path: Path) -> list[str]:
    """Read a file as MapRoulette does (ChallengeProvider.scala): line by line, a name by the first feature's id."""
    lines = path.read_text().split("\n")[:-1]
    assert lines[0].startswith("\x1e") or all(each[:1] == "{" and each[-1:] == "}" for each in lines[:2])
    names = []
    for line in lines:
        first = json.loads(line.lstrip("\x1e"))["features"][0]
        holders = (first, first["properties"])
        names.append(next(str(h[key]) for h in holders for key in ("id", "@id", "osmid", "osm_id", "name") if key in h))
    return names


def test_the_same_findings_are_known_again_whatever_happens_to_the_drives(tmp_path: Path) -> None:
    graph = osm(tmp_path, [*all_but(100.0, 300.0), (308.0, -9.0)])
    drives = passes(5)
    city, out = merge(drives[:2]), tmp_path / "audit"
    again = replace(drives[1], key="worked on again", lonlat=drives[1].lonlat + 1e-6)
    identities = []
    for change in (
        lambda: city.add(drives[2]),
        lambda: None,
        lambda: city.add(*drives[3:]),
        lambda: city.replace(again),
        lambda: city.remove("d0", "d2"),
        lambda: None,
    ):
        found = audit(city, graph, known=known_findings(out))
        write_audit(found, city, out, AuditConfig(), source=graph.source)
        assert known_findings(out) == {each.id for each in found.findings}
        identities.append(sorted(task_names(out / MAPROULETTE_FILE)))
        change()
    assert all(each == identities[0] for each in identities)
    assert len(set(identities[0])) == 2


EAST = np.array([1.6e-4, 0.0])  # 12 m


def test_a_common_offset_of_all_drives_is_no_error_of_a_place(tmp_path: Path) -> None:
    def moved(each: Pass) -> Pass:
        return replace(each, lonlat=each.lonlat + EAST, track_lonlat=each.track_lonlat + EAST)

    found = audit(merge([moved(each) for each in passes()]), osm(tmp_path))
    assert found.findings == []
    assert found.offset_m.round() == pytest.approx([-12, 0], abs=1.1)


def test_a_finding_near_a_threshold_does_not_come_and_go(city: CityMap, tmp_path: Path) -> None:
    graph = osm(tmp_path, [*all_but(300.0), (300.0, -9.0)])
    (finding,) = audit(city, graph).findings
    strict = AuditConfig(moved_m=11.0)
    assert audit(city, graph, strict).findings == []
    assert [each.id for each in audit(city, graph, strict, known={finding.id}).findings] == [finding.id]


def test_what_was_marked_wrong_does_not_come_back_whatever_its_kind(city: CityMap, tmp_path: Path) -> None:
    graph = osm(tmp_path, [*all_but(300.0), (300.0, -9.0)])
    write_audit(audit(city, graph), city, tmp_path / "audit", AuditConfig(), source=graph.source)
    (feature,) = read_json(tmp_path / "audit" / FINDINGS_FILE)["features"]
    wrong = judgement_of(feature, "wrong", "Anna", NOON)
    for name in ("lacks", "elsewhere"):
        (tmp_path / name).mkdir()
    lacks = osm(tmp_path / "lacks", all_but(300.0))
    assert [each.kind for each in audit(city, lacks).findings] == ["missing_junction"]
    fewer, again = merge(passes(3)), replace(passes()[1], key="worked on again")
    fewer.remove("d0")
    fewer.replace(again)
    unseen = merge(passes(2, [x for x in SIDES_M if x != 300.0]))
    for of, now in ((city, graph), (city, lacks), (fewer, graph), (fewer, lacks), (unseen, graph)):
        found = audit(of, now, wrong=[wrong])
        assert (found.findings, found.held_back["marked wrong"]) == ([], 1)
    assert len(audit(city, osm(tmp_path / "elsewhere", all_but(200.0)), wrong=[wrong]).findings) == 1
    write_audit(found, city, tmp_path / "again", AuditConfig(), source=graph.source)
    assert wrong.finding in known_findings(tmp_path / "again")  # if the verdict is taken back
    png = (tmp_path / "audit" / "pictures" / f"{wrong.finding}.png").read_bytes()
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (640, 640, 3)
    assert picture[320, 100].tolist() != [255, 255, 255]  # the road, 220 pixels to the west of the cross
