"""What of OpenStreetMap a map of many drives contradicts: each finding with its evidence.

The map is only said to be wrong where several passes agree, and where nothing explains it away: levels, access,
squares, the edge of the map. A finding is a question to a person with a picture, not an edit.
"""

from bisect import bisect
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.city.citymap import CityMap
from interloc.city.drives import HOLE_M
from interloc.city.layers import changes
from interloc.city.models import AuditConfig, Judgement
from interloc.city.osm_plane import OsmPlane
from interloc.city.places import SAME_PASS_S, PlaceTable
from interloc.geometry import nearest_of, tree_of
from interloc.osm.graph import RoadGraph
from interloc.osm.intersections import unjoined
from interloc.osm.policies import FindingKind

WRONG_M = 15.0
"""Within this of what was marked wrong nothing is claimed."""

_GONE = "gone_junction"
_RAY_AT_M = np.array([12.0, 18.0, 24.0])
_ARM_M = np.arange(8.0, 45.1)  # of a branch, from where the roads have parted to where few drives see any
_CELL_M = 0.5
_ACROSS_M = np.arange(-16.0, 16.1, _CELL_M)
_WIDER = 1.5  # a road as it was seen may be wider than its branch is taken to be
_LEADS_M = 15.0  # a drive that saw the side roads of the map less far, or few of them, is asked for this
_FEW = 5
_OFF_TRACK_M = 12.0
_ROAD_START_M = slice(4, 16)  # nearer to a node is the road that it lies on
_LEVEL_M = 25.0
_PORTAL_M = 50.0
_EDGE_M = 40.0
_PARTNER_M = 25.0
_APART_DEG = 50.0
_TRACK_M = 15.0
_ODD_M = 30.0
_ALSO_ELSEWHERE_M = 60.0
_SLIP_M = 10.0  # a place so near is the junction that a slip of the map hides
_PAST_M = 100.0  # roads of a node join the track within this
_ON_TRACK_M = 4.0
_AHEAD_M = 15
_STRAIGHT = 0.87  # cosine of 30 degrees
_OFF_MAP_M = 3.0
_BEGINS_M = 4.0  # a road that bends away from the straight line is still within this of it at its beginning


@dataclass(frozen=True)
class Finding:
    """A place where OpenStreetMap seems to be wrong."""

    id: str
    """Of the kind and the place, or the node: it stays when drives are added."""
    kind: FindingKind
    xy: FloatArray
    """(2,) float64: where to look, in the plane of the map."""
    uid: str | None
    """The place on the map; None: there is none."""
    osm_node: str | None
    """The node that it is about; None where OpenStreetMap lacks something."""
    passes: int
    """Independent passes that say so."""
    drives: tuple[str, ...]
    text: str
    """What was found, for a person who looks at it."""
    ways: list[str]
    """Ways of OpenStreetMap around, with their tags."""
    node_xy: FloatArray | None
    """(2,) float64: where that node lies."""
    distance_m: float | None
    """To that node, the nearest junction or the slip of drawing; None: there is none."""
    branch_bearings_deg: list[float]
    branch_widths_m: list[float]
    """Of the branches that OpenStreetMap lacks."""


@dataclass(frozen=True)
class Audit:
    """Findings, and on how much of the map there could have been any."""

    findings: list[Finding]
    junctions: int
    """Junctions of OpenStreetMap that enough passes came by."""
    offset_m: FloatArray
    """(2,) float64: common offset of OpenStreetMap against the map, which was taken away."""
    held_back: dict[str, int]
    """How many candidates were not claimed, by reason."""
    marked_wrong: list[str] = field(default_factory=list)
    """Ids of findings that are none, by what people say."""


OwnMap = tuple[RoadGraph, Collection[str]]
"""A map, and the names of the drives whose places it is for."""


