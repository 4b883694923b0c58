"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import click

from interloc.cli import console
from interloc.osm.policies import POLICIES, POLICY_HELP, TOLERANCE_HELP

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from interloc.arrays import FloatArray
    from interloc.config import DetectorConfig
    from interloc.drive import Drive
    from interloc.drives.folder import FolderDrive
    from interloc.errors import GeoreferenceError
    from interloc.osm.graph import RoadGraph
    from interloc.results import DriveResult

Function = TypeVar("Function", bound=Callable[..., Any])


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
OUT = click.option("-o", "--out", required=True, type=PATH, help="Result folder to write.")
QUIET = click.option(
    "--quiet",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=console.set_quiet,
    help="Print warnings and errors only.",
)
JSON = click.option(
    "--json",
    "as_json",
    is_flag=True,
    expose_value=False,
    callback=console.set_json,
    help="Print the outcome as JSON.",
)
POLICY = click.option(
    "--policy",
    default="drive",
    show_default=True,
    type=click.Choice(list(POLICIES)),
    help=POLICY_HELP,
)
TOLERANCE = click.option("--tolerance", "tolerance_m", default=15.0, show_default=True, help=TOLERANCE_HELP)
OSM = click.option("--osm", type=PATH, help="OSM file: .osm, .osm.gz, .osm.bz2 or .osm.pbf.")
SENSORS = ("vlp-16", "os1-32", "os1-64", "hdl-64e")
"""Names of `interloc.lab.config.SENSORS`, which is slow to import."""

OVERPASS = click.option("--overpass", is_flag=True, help="Fetch the map from a public Overpass server instead.")


def together(*decorators: Callable[[Any], Any]) -> Callable[[Function], Function]:
    """Return a decorator that adds several options, in this order."""

    def decorate(function: Function) -> Function:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return decorate


class Command(click.Command):
    """A command some of whose options are made from `DriveOptions` as soon as they are needed: it imports slowly."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the parameters, each placeholder replaced by the options that it stands for."""
        params = super().get_params(ctx)
        return [each for param in params for each in (param.made() if isinstance(param, _OfModel) else [param])]

    def invoke(self, ctx: click.Context) -> Any:
        """Say on a terminal what is being read: that, and the modules for it, may take some seconds."""
        if ctx.params.get("drive") and not console.is_quiet():
            console.say_on_terminal(f"reading {ctx.params['drive']}")
        return super().invoke(ctx)


class _OfModel(click.Option):
    """Stands for the options of some fields of `DriveOptions`."""

    def __init__(self, *args: Any, fields: tuple[str, ...]) -> None:
        super().__init__(*args)
        self._fields = fields

    def made(self) -> list[click.Option]:
        from interloc.drives.options import DriveOptions

        return [_option_of(name, DriveOptions.model_fields[name]) for name in self._fields]


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
    return click.Option(
        [f"--{name.replace('_', '-')}"],
        type=kind,
        default=field.default,
        show_default=field.default is not None,
        help=text,
    )


def _of_model(*fields: str) -> Callable[[Function], Function]:
    return click.option(f"--{fields[0]}", cls=_OfModel, fields=fields)


reading_options = _of_model(
    "label_scheme", "pose_frame", "layout", "oxts", "poses", "points", "fix", "crs", "frames", "deskew"
)
"""How a drive is to be read, whatever its labels."""

odometry_options = _of_model("layout", "points", "frames", "deskew")
"""How the scans of a drive are to be read where only they count."""

model_options = _of_model("model", "provider")
"""Labels by a network instead of label files."""

drive_options = together(_of_model("labels"), reading_options, model_options)

label_folders_option = click.option(
    "--labels",
    "label_folders",
    multiple=True,
    type=click.Choice(["labels", "predictions", "geometry"]),
    show_default="all of which there are files",
    help="Which labels: the files of labels/ or predictions/, or geometry, which finds the road by the points and the "
    "path driven. May be given several times.",
)

map_options = together(OSM, OVERPASS, POLICY, TOLERANCE)

locate_option = click.option(
    "--locate",
    is_flag=True,
    help="Place the drive on the map by its roads; a georeference is not used. --near does that where there is none.",
)

near_options = together(
    click.option("--near", type=_LatLon(), metavar="LAT,LON", help="Search only around here; with --radius."),
    click.option(
        "--radius", "radius_km", type=click.FloatRange(min=0.1), help="How far around --near, km.  [default: 3]"
    ),
)
"""Where to search."""

config_options = together(
    click.option(
        "--preset",
        type=click.Choice(["default", "paper"]),
        default="default",
        show_default=True,
        help="Preset to start from.",
    ),
    click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="NAME=VALUE",
        help="Change a setting, for example bev.resolution_m=0.25; may be repeated.",
    ),
)


workers_option = click.option(
    "--workers",
    type=click.IntRange(1, 256),
    show_default="as many as pay off",
    help="Number of processes; the result does not depend on it.",
)

evaluation_options = together(DRIVE, OUT, map_options, config_options, drive_options, workers_option, QUIET, JSON)
"""Options of the commands that detect the intersections of a drive and evaluate them."""

