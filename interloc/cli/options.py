"""Options that several commands share."""

from __future__ import annotations

import ctypes
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import click

from interloc.cli import console
from interloc.errors import GeoreferenceError
from interloc.osm.policies import POLICIES, POLICY_HELP, TOLERANCE_HELP

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from interloc.arrays import FloatArray
    from interloc.config import DetectorConfig
    from interloc.drives.options import DriveOptions
    from interloc.osm.graph import RoadGraph
    from interloc.osm.policies import Policy
    from interloc.results import DriveResult

Function = TypeVar("Function", bound=Callable[..., Any])
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h


class Place(click.Path):
    """A path; or an address in object storage: then what lies there is fetched, or -o sent there at the end."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path, or that of the folder that stands for an address."""
        if not isinstance(value, str) or "://" not in value:
            return super().convert(value, param, ctx)
        from interloc import storage

        if param is not None and param.name == "out":
            place = storage.result_place(value)
            return storage.fetch_older(place) if isinstance(param, click.Argument) else place
        from interloc.reduction.listing import fetch_drive

        with console.progress("fetch", "B") as bar:
            return fetch_drive(value, progress=bar)


PATH = Place(path_type=Path)
DRIVE = click.argument("drive", type=PATH)
_QUIET = click.option(
    "--quiet",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=console.set_quiet,
    help="Print warnings and errors only.",
)
JSON = click.option(
    "--json", "as_json", is_flag=True, expose_value=False, callback=console.set_json, help="Print the outcome as JSON."
)
OSM = click.option("--osm", type=PATH, help="OSM file: .osm, .osm.gz, .osm.bz2 or .osm.pbf.")
_OVERPASS = click.option("--overpass", is_flag=True, help="Fetch the map from a public Overpass server instead.")
_POLICY = click.option("--policy", default="drive", type=click.Choice(list(POLICIES)), help=POLICY_HELP)
_METRES = click.FloatRange(min=0.0, min_open=True, max=100.0)
_TOLERANCE = click.option("--tolerance", "tolerance_m", default=15.0, type=_METRES, help=TOLERANCE_HELP)


def together(*decorators: Callable[[Any], Any]) -> Callable[[Function], Function]:
    """Return a decorator that adds several options, in this order."""

    def decorate(function: Function) -> Function:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return decorate


class Group:
    """Options that belong together: a heading of --help, and one parameter of the commands that have them.

    `make` gets the values of the options by their names and returns that of the parameter. Without a name the values
    are parameters themselves.
    """

    def __init__(
        self, title: str, *options: Callable[[Any], Any], name: str = "", make: Callable[..., Any] = dict
    ) -> None:
        self.title, self._options, self.name, self.make = title, options, name, make

    def __call__(self, function: Function) -> Function:
        """Add the options to a command, and mark them as those of this group."""
        before = getattr(function, "__click_params__", [])[:]
        function = together(*self._options)(function)
        for param in getattr(function, "__click_params__", [])[len(before) :]:
            param.group = self
        return function