def audit(
    city: CityMap,
    maps: RoadGraph | Sequence[OwnMap],
    config: AuditConfig | None = None,
    *,
    known: Collection[str] = (),
    wrong: Sequence[Judgement] = (),
) -> Audit:
    """Compare a map of many drives with one map of OpenStreetMap, or several, each for some drives, the newest last.

    A place is compared with the maps of the drives that came by; nothing is claimed where there is none, where they
    end, or near what people marked wrong. Findings that are known, by their ids, stay while they reach 70 % of what a
    new one must, so that one near a threshold does not come and go.
    """
    own = [(maps, city.drives.keys())] if isinstance(maps, RoadGraph) else maps
    real = [(graph, frozenset(names)) for graph, names in own if not graph.is_made_up]
    if not real:
        return Audit([], 0, np.zeros(2), {"made-up map": int(city.places.is_shown.sum())})
    found = _Auditor(city, real, config or AuditConfig(), frozenset(known)).run()
    places = city.plane(np.array([(each.lon, each.lat) for each in wrong])) if wrong else np.zeros((0, 2))
    about = {each.uid for each in wrong} | {each.osm_id for each in wrong} - {None}
    left = [
        each
        for each in found.findings
        if about.isdisjoint({each.uid, each.osm_node} - {None})
        and not nearest_of(each.xy[None], places)[0][0] <= WRONG_M
    ]
    marked = sorted({each.id for each in found.findings} - {each.id for each in left})
    held = {"marked wrong": len(marked)} if marked else {}
    return replace(found, findings=left, held_back={**found.held_back, **held}, marked_wrong=marked)