server_options = together(
    click.option(
        "--server",
        envvar="INTERLOC_SERVER",
        default="http://127.0.0.1:8000",
        show_default=True,
        metavar="URL",
        help="Address of the service; also read from INTERLOC_SERVER.",
    ),
    click.option(
        "--token",
        envvar="INTERLOC_TOKEN",
        help="API token; INTERLOC_TOKEN is safer, since others on this machine can see the options of a command.",
    ),
)


def open_drive(drive: Path, options: dict[str, Any]) -> FolderDrive:
    """Open a drive by the values of `drive_options`."""
    from interloc.drives.open import open_drive as open_it

    return open_it(drive, **options)


def configure(preset: str, settings: tuple[str, ...]) -> DetectorConfig:
    """Return the configuration by the values of `config_options`."""
    from interloc.config import preset as preset_of

    return preset_of(preset, *settings)


def open_for_evaluation(
    drive: Path,
    *,
    osm: Path | None,
    overpass: bool,
    preset: str,
    settings: tuple[str, ...],
    needs_georeference: bool = True,
    needs_map: bool = True,
    **reading: Any,
) -> tuple[FolderDrive, DetectorConfig, RoadGraph | None]:
    """Check and open all that `evaluation_options` name, before any long work starts.

    The drive has a georeference where it needs one; the map is None if it will come from Overpass.
    """
    if needs_map:
        check_map_choice(osm, overpass=overpass)
    config = configure(preset, settings)
    source = open_drive(drive, reading)
    if not needs_georeference:  # where on the map it was is not known yet
        return source, config, read_map(osm)
    if source.georeference is None:  # before any long work starts
        raise no_georeference(
            source.name,
            "place it by its roads (`interloc run --locate`), or leave the map out: intersections are found without.",
        )
    return source, config, read_map(osm, _keyframe_places(source, config))


def _keyframe_places(drive: Drive, config: DetectorConfig) -> FloatArray:
    """Return longitude, latitude of the keyframes, as they will be in the result."""
    import numpy as np

    from interloc.detection.keyframes import select_keyframes

    assert drive.georeference is not None
    rows = select_keyframes(drive.T_world_lidar, config.keyframes)
    fixes = drive.georeference
    return np.stack([fixes.lon_deg[rows], fixes.lat_deg[rows]], axis=-1)


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


def check_map_choice(osm: Path | None, *, overpass: bool) -> None:
    """Raise a usage error unless exactly one source of the map is given."""
    if (osm is None) == (not overpass):
        raise click.UsageError("give the map by one of --osm FILE and --overpass")


def no_georeference(drive: str, otherwise: str) -> GeoreferenceError:
    """Return the error of a drive that cannot be evaluated, with what else can be done."""
    from interloc.errors import GeoreferenceError

    return GeoreferenceError(
        f"{drive}: the drive has no georeference, so its detections cannot be compared with OpenStreetMap. "
        "Give one with --oxts (a KITTI raw drive, a file of OXTS rows, a geo.csv), put oxts/data or geo.csv into "
        f"the drive, {otherwise}"
    )


def read_map(osm: Path | None, lonlat: FloatArray | None = None) -> RoadGraph | None:
    """Read the map given as a file, before any long work starts; None when it will come from Overpass.

    Only what lies around the keyframes, (K, 2) degrees, is read.
    """
    if osm is None:
        return None
    from interloc.evaluation.coverage import map_bounds
    from interloc.osm.reader import read_osm

    return read_osm(osm, None if lonlat is None or not len(lonlat) else map_bounds(lonlat))


def fetch_map(result: DriveResult) -> RoadGraph:
    """Fetch the map around a run from Overpass."""
    assert result.keyframes.lonlat is not None
    return fetch_roads(result.keyframes.lonlat)


def fetch_roads(lonlat: FloatArray, *, margin_m: float = 200.0) -> RoadGraph:
    """Fetch the map around (N, 2) places from Overpass."""
    from interloc.evaluation.coverage import track_bounds
    from interloc.osm.overpass import download_roads

    def wait(reason: str, seconds: float) -> None:
        console.note(f"{reason} ({seconds:.0f} s)")

    return download_roads(track_bounds(lonlat, margin_m=margin_m), on_wait=wait)


def search_area(
    near: tuple[float, float] | None, radius_km: float | None
) -> tuple[tuple[float, float] | None, float | None]:
    """Return `near` and `radius_m` of `locate` by the values of `near_options`."""
    if near is not None:
        return near, 1000.0 * (3.0 if radius_km is None else radius_km)
    if radius_km is not None:
        raise click.UsageError("--radius says how far around --near to search; give --near too")
    return None, None


def fetch_map_around(near: tuple[float, float] | None, radius_m: float | None) -> RoadGraph:
    """Fetch the map to search from Overpass."""
    import numpy as np

    if near is None or radius_m is None:
        raise click.UsageError("the map of which place is to be fetched? Say it by --near LAT,LON, or give --osm FILE")
    return fetch_roads(np.array([near[::-1]]), margin_m=radius_m)
