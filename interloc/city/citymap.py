"""Many drives as one map: each drive added finds its offset, joins its sightings to the places, and moves the rest.

What the map is depends on which drives are in it, not on the order in which they came. Each step is a function of the
set of drives, done anew only where something changed: votes between two drives; the offsets that the votes agree on,
rounded; the places of a neighbourhood; and the adjustment, whose solution is unique.
"""

import hashlib
import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray, distinct
from interloc.city.alignment import CELL_M, LINK_M, Prior, adjust, group, knots_along, linked, offsets_of, vote
from interloc.city.drives import DriveOnMap, Pass, system_of
from interloc.city.models import CityConfig
from interloc.city.places import Branches, PlaceTable, tabulate
from interloc.errors import ConfigError, GeoreferenceError
from interloc.geometry import projection, tree_of, utm_zone
from interloc.results import DriveResult

ROUNDING_M = 0.5
"""Offsets by voting count as rounded to this, so that they mostly stay the same when a drive is added."""

_SAME_PLACE_M = 10.0  # a place that lies within this of where it was keeps its name
_FARTHEST_M = 400_000.0  # from the first drive: the projection is of its zone
_STILL_M = 1e-4  # a drive that would move by less stays


class CityMap:
    """One map of many drives; drives are added, replaced and removed one by one or several at once.

    Parameters
    ----------
    config : CityConfig

    Attributes
    ----------
    epsg : int or None
        The plane of the map: the UTM zone of the first drive; None before.
    drives : dict of str to DriveOnMap
        By name.

    Examples
    --------
    ::

        city = interloc.merge([result_1, result_2])
        city.add(result_3)
        print(city.places.lonlat, city.places.position_std_m)
    """

    def __init__(self, config: CityConfig | None = None) -> None:
        self.config = config or CityConfig()
        self.epsg: int | None = None
        self.drives: dict[str, DriveOnMap] = {}
        self.votes: dict[tuple[str, str], tuple[float, float, float]] = {}
        self.uid_of: dict[int, str] = {}
        self.register: dict[str, tuple[float, float]] = {}
        self.next_number = 0
        self._places: PlaceTable | None = None
        self._branches_of: dict[int, Branches] = {}

    def __repr__(self) -> str:
        return f"<CityMap {len(self.drives)} drives, {len(self.uid_of)} places>"

    def add(self, *results: DriveResult | Pass) -> None:
        """Add drives.

        Raises
        ------
        ConfigError
            A drive of that name, or the same drive under another, is on the map already.
        GeoreferenceError
            A drive has no georeference, or lies elsewhere on Earth. The map is as it was.
        """
        self._change((), results)

    def replace(self, *results: DriveResult | Pass) -> None:
        """Put other results of drives in the place of those on the map; drives that are not on it are added."""
        passes = [_as_pass(each) for each in results]
        self._change([each.name for each in passes if each.name in self.drives], passes)

    def remove(self, *names: str) -> None:
        """Take drives out of the map: it is then as if they had never been there, but for names that stay taken.

        Raises
        ------
        ConfigError
            A drive is not on the map.
        """
        missing = [name for name in names if name not in self.drives]
        if missing:
            raise ConfigError(f"drive {missing[0]!r} is not on the map. It has: {', '.join(sorted(self.drives))}.")
        self._change(names, ())

    @property
    def in_order(self) -> list[DriveOnMap]:
        """Its drives by their names."""
        return [self.drives[name] for name in sorted(self.drives)]

    @property
    def places(self) -> PlaceTable:
        """What is on the map: one row per physical intersection."""
        if self._places is None:
            self._places = tabulate(self.in_order, self.uid_of, self.lonlat, self.config, self._branches_of)
        return self._places

    def lonlat(self, xy: FloatArray) -> FloatArray:
        """Return longitude and latitude of (N, 2) positions in the plane of the map."""
        return projection(self.epsg, 4326)(xy)

    def plane(self, lonlat: FloatArray) -> FloatArray:
        """Return the positions in the plane of the map of (N, 2) longitudes and latitudes."""
        return projection(4326, self.epsg)(lonlat)

    # one change -------------------------------------------------------------------------------------------------------

    def _change(self, removed: Iterable[str], added: Sequence[DriveResult | Pass]) -> None:
        passes, removed = [_as_pass(each) for each in added], set(removed)
        names = [*(name for name in self.drives if name not in removed), *(each.name for each in passes)]
        twice = next((name for number, name in enumerate(names) if name in names[:number]), None)
        if twice is not None:
            raise ConfigError(
                f"drive {twice!r} is on the map already, or given twice. Replace it, or give the other another name."
            )
        name_of = {drive.data.track: name for name, drive in self.drives.items() if name not in removed}
        for each in passes:
            same = name_of.setdefault(each.track, each.name)
            if same != each.name:
                raise ConfigError(f"drive {each.name!r} is the same as {same!r}: it would count twice.")
        if not self.drives:
            self.epsg = None  # the next drive may lie anywhere
        new = [self.placed(each) for each in passes]
        touched = [self.drives.pop(name).neighbourhood for name in removed]
        self.votes = {pair: said for pair, said in self.votes.items() if removed.isdisjoint(pair)}
        for drive in new:
            self._vote(drive)
            self.drives[drive.data.name] = drive
        self._group(distinct(np.concatenate([np.zeros(0, dtype=np.int64), *touched])))
        self._places = None

    def placed(self, data: Pass) -> DriveOnMap:
        """Bring a drive into the plane of the map."""
        if self.epsg is None:
            self.epsg = utm_zone(*data.track_lonlat[0].tolist())
        xy, track_xy = self.plane(data.lonlat), self.plane(data.track_lonlat)
        if not np.isfinite(track_xy).all() or np.abs(track_xy[0, 0] - 500_000.0) > _FARTHEST_M:
            lon, lat = data.track_lonlat[0]
            raise GeoreferenceError(
                f"{data.name}: it lies at lon {lon:.4f}, lat {lat:.4f}, in another part of the world than the map "
                f"(EPSG:{self.epsg}). Make a map of its own for it."
            )
        length = float(data.track_along_m[-1])
        knot, share, count = knots_along(data.along_m, length, self.config.knot_spacing_m)
        std = float(np.median(data.fix_std_m)) if len(data) else 1.0
        prior = Prior.of(max(std, 0.01), length / (count - 1), count, self.config.drift_length_m)
        return DriveOnMap(data, xy, track_xy, knot, share, prior, np.zeros((count, 2)))

    def _vote(self, drive: DriveOnMap) -> None:
        """Find the offsets of a drive against those on the map."""
        low, high = drive.box + self.config.vote_radius_m * np.array([[-1.0], [1.0]])
        others = [each for each in self.drives.values() if (each.box[1] >= low).all() and (each.box[0] <= high).all()]
        near = [((each.xy >= low) & (each.xy <= high)).all(axis=1) for each in others]
        xy = np.concatenate([np.zeros((0, 2)), *(each.xy[rows] for each, rows in zip(others, near, strict=True))])
        of = np.repeat(np.arange(len(others)), [int(rows.sum()) for rows in near])
        offset, pairs = vote(drive.xy, xy, of, len(others), self.config)
        for each, said, count in zip(others, offset.tolist(), pairs.tolist(), strict=True):
            if count > 0:
                a, b = sorted((drive.data.name, each.data.name))
                sign = 1.0 if a == drive.data.name else -1.0
                self.votes[a, b] = sign * said[0], sign * said[1], count

    def _group(self, touched: IntArray) -> None:
        """Assign sightings to places anew where something changed, then adjust."""
        names = sorted(self.drives)
        if not names:
            self.uid_of = {}
            return
        drives = self.in_order
        shifts = np.round(offsets_of(names, self.votes) / ROUNDING_M) * ROUNDING_M
        moves = [not np.array_equal(drive.shift, shift) for drive, shift in zip(drives, shifts, strict=True)]
        is_moved = np.repeat(moves, [len(drive.xy) for drive in drives])
        for drive, shift in zip(drives, shifts, strict=True):
            drive.shift = shift
        xy = np.concatenate([d.xy - d.shift for d in drives])
        of = np.repeat(np.arange(len(drives)), [len(d.xy) for d in drives])
        place, hood = (np.concatenate([getattr(d, name) for d in drives]) for name in ("place", "neighbourhood"))
        rows = self._affected(xy, hood, is_moved, touched)
        old = set(distinct(place[rows]).tolist()) | (set(self.uid_of) - set(distinct(place).tolist()))
        new_hood = linked(xy[rows])
        place[rows] = self.next_number + group(xy[rows], of[rows], new_hood, self.config)
        hood[rows] = self.next_number + new_hood
        self.next_number += len(rows)
        ends = np.cumsum([len(drive.xy) for drive in drives])[:-1]
        for drive, places, hoods in zip(drives, np.split(place, ends), np.split(hood, ends), strict=True):
            drive.place, drive.neighbourhood = places, hoods
        changed = distinct(place[rows])
        self._adjust(drives, set(distinct(of[is_moved | np.isin(place, changed)]).tolist()))
        self._name(drives, old, changed)

    @staticmethod
    def _affected(xy: FloatArray, hood: IntArray, is_moved: BoolArray, touched: IntArray) -> IntArray:
        """Return the sightings whose neighbourhoods may have changed."""
        moved, rest = np.flatnonzero(is_moved), np.flatnonzero(~is_moved)
        beside = np.zeros(0, dtype=np.int64)
        if len(moved) and len(rest):
            reach = LINK_M + 2 * CELL_M
            low, high = xy[moved].min(axis=0) - reach, xy[moved].max(axis=0) + reach
            rest = rest[((xy[rest] >= low) & (xy[rest] <= high)).all(axis=1)]
            distance, _ = tree_of(xy[moved]).query(xy[rest], distance_upper_bound=reach)
            beside = rest[np.isfinite(distance)]
        hoods = distinct(np.concatenate([touched, hood[moved], hood[beside]]))
        return np.flatnonzero(is_moved | np.isin(hood, hoods[hoods >= 0]))

    def _adjust(self, drives: Sequence[DriveOnMap], changed: set[int]) -> None:
        """Solve for the knots of drives with changed places, and of as many others as would move with them."""
        free = changed
        of = np.repeat(np.arange(len(drives)), [len(drive.place) for drive in drives])
        place = np.unique(np.concatenate([drive.place for drive in drives]), return_inverse=True)[1].reshape(-1)
        while free:
            is_free = np.zeros(len(drives), dtype=np.bool_)
            is_free[list(free)] = True
            is_seen = np.bincount(place, is_free[of]) > 0
            used = np.flatnonzero(is_free | (np.bincount(of, is_seen[place], len(drives)) > 0)).tolist()
            some = [drives[number] for number in used]
            sightings, _ = system_of(some, self.config)
            prior, start = Prior.joined([d.prior for d in some]), np.concatenate([d.knots for d in some])
            may_move = np.concatenate([np.full(len(drives[n].knots), n in free) for n in used])
            knots, pull = adjust(sightings, prior, start, may_move)
            first = 0
            wants = set()
            for number, drive in zip(used, some, strict=True):
                end = first + len(drive.knots)
                drive.knots = knots[first:end]
                if number not in free and np.abs(pull[first:end]).max(initial=0.0) > _STILL_M:
                    wants.add(number)
                first = end
            if not wants:
                return
            free = free | wants

    def _name(self, drives: Sequence[DriveOnMap], old: set[int], changed: IntArray) -> None:
        """Give new places the names of those that were there, or new ones."""
        for gone in old:
            self.uid_of.pop(gone, None)
        if not len(changed):
            return
        sightings, numbers = system_of(drives, self.config)
        rows = np.searchsorted(numbers, changed)
        xy = sightings.positions(np.concatenate([d.knots for d in drives]))[rows]
        taken = set(self.uid_of.values())
        free = [uid for uid in self.register if uid not in taken]
        if free:
            tree = tree_of(np.array([self.register[uid] for uid in free]))
            near = tree.sparse_distance_matrix(tree_of(xy), _SAME_PLACE_M, output_type="ndarray")
            used: set[int] = set()
            for k in np.lexsort((near["i"], near["j"], near["v"])).tolist():
                was, now = int(near["i"][k]), int(changed[near["j"][k]])
                if was not in used and now not in self.uid_of:
                    used.add(was)
                    self.uid_of[now] = free[was]
        _, firsts = np.unique(sightings.place, return_index=True)
        owner = np.repeat(np.arange(len(drives)), [len(d.xy) for d in drives])[firsts[rows]].tolist()
        own = np.concatenate([d.data.number for d in drives])[firsts[rows]].tolist()
        for row, (each, (x, y)) in enumerate(zip(changed.tolist(), xy.tolist(), strict=True)):
            seed = f"{drives[owner[row]].data.name}/{own[row]}"
            names = ("p" + hashlib.sha256(f"{seed}/{i}".encode()).hexdigest()[:12] for i in itertools.count())
            uid = self.uid_of.get(each) or next(name for name in names if name not in self.register)  # that none had
            self.uid_of[each] = uid
            self.register[uid] = x, y


def merge(results: Iterable[DriveResult | Pass], config: CityConfig | None = None) -> CityMap:
    """Put many drives together to one map.

    Parameters
    ----------
    results
        Of `interloc.detect` or `interloc.read_results`, georeferenced, of drives with different names.
    config
        Settings.

    Raises
    ------
    ConfigError
        Two drives have the same name.
    GeoreferenceError
        A drive has no georeference, or lies elsewhere on Earth than the first.
    """
    city = CityMap(config)
    city.add(*results)
    return city


def _as_pass(result: DriveResult | Pass) -> Pass:
    return result if isinstance(result, Pass) else Pass.of(result)