class _Auditor:
    def __init__(
        self, city: CityMap, maps: list[tuple[RoadGraph, frozenset[str]]], config: AuditConfig, known: frozenset[str]
    ) -> None:
        self.city, self.maps, self.config, self.known = city, maps, config, known
        self.osm = OsmPlane.of(city, *(graph for graph, _ in maps))
        self.places: PlaceTable = city.places
        self.held_back: dict[str, int] = {}
        self._usual: dict[str, float] = {}

    def run(self) -> Audit:
        makers: list[tuple[set[FindingKind], Callable[[], Iterator[Finding]]]] = [
            ({"missing_junction", "missing_branch"}, self._missing),
            ({"moved"}, self._beside),
            ({"moved"}, self._moved),
            ({"not_joined", "no_node"}, self._unjoined),
        ]
        wanted = set(self.config.kinds)
        made = (finding for kinds, make in makers if kinds & wanted for finding in make())
        findings = list({each.id: each for each in made}.values())
        # What leads to a junction that lies elsewhere lies elsewhere, too: nothing is missing there.
        elsewhere = np.array([each.xy for each in findings if each.kind == "moved"]).reshape(-1, 2)
        away = nearest_of(np.array([each.xy for each in findings]).reshape(-1, 2), elsewhere)[0].tolist()
        findings = [
            each
            for each, metres in zip(findings, away, strict=True)
            if each.kind in wanted and not (each.kind.startswith("missing") and metres < _ALSO_ELSEWHERE_M)
        ]
        passed = [node for node in self.osm.open_junctions.tolist() if self._enough(self.came_by.get(node, ()))]
        findings.sort(key=lambda each: each.id)
        return Audit(findings, len(passed), self.osm.offset_m, dict(sorted(self.held_back.items())))

    # kinds ------------------------------------------------------------------------------------------------------------

    def _missing(self) -> Iterator[Finding]:
        """Yield junctions and branches that OpenStreetMap lacks."""
        table, osm = self.places, self.osm
        nearest, node = nearest_of(table.xy, osm.xy[osm.junctions])
        for row in self.looked_at.tolist():
            kind: FindingKind = "missing_junction" if nearest[row] > self.config.junction_m else "missing_branch"
            ease = self._ease(kind, table.uid[row])
            if self.certainty[row] < self.config.min_confidence * ease:
                continue
            # A junction that lies a little elsewhere has its branches elsewhere, too: it lacks none of them.
            origins = [table.xy[row], *([osm.xy[osm.junctions[node[row]]]] if kind == "missing_branch" else [])]
            saw = {i: self._lacks(row, i, origins, ease) for i in range(len(table.bearings_deg[row]))}
            branches = [i for i, drives in saw.items() if self._enough(drives)]
            if not branches or self._is_held_back(self._excuse(table.xy[row], table.near[row])):
                continue
            drives = saw[branches[0]]
            bearings = [float(table.bearings_deg[row][i]) for i in branches]
            widths = [float(table.widths_m[row][i]) for i in branches]
            what = "a junction here" if kind == "missing_junction" else "another branch of this junction"
            yield self._finding(
                kind,
                row,
                None,
                f"{self._passes(drives)} passes of a LiDAR saw {what} that the map does not have: road towards "
                f"{', '.join(f'{each:.0f} degrees' for each in bearings)}, "
                f"{', '.join(f'{each:.1f} m' for each in widths)} wide. Is it a road?",
                drives,
                distance_m=nearest[row],
                bearings_deg=bearings,
                widths_m=widths,
            )

    def _lacks(self, row: int, branch: int, origins: Sequence[FloatArray], ease: float) -> tuple[str, ...]:
        """Return the drives that saw a branch of a place as a road, if OpenStreetMap does not have it, of any origin.

        They need not agree that it is a branch: one of them has found it, all that came near can tell road there. It
        must lead off as far as the side roads do that the same drive saw and the map has: what ends before is a yard
        or a drive, and where labels call those road, a drive says nothing of them.
        """
        table, config = self.places, self.config
        bearings = table.bearings_deg[row]
        between = np.abs((np.delete(bearings, branch) - bearings[branch] + 180.0) % 360.0 - 180.0)
        if not self._is_narrow(row, branch) or between.min(initial=180.0) < _APART_DEG:  # else a lane, or a lay-by
            return ()
        ray = _RAY_AT_M[:, None] * _ahead(bearings[branch])
        for origin in origins:
            away = self.osm.distance(origin + ray)
            if away[0] <= _BEGINS_M * ease or np.median(away) <= config.ray_m * ease:
                return ()
        minimum = config.min_road * ease
        return tuple(n for n in table.near[row] if self._leads_m(n, row, branch) >= minimum * self._usual_m(n))

    def _is_narrow(self, row: int, branch: int) -> bool:
        """Tell whether a branch is as wide as a road; not known is neither."""
        return bool(self.config.min_width_m <= self.places.widths_m[row][branch] <= self.config.max_width_m)

    def _leads_m(self, name: str, row: int, branch: int) -> float:
        """Return along how many metres of a branch a drive saw road with an edge on either side: no square."""
        ahead = _ahead(self.places.bearings_deg[row][branch])
        xy = self.places.xy[row] + _ARM_M[:, None, None] * ahead + _ACROSS_M[:, None] * (ahead[::-1] * [1.0, -1.0])
        road = self.city.drives[name].ground_at(xy.reshape(-1, 2), self.city.epsg)[0].reshape(xy.shape[:2])
        metres, middle = 0, len(_ACROSS_M) // 2
        for cells in road:
            if not cells[middle]:
                continue
            gaps = [-1, *np.flatnonzero(~cells).tolist(), len(cells)]
            right = bisect(gaps, middle)
            width, middle_there = gaps[right] - gaps[right - 1] - 1, (gaps[right] + gaps[right - 1] + 1) // 2
            if width * _CELL_M <= _WIDER * self.config.max_width_m:
                metres += 1
                middle += min(max(middle_there - middle, -1), 1)  # roads bend
        return float(metres)

    def _usual_m(self, name: str) -> float:
        """Return how far a drive saw the side roads lead off that the map has, the median of them."""
        if name not in self._usual:
            drive, near = self.city.drives[name], self.places.near
            seen = [
                self._leads_m(name, row, branch)
                for row, branch, tip in self.sides
                if name in near[row] and drive.track.query(tip + drive.knots.mean(axis=0))[0] > _OFF_TRACK_M
            ]
            self._usual[name] = max(_LEADS_M, float(np.median(seen)) if len(seen) >= _FEW else 0.0)
        return self._usual[name]

    @cached_property
    def sides(self) -> list[tuple[int, int, FloatArray]]:
        """Branches that the map has at its junctions: place, branch, and a position (2,) out on it."""
        table, osm = self.places, self.osm
        away = nearest_of(table.xy, osm.xy[osm.open_junctions])[0]
        rows = self.looked_at[away[self.looked_at] <= self.config.junction_m].tolist()
        found = [(row, i) for row in rows for i in range(len(table.bearings_deg[row])) if self._is_narrow(row, i)]
        rays = np.array([table.xy[r] + _RAY_AT_M[:, None] * _ahead(table.bearings_deg[r][i]) for r, i in found])
        off = np.median(osm.distance(rays.reshape(-1, 2), osm.open_roads).reshape(-1, len(_RAY_AT_M)), axis=1)
        there = zip(found, rays, off, strict=True)
        return [(*each, ray[-1]) for each, ray, metres in there if metres <= self.config.ray_m]

    def _road(self, name: str, xy: FloatArray) -> float:
        """Return the share of (N, 2) positions that a drive saw as road."""
        return float(self.city.drives[name].ground_at(xy, self.city.epsg)[0].mean())

    def _moved(self) -> Iterator[Finding]:
        """Yield junctions that lie elsewhere: place and node are each other's only partner."""
        table, osm, config = self.places, self.osm, self.config
        shown = np.flatnonzero(table.is_shown)
        if not len(shown) or not len(osm.open_junctions):
            return
        places, nodes = tree_of(table.xy[shown]), tree_of(osm.xy[osm.junctions])
        is_open = np.isin(osm.junctions, osm.open_junctions)
        for row in self.looked_at.tolist():
            here = table.xy[row]
            near = nodes.query_ball_point(here, _PARTNER_M)
            if len(near) != 1 or not is_open[near[0]]:
                continue
            node = int(osm.junctions[near[0]])
            ease, apart = self._ease("moved", osm.graph.node_id[node]), osm.xy[node] - here
            distance = float(np.hypot(*apart))
            cov = table.position_cov_m2[row][[[0, 1], [1, 2]]]
            sigmas = float(np.sqrt(apart @ np.linalg.solve(cov, apart)))
            if (
                distance <= max(config.moved_m, 3.0 * table.position_std_m[row]) * ease
                or sigmas <= config.moved_sigma * ease
            ):
                continue
            beside = [each for each in shown[places.query_ball_point(osm.xy[node], _PARTNER_M)].tolist() if each != row]
            bearings = np.sort(table.bearings_deg[row])
            gaps = np.diff(np.append(bearings, bearings[0] + 360.0))
            drives = self._off_road(row, node, ease)
            reason = (
                "several places near the node, or not sure enough"
                if self._are_strange(beside, node) or self.certainty[row] < config.min_confidence * ease
                else "acute: the position slides along the bisector"
                if gaps.min() < _APART_DEG
                else "link, roundabout or two carriageways"
                if osm.is_odd(node)
                else "node and its roads lie on what was seen as road"
                if not self._enough(drives)
                else self._excuse(here, table.near[row])
            )
            if self._is_held_back(reason):
                continue
            yield self._finding(
                "moved",
                row,
                node,
                f"{self._passes(drives)} passes of a LiDAR saw this junction {distance:.1f} m from its node "
                f"(uncertainty {table.position_std_m[row]:.1f} m). Does the node, or one of its roads, lie elsewhere?",
                drives,
                distance_m=distance,
            )

    def _are_strange(self, places: Sequence[int], node: int) -> bool:
        """Tell whether any of some places has no junction of its own that is nearer than a node."""
        xy, others = self.places.xy[places], self.osm.junctions[self.osm.junctions != node]
        own, _ = nearest_of(xy, self.osm.xy[others])
        return bool((own > np.minimum(self.config.junction_m, np.hypot(*(xy - self.osm.xy[node]).T))).any())

    def _off_road(self, row: int, node: int, ease: float) -> tuple[str, ...]:
        """Return the drives that saw no road where a node, or the beginning of one of its roads, lies."""
        spots = [self.osm.xy[[node]], *(road[_ROAD_START_M] for road in self.osm.roads_from(node, _PAST_M))]
        spots = [spot for spot in spots if len(spot)]
        names = self.places.near[row]
        return tuple(name for name in names if min(self._road(name, spot) for spot in spots) < 0.5 / ease)

    def _beside(self) -> Iterator[Finding]:
        """Yield junctions beside the road: passes drove straight on, from one road of the node to another."""
        osm, config = self.osm, self.config
        nodes = np.array([each for each in osm.open_junctions.tolist() if not osm.is_odd(each)], dtype=np.int64)
        past: dict[int, dict[str, float]] = defaultdict(dict)
        for name, drive in sorted(self.city.drives.items()):
            track = tree_of(drive.track_each_m - drive.knots.mean(axis=0))
            metres = np.asarray(track.query(osm.xy[nodes])[0])
            rows = np.flatnonzero((metres > config.moved_m * config.kept) & (metres < _PAST_M))
            for node, distance in zip(nodes[rows].tolist(), metres[rows].tolist(), strict=True):
                if self._leads_past(track, node):
                    past[node][name] = distance
        for node, found in past.items():
            minimum = config.moved_m * self._ease("moved", osm.graph.node_id[node])
            drives = tuple(name for name, distance in found.items() if distance > minimum)
            if not self._enough(drives) or self._is_held_back(self._excuse(osm.xy[node], drives)):
                continue
            distance = float(np.median([found[name] for name in drives]))
            yield self._finding(
                "moved",
                None,
                node,
                f"{self._passes(drives)} passes of a LiDAR drove from one road of this junction straight to another, "
                f"{distance:.1f} m beside its node. Does the node, or one of its roads, lie elsewhere?",
                drives,
                distance_m=distance,
            )

    def _leads_past(self, tree: Any, node: int) -> bool:  # noqa: ANN401 - without types
        """Tell whether a track, a position each metre, leads straight from a road of a node to another, off the map."""
        joins, track = list[int](), tree.data
        for road in self.osm.roads_from(node, _PAST_M):
            metres, at = tree.query(road)
            joins += at[metres < _ON_TRACK_M][:1].tolist()
        for first, last in combinations(sorted(joins), 2):
            into = track[first] - track[max(first - _AHEAD_M, 0)]
            out = track[min(last + _AHEAD_M, len(track) - 1)] - track[last]
            margin = (last - first) // 4
            driven = track[max(first - _AHEAD_M, 0) : last + _AHEAD_M + 1]
            if np.hypot(*np.diff(driven, axis=0).T).max(initial=0.0) > HOLE_M:
                continue  # a hole: nobody knows where it drove
            if into @ out > _STRAIGHT * np.hypot(*into) * np.hypot(*out):
                off = self.osm.distance(track[first + margin : last - margin + 1])
                if np.median(off) > _OFF_MAP_M:
                    return True
        return False

    def _unjoined(self) -> Iterator[Finding]:
        """Yield junctions that the map hides by a slip of drawing, and passes saw."""
        osm, table, rows = self.osm, self.places, self.looked_at
        near = nearest_of(osm.xy, table.xy[rows])[0] <= _ALSO_ELSEWHERE_M
        slips = unjoined(osm.graph, osm.xy, osm.open_roads, near)
        away, place = nearest_of(np.array([each.xy for each in slips]).reshape(-1, 2), table.xy[rows])
        for each, metres, row in zip(slips, away.tolist(), rows[place].tolist() if len(rows) else (), strict=False):
            about = table.uid[row] if each.node is None else osm.graph.node_id[each.node]
            minimum = self.config.min_confidence * self._ease(each.kind, about)
            if metres > _SLIP_M or self.certainty[row] < minimum or table.passes[row] < self.config.min_passes:
                continue
            if self._is_held_back(self._excuse(table.xy[row], table.near[row])):
                continue
            yield self._finding(
                each.kind,
                row,
                each.node,
                f"{table.passes[row]} passes of a LiDAR saw a junction here, and on the map {each.text}. "
                "Should they be joined?",
                distance_m=metres,
            )

    # what they share --------------------------------------------------------------------------------------------------

    @cached_property
    def came_by(self) -> dict[int, list[str]]:
        """The drives that came by each open junction: three keyframes or more within 15 m."""
        rows, found = self.osm.open_junctions, defaultdict[int, list[str]](list)
        for name, drive in sorted(self.city.drives.items()):
            tree = tree_of(drive.track_xy - drive.knots.mean(axis=0))
            counts = tree.query_ball_point(self.osm.xy[rows], _TRACK_M, return_length=True)
            for node in rows[np.asarray(counts) >= 3].tolist():
                found[node].append(name)
        return found

    def _passes(self, names: Sequence[str]) -> int:
        """Return how many passes drives are: one that begins within ten minutes of another's end is the same.

        One that has lost scans along more than a twentieth of its track is none.
        """
        passes = [self.city.drives[name].data for name in names]
        spans = np.array([each.span_s for each in passes if each.is_whole]).reshape(-1, 2)
        timed = spans[np.isfinite(spans).all(axis=1)]
        first, last = timed[np.argsort(timed[:, 0])].T
        gaps = first[1:] - np.maximum.accumulate(last)[:-1]
        return len(spans) - max(len(timed) - 1, 0) + int(np.sum(gaps > SAME_PASS_S))

    def _enough(self, names: Sequence[str]) -> bool:
        return self._passes(names) >= self.config.min_passes

    @cached_property
    def looked_at(self) -> IntArray:
        """Places that enough passes came by, whether all of them saw it or not; none that has gone since."""
        table = self.places
        gone = {each["properties"]["uid"] for each in changes(self.city) if each["properties"]["kind"] == _GONE}
        rows = [
            row
            for row in np.flatnonzero(table.is_shown).tolist()
            if table.uid[row] not in gone and self._enough(table.near[row])
        ]
        return np.array(rows, dtype=np.int64)

    @cached_property
    def certainty(self) -> FloatArray:
        """(P,) confidence of the places by the drives that saw them."""
        pairs = zip(self.places.near, self.places.drives, strict=True)
        found: FloatArray = self.places.confidence * np.array([len(near) / len(saw) for near, saw in pairs])
        return found

    def _excuse(self, xy: FloatArray, drives: Sequence[str]) -> str | None:
        """Return why nothing is to be claimed at a place that drives came by; None where nothing speaks against it."""
        osm = self.osm
        own = [graph for graph, names in self.maps if not names.isdisjoint(drives)]
        if not own:
            return "no map of these drives"
        corners = self.city.lonlat(xy + osm.offset_m + _EDGE_M * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]))
        if not np.any([graph.covers(corners) for graph in own], axis=0).all():
            return "edge of the map"
        around = np.array([xy])
        if osm.distance(around, osm.tagged("tunnel") | osm.tagged("covered"))[0] < _PORTAL_M:
            return "tunnel"
        if osm.distance(around, osm.on_levels)[0] < _LEVEL_M:
            return "bridge or levels"
        if osm.distance(around, osm.tagged("junction"))[0] < _ODD_M:
            return "roundabout"
        return None

    def _ease(self, kind: FindingKind, about: object) -> float:
        return self.config.kept if _key(kind, about) in self.known else 1.0

    def _is_held_back(self, reason: str | None) -> bool:
        if reason is not None:
            self.held_back[reason] = self.held_back.get(reason, 0) + 1
        return reason is not None

    def _finding(
        self,
        kind: FindingKind,
        row: int | None,
        node: int | None,
        text: str,
        drives: tuple[str, ...] | None = None,
        *,
        distance_m: float,
        bearings_deg: Sequence[float] = (),
        widths_m: Sequence[float] = (),
    ) -> Finding:
        uid = None if row is None else self.places.uid[row]
        xy = self.osm.xy[node] if row is None else self.places.xy[row]
        names = drives or (() if row is None else self.places.drives[row])
        osm_node = None if node is None else str(self.osm.graph.node_id[node])
        ways = self.osm.graph.ways
        tags = ways.tags
        around = [
            " ".join([f"way/{ways.id[way]} highway={ways.highway[way]}", *(f"{k}={v}" for k, v in tags[way].items())])
            for way in self.osm.ways_near(xy, _PARTNER_M)[:6]
        ]
        return Finding(
            id=_key(kind, uid if osm_node is None else osm_node),
            kind=kind,
            xy=xy,
            uid=uid,
            osm_node=osm_node,
            passes=int(self.places.passes[row]) if drives is None and row is not None else self._passes(names),
            drives=names,
            text=text,
            ways=around,
            node_xy=None if node is None else self.osm.xy[node],
            distance_m=round(float(distance_m), 2) if np.isfinite(distance_m) else None,
            branch_bearings_deg=[round(each, 1) for each in bearings_deg],
            branch_widths_m=[round(each, 1) for each in widths_m],
        )


def _ahead(bearing_deg: float) -> FloatArray:
    """Return the unit vector, (2,), of a bearing."""
    angle = np.radians(bearing_deg)
    return np.array([np.sin(angle), np.cos(angle)])


def _key(kind: FindingKind, about: object) -> str:
    return f"{kind}-{about}"