class Command(click.Command):
    """A command with groups of options, some of which are made from `DriveOptions` once needed: it imports slowly."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the parameters, each placeholder replaced by the options that it stands for."""
        params = super().get_params(ctx)
        return [each for param in params for each in (param.made() if isinstance(param, _OfModel) else [param])]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Refuse an option that comes again where one value is taken: click would take the last without a word."""
        given = Counter(each for each in self.make_parser(ctx).parse_args([*args])[2] if isinstance(each, click.Option))
        for option, count in given.items():
            if count > 1 and not (option.multiple or option.is_flag):
                raise click.UsageError(f"{option.opts[-1]} is given {count} times; it takes one value.", ctx)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Make one parameter of each group; say on a terminal what is being read, which may take some seconds."""
        if ctx.params.get("drive"):
            with suppress(OSError, AttributeError, TypeError):  # glibc: what is freed is kept for the next arrays
                for threshold, size_mb in ((_M_MMAP_THRESHOLD, 32), (_M_TRIM_THRESHOLD, 64)):
                    ctypes.CDLL(None).mallopt(threshold, size_mb * 1024**2)
            if sys.stderr.isatty():
                console.note(f"reading {ctx.params['drive']}")
        values: dict[Group, dict[str, Any]] = {}
        for param in self.get_params(ctx):
            group = getattr(param, "group", None)
            if group is not None and group.name and param.expose_value:
                values.setdefault(group, {})[str(param.name)] = ctx.params.pop(str(param.name))
        made = {group.name: group.make(**found) for group, found in values.items()}
        return ctx.invoke(self.callback, **ctx.params, **made) if self.callback else None

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options under the headings of their groups."""
        parts: dict[str, list[tuple[str, str]]] = {"Options": []}
        for param in self.get_params(ctx):
            if (record := param.get_help_record(ctx)) is not None:
                group = getattr(param, "group", None)
                parts.setdefault("Options" if group is None else f"{group.title} options", []).append(record)
        for title, records in parts.items():
            with formatter.section(title):
                formatter.write_dl(records)


class _OfModel(click.Option):
    """Stands for the options of some fields of `DriveOptions`."""

    group: Group | None = None

    def __init__(self, *args: Any, fields: tuple[str, ...]) -> None:
        super().__init__(*args)
        self._fields = fields

    def made(self) -> list[click.Option]:
        from interloc.drives.options import DriveOptions

        options = [_option_of(name, DriveOptions.model_fields[name]) for name in self._fields]
        for option in options:
            option.group = self.group  # type: ignore[attr-defined]
        return options


class _LatLon(click.ParamType):  # type: ignore[type-arg, unused-ignore] # generic in the newest click only
    """Latitude and longitude with a comma between them: 49.01,8.43."""

    name = "LAT,LON"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        if isinstance(value, tuple):
            return value
        try:
            lat, lon = map(float, str(value).split(","))
        except ValueError:
            self.fail(f"{value!r} is not LAT,LON: 2 numbers with commas between them.", param, ctx)
        if not (abs(lat) <= 90.0 and abs(lon) <= 180.0):
            self.fail(f"{value!r} is no place on earth: degrees of latitude, then of longitude.", param, ctx)
        return lat, lon


class _Layout(click.Choice):  # type: ignore[type-arg]  # has none before click 8.2
    """The formats of scans; those of other packages are looked up only where one is named."""

    def __init__(self) -> None:
        from interloc.drives.formats import FORMATS

        super().__init__(["auto", *(each.name for each in FORMATS)])

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from interloc.drives.formats import find_format

        known = find_format(value)
        return super().convert(value, param, ctx) if known is None else known.name


def _option_of(name: str, field: FieldInfo) -> click.Option:
    choices = get_args(field.annotation)
    kind: click.ParamType[Any] = PATH if Path in choices else click.STRING
    if name == "layout":
        kind = _Layout()
    elif choices and all(isinstance(each, str) for each in choices):
        kind = click.Choice(list(choices))
    text = field.description or ""
    if str in choices and field.examples:
        text = f"{text.removesuffix('.')}, such as {field.examples[0]}."
    return click.Option([f"--{name.replace('_', '-')}"], type=kind, default=field.default, help=text)


def _of_model(*fields: str) -> Callable[[Function], Function]:
    return click.option(f"--{fields[0]}", cls=_OfModel, fields=fields)


_METHOD = (
    click.option("--preset", type=click.Choice(["default", "paper"]), default="default", help="Preset to start from."),
    click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="NAME=VALUE",
        help="Change a setting, for example bev.resolution_m=0.25; may be repeated.",
    ),
)
_LOOKAHEAD = click.option(
    "--lookahead",
    type=click.IntRange(0, 500),
    help="Keyframes that an answer waits for; the same as --set keyframes.lookahead=N. 0 answers at once, and finds "
    "fewer intersections ahead of the vehicle.",
)
_WORKERS = click.option(
    "--workers",
    type=click.IntRange(1, 256),
    show_default="as many as pay off",
    help="Number of processes; the result does not depend on it.",
)
_READING = _of_model(
    "label_scheme", "pose_frame", "layout", "oxts", "poses", "points", "fix", "crs", "frames", "deskew"
)
_LOCATE = click.option(
    "--locate",
    is_flag=True,
    help="Place the drive on the map by its roads; a georeference is not used. --near does that where there is none.",
)
_NEAR = (
    click.option("--near", type=_LatLon(), metavar="LAT,LON", help="Search only around here; with --radius."),
    click.option(
        "--radius",
        "radius_km",
        type=click.FloatRange(min=0.1),
        help="How far around --near, km; at most 20 on a server.  [default: 3]",
    ),
)


def configure(preset: str, settings: tuple[str, ...], lookahead: int | None = None) -> DetectorConfig:
    """Return the configuration of the method."""
    from interloc.config import preset as preset_of

    return preset_of(preset, *settings, *([] if lookahead is None else [f"keyframes.lookahead={lookahead}"]))


def _drive_options(**given: Any) -> DriveOptions:
    from interloc.drives.options import DriveOptions

    return DriveOptions.of(**given)


@dataclass(frozen=True)
class Truth:
    """The map to score against."""

    osm: Path | None
    overpass: bool
    policy: Policy
    tolerance_m: float

    @property
    def is_given(self) -> bool:
        """Whether there is a map."""
        return self.osm is not None or self.overpass

    def check(self) -> None:
        """Raise a usage error unless exactly one source of the map is given."""
        if (self.osm is None) == (not self.overpass):
            raise click.UsageError("give the map by one of --osm FILE and --overpass")


@dataclass(frozen=True)
class Placing:
    """Whether a drive is to be placed on the map by its roads, and where to search."""

    near: tuple[float, float] | None
    radius_km: float | None
    locate: bool = False

    def __post_init__(self) -> None:
        if self.near is None and self.radius_km is not None:
            raise click.UsageError("--radius says how far around --near to search; give --near too")

    @property
    def radius_m(self) -> float | None:
        """How far around `near`."""
        return None if self.near is None else 1000.0 * (3.0 if self.radius_km is None else self.radius_km)

    def read_map(self, osm: Path | None) -> RoadGraph:
        """Return the map to search, from a file or else Overpass: what lies around `near`, or all of the file."""
        import numpy as np

        from interloc.evaluation.coverage import track_bounds
        from interloc.osm.reader import read_osm

        if self.near is None or self.radius_m is None:
            if osm is None:
                raise click.UsageError(UNKNOWN_PLACE)
            return read_osm(osm)
        place = np.array([self.near[::-1]])
        if osm is None:
            return fetch_roads(place, margin_m=self.radius_m)
        return read_osm(osm, track_bounds(place, margin_m=self.radius_m))


UNKNOWN_PLACE = "the map of which place is to be fetched? Say it by --near LAT,LON, or give --osm FILE"

READING = Group("Input", _READING)
"""How a drive is to be read, whatever its labels."""

NETWORK = Group("Input", _of_model("model", "provider"))
"""Labels by a network instead of label files."""

ODOMETRY = Group("Input", _of_model("layout", "points", "frames", "deskew"))
"""How the scans of a drive are to be read where only they count."""

LABEL_FOLDERS = Group(
    "Input",
    click.option(
        "--labels",
        "label_folders",
        multiple=True,
        type=click.Choice(["labels", "predictions", "geometry"]),
        show_default="all of which there are files",
        help="Which labels: the files of labels/ or predictions/, or geometry, which finds the road by the points and "
        "the path driven. May be given several times.",
    ),
)
_INPUT = (_of_model("labels"), _READING, _of_model("model", "provider"))
INPUT = Group("Input", *_INPUT, name="reading", make=_drive_options)
METHOD = Group("Method", *_METHOD, name="config", make=configure)
ONLINE_METHOD = Group("Method", *_METHOD, _LOOKAHEAD, name="config", make=configure)
WORKERS = Group("Method", _WORKERS)
TRUTH = Group("Map", OSM, _OVERPASS, _POLICY, _TOLERANCE, name="truth", make=Truth)
POLICY = Group("Map", _POLICY)
SCORING = Group("Map", _POLICY, _TOLERANCE)
NEAR = Group("Map", *_NEAR, name="placing", make=Placing)
PLACING = Group("Map", _LOCATE, *_NEAR, name="placing", make=Placing)
OUT = Group("Output", click.option("-o", "--out", required=True, type=PATH, help="Result folder to write."))
OUTPUT = Group("Output", _QUIET, JSON)
QUIET = Group("Output", _QUIET)
RUN = (
    *(Group("Input", *_INPUT), Group("Method", *_METHOD)),
    Group("Map", OSM, _OVERPASS, _POLICY, _TOLERANCE, _LOCATE, *_NEAR),
)
"""The options of `interloc run` as `interloc batch` hands them on: values, not groups."""

TOKEN = click.option(
    "--token",
    envvar="INTERLOC_TOKEN",
    help="API token; INTERLOC_TOKEN is safer, since others on this machine can see the options of a command.",
)


def no_map(result: DriveResult) -> str:
    """Return what a run without a map says of it."""
    from interloc.evaluation.coverage import track_bounds

    if result.keyframes.lonlat is None or not len(result.keyframes):
        return "no map was given (--osm FILE or --overpass)"
    west, south, east, north = track_bounds(result.keyframes.lonlat)
    return (
        "no map was given: `interloc evaluate OUT` takes --osm FILE, any extract that covers the drive, such as its "
        "region by Geofabrik, or --overpass; around this drive: "
        f"--bbox {west:.4f},{south:.4f},{east:.4f},{north:.4f} of `osmium extract`"
    )


def no_georeference(drive: str, otherwise: str) -> GeoreferenceError:
    """Return the error of a drive that cannot be evaluated, with what else can be done."""
    return GeoreferenceError(
        f"{drive}: the drive has no georeference, so its detections cannot be compared with OpenStreetMap. "
        "Give one with --oxts (a KITTI raw drive, a file of OXTS rows, a geo.csv), put oxts/data or geo.csv into "
        f"the drive, {otherwise}"
    )


def read_map(osm: Path | None, lonlat: FloatArray | None) -> RoadGraph | None:
    """Read the map given as a file, before any long work starts; None when it will come from Overpass.

    Only what lies around the keyframes, (K, 2) degrees, is read.
    """
    if osm is None:
        return None
    from interloc.evaluation.coverage import map_bounds
    from interloc.osm.reader import read_osm

    return read_osm(osm, None if lonlat is None or not len(lonlat) else map_bounds(lonlat))


def fetch_roads(lonlat: FloatArray, *, margin_m: float = 200.0) -> RoadGraph:
    """Fetch the map around (N, 2) places from Overpass."""
    from interloc.evaluation.coverage import track_bounds
    from interloc.osm.overpass import download_roads

    def wait(reason: str, seconds: float) -> None:
        console.note(f"{reason} ({seconds:.0f} s)")

    return download_roads(track_bounds(lonlat, margin_m=margin_m), on_wait=wait)
