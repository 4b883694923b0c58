"""`interloc simulate` and `benchmark`."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, options
from interloc.errors import InterLocError, is_interruption, require_lab
from interloc.files import atomic_write, write_file
from interloc.processes import cores

if TYPE_CHECKING:
    from interloc.config import DetectorConfig
    from interloc.drives.options import DriveOptions, LabelFolder
    from interloc.lab.cases import Case
    from interloc.lab.config import SimulationOptions
    from interloc.lab.measure import Row
    from interloc.lab.places import Part
    from interloc.lab.run import Benchmark
    from interloc.lab.town import Part as TownPart
    from interloc.osm.policies import Policy


SEQUENCES = "00,02,05,06,07,08,09,10"
SENSORS = ("vlp-16", "os1-32", "os1-64", "hdl-64e")
"""Names of `interloc.lab.config.SENSORS`, which is slow to import."""


def _listed(_: click.Context, __: click.Parameter, given: str | tuple[str, ...] | None) -> tuple[str, ...]:
    """Flatten an option that holds several values with commas, and may be repeated."""
    texts = (given,) if isinstance(given, str) else given or ()
    if not all(text.strip(", ") for text in texts):
        raise click.BadParameter("it is empty. Usual cause: a variable of the shell that is not set.")
    return tuple(dict.fromkeys(part.strip() for text in texts for part in text.split(",") if part.strip()))


measuring_options = options.together(
    options.OUT,
    click.option(
        "--preset",
        "presets",
        multiple=True,
        callback=_listed,
        default=["default,paper"],
        show_default="both",
        help="Presets to measure side by side; repeat the option, or join them with commas.",
    ),
    click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="NAME=VALUE",
        help="Change a setting of every preset; may be repeated.",
    ),
    click.option(
        "--noise",
        "noises",
        multiple=True,
        callback=_listed,
        metavar="FPR/FNR",
        help="Label errors to add, r-FPR/r-FNR in percent, such as 20/20; repeat the option, or join them with commas. "
        "The drive without label errors (0/0) is always measured.",
    ),
    click.option(
        "--seeds",
        type=click.IntRange(1, 100),
        default=2,
        help="Number of seeds to measure; the tables give mean and spread. In simulated drives with odd "
        "seeds service roads are labelled as road.",
    ),
    options.SCORING,
    options.WORKERS,
    options.OUTPUT,
)
"""Options that all benchmarks share."""


def twin_options(sequences: str | None) -> Callable[[options.Function], options.Function]:
    """Return the options of benchmarks on simulated drives along tracks of KITTI; `sequences` is the default."""
    return options.together(
        click.option(
            "--kitti",
            required=True,
            type=options.PATH,
            help="Folder with oxts/NN.txt.gz, poses_suma/NN.txt, calib/NN.txt, times/NN.txt, "
            "osm/NN.osm.gz and, for real houses, osm_buildings/NN.osm.gz.",
        ),
        click.option(
            "--sequences",
            callback=_listed,
            default=sequences,
            show_default=sequences or "those of the part",
            help="KITTI odometry sequences to measure.",
        ),
        click.option(
            "--keep", type=options.PATH, help="Folder in which the simulated drives are kept for the next time."
        ),
        click.option(
            "--max-scans", type=click.IntRange(min=1), help="Number of keyframes of each sequence, for a quick look."
        ),
    )


@click.group(short_help="Measure presets on many drives: the tables of the paper.")
def benchmark() -> None:
    """Repeat the paper's experiments: its Tables II, III and IV beside the published figures.

    \b
    Examples:
      interloc benchmark twins --kitti kitti -o out                    simulated drives over the real tracks and maps
      interloc benchmark twins --kitti kitti --sequences 07 --preset default --noise 20/20 --seeds 3 -o out
      interloc benchmark semantickitti --root data --oxts raw --osm maps --labels predictions -o out
      interloc benchmark drives first second --osm map.osm.gz -o out   any drives
      interloc benchmark ablation --kitti kitti -o out                 what each rule and setting of a preset gives
      interloc benchmark places                                        drawn places, kind by kind; needs no data

    OUT/benchmark.txt has the tables, OUT/benchmark.json figures; ablation writes OUT/ablation.txt only, places prints
    its table. A run that was stopped continues where it was: finished rows are kept in OUT/rows as long as inputs,
    settings and version are the same. What went wrong in a drive, and why, is told by `interloc run DRIVE --osm MAP`.
    """
    require_lab()


@benchmark.command(cls=options.Command)
@twin_options(SEQUENCES)
@measuring_options
def twins(
    kitti: Path, sequences: tuple[str, ...], keep: Path | None, max_scans: int | None, seeds: int, **measuring: Any
) -> None:
    """Simulate drives along the real tracks of KITTI sequences over their real maps, and measure them.

    The seed decides houses, cars, noise and label errors. Each drive is deleted once it is measured, unless --keep.
    The published figures beside the tables are of the real scans.

    \b
    Example:
      interloc benchmark twins --kitti kitti --sequences 00,05 --noise 20/20 -o out
    """
    from interloc.lab.cases import twin_cases

    cases = twin_cases(kitti, sequences, seeds=seeds, keep=keep, max_scans=max_scans)
    _measure(cases, title="KITTI twins", labels="labels", seeds=seeds, **measuring)


@benchmark.command(cls=options.Command)
@click.option(
    "--root",
    required=True,
    type=options.PATH,
    help="SemanticKITTI: the folder with sequences/NN or dataset/sequences/NN.",
)
@click.option(
    "--oxts",
    required=True,
    type=options.PATH,
    help="Folder with NN.txt[.gz] (one row per frame) or with KITTI raw drives (2011_10_03_drive_0027_sync, ...).",
)
@click.option("--osm", required=True, type=options.PATH, help="Folder with NN.osm, .osm.gz, .osm.bz2 or .osm.pbf.")
@click.option("--sequences", callback=_listed, default=SEQUENCES, help="Sequences to measure.")
@click.option(
    "--labels",
    type=click.Choice(["labels", "predictions"]),
    default="labels",
    help="Hand labels, or those of a network.",
)
@measuring_options
def semantickitti(
    root: Path, oxts: Path, osm: Path, sequences: tuple[str, ...], labels: LabelFolder, **measuring: Any
) -> None:
    """Measure the sequences of SemanticKITTI itself.

    The figures move with the state of the OSM files: the paper does not say which it used.

    \b
    Example:
      interloc benchmark semantickitti --root SemanticKITTI --oxts KITTI/raw --osm maps --labels predictions -o out
    """
    from interloc.lab.cases import semantickitti_cases

    cases = semantickitti_cases(root, oxts, osm, sequences, labels=labels)
    _measure(cases, title="SemanticKITTI", labels=labels, **measuring)


@benchmark.command(cls=options.Command)
@click.argument("drives", nargs=-1, required=True, type=options.PATH)
@click.option(
    "--osm",
    "maps",
    multiple=True,
    required=True,
    type=options.PATH,
    help="OSM file: one for all drives, or repeat the option: one per drive, in their order.",
)
@options.INPUT
@measuring_options
def drives(drives: tuple[Path, ...], maps: tuple[Path, ...], reading: DriveOptions, **given: Any) -> None:
    """Measure any DRIVES that have a georeference.

    \b
    Example:
      interloc benchmark drives monday tuesday --osm town.osm.gz -o out
    """
    from interloc.lab.cases import folder_cases

    if reading.oxts is not None and len(drives) > 1:
        raise click.UsageError("--oxts belongs to one drive; put oxts/data or geo.csv into each of several drives")
    cases = folder_cases(drives, maps, reading)
    _measure(
        cases,
        title=", ".join(case.name for case in cases) if len(cases) <= 4 else f"{len(cases)} drives",
        labels=reading.labels,
        **given,
    )


@benchmark.command(cls=options.Command)
@twin_options(None)
@click.option(
    "--part",
    type=click.Choice(["choosing", "reporting"]),
    default="choosing",
    help="Drives to measure: those to choose settings by, or those, at other places, to report afterwards.",
)
@click.option(
    "--recorded",
    type=options.PATH,
    help="Folder with recorded drives under the names real_NN, drawn_NN, kitti360_NN and town: they are scored against "
    "their map.osm, else the map of sequence NN. Those that are missing are left out.",
)
@click.option("--preset", default="default", help="Preset to take settings out of.")
@click.option(
    "--take-out", "names", multiple=True, callback=_listed, help="Settings to take out alone; all by default."
)
@options.OUT
@options.WORKERS
@options.OUTPUT
def ablation(
    kitti: Path,
    sequences: tuple[str, ...],
    part: str,
    recorded: Path | None,
    keep: Path | None,
    max_scans: int | None,
    preset: str,
    names: tuple[str, ...],
    out: Path,
    workers: int | None,
) -> None:
    """Take each rule and setting of a preset out alone, over drives, with intervals over places.

    Settings are chosen by the choosing drives, and reported on the reporting ones. Twins of odd seeds have service
    roads labelled as road.

    \b
    Example:
      interloc benchmark ablation --kitti kitti --recorded drives --take-out branches.square_std_deg,compound -o out
    """
    from interloc.lab.run import SETS, Benchmark, ablation_table, taken_out

    drives = SETS[part]
    if sequences:
        drives = replace(drives, sequences=sequences)
    configs = taken_out(options.configure(preset, ()), names)
    cases = drives.cases(kitti, recorded, keep=keep, max_scans=max_scans)
    rows = _run(Benchmark(tuple(cases), tuple(configs)), out, workers)
    table = ablation_table(rows, configs, part)
    write_file(out / "ablation.txt", f"{table.text()}\n")
    record = {"title": table.title, "rows": table.frame.reset_index().to_dict("records"), "notes": list(table.notes)}
    console.say(record, table.text())


@benchmark.command(cls=options.Command)
@click.option(
    "--part",
    type=click.Choice(["choosing", "reporting"]),
    default="choosing",
    help="Places to choose settings by, or others, to report afterwards.",
)
@click.option(
    "--kind", "kinds", multiple=True, metavar="KIND", help="Kind to measure; may be repeated; all by default."
)
@click.option(
    "--places",
    type=click.IntRange(1, 1000),
    default=6,
    help="Places of each kind. Six have all conditions once: clear, cars and houses, wrong labels, wavering borders, "
    "few keyframes, and all at once.",
)
@options.METHOD
@click.option("--rows", type=click.Path(dir_okay=False, path_type=Path), help="CSV file to write: a line per node.")
@options.OUTPUT
def places(part: Part, kinds: tuple[str, ...], places: int, config: DetectorConfig, rows: Path | None) -> None:
    """Measure drawn places, kind by kind: how far intersections are from where the axes of the roads meet.

    Each place is driven through along each pair of its arms. Takes some minutes on one processor.

    \b
    Example:
      interloc benchmark places --kind T --kind "slip road" --places 12
    """
    from interloc.lab.places import measure_places, table_of_kinds

    with nullcontext() if rows is None else atomic_write(rows) as file:  # before any long work
        with console.progress("measure", "place") as bar:
            found = measure_places(config, part, kinds=kinds, places=places, progress=bar)
        table = table_of_kinds(found)
        known = table.astype(object).where(table.notna(), None).rename_axis("kind").reset_index().to_dict("records")
        console.say({"part": part, "kinds": known}, table.to_string(float_format="{:.2f}".format, na_rep="-"))
        if file is not None:
            file.write(found.to_csv(index=False, float_format="%.4f").encode())


def _measure(
    cases: Sequence[Case],
    *,
    out: Path,
    presets: tuple[str, ...],
    settings: tuple[str, ...],
    noises: tuple[str, ...],
    seeds: int,
    policy: Policy,
    tolerance_m: float,
    workers: int | None,
    **described: Any,
) -> None:
    """Run a benchmark by the values of `measuring_options`; `described` are further fields of `Benchmark`."""
    from interloc.lab.measure import Scoring, parse_level
    from interloc.lab.run import Benchmark, NamedConfig, write_benchmark
    from interloc.lab.tables import NO_NOISE

    levels = [f"{100 * r_fpr:g}/{100 * r_fnr:g}" for r_fpr, r_fnr in map(parse_level, noises)]
    benchmark = Benchmark(
        tuple(cases),
        tuple(NamedConfig(" ".join([name, *settings]), options.configure(name, settings)) for name in presets),
        tuple(dict.fromkeys([NO_NOISE, *levels])),
        seeds,
        Scoring(policy, tolerance_m),
        **described,
    )
    text, record = write_benchmark(benchmark, _run(benchmark, out, workers), out)
    console.say(record, text)


def _run(benchmark: Benchmark, out: Path, workers: int | None) -> list[Row]:
    """Measure, with a progress bar over the rows."""
    from interloc.lab.run import run_benchmark

    try:
        with console.progress("measure", "row") as bar:
            return run_benchmark(benchmark, out, workers=workers or cores(), progress=bar)
    except (KeyboardInterrupt, SystemError) as error:
        if not is_interruption(error):
            raise
        raise InterLocError(
            f"interrupted; finished rows are kept in {out / 'rows'}, and the same command goes on from there"
        ) from None


def _simulation(
    *, every_scan: bool, seed: int, ground_only: bool, max_scans: int | None, sensor: str, columns: int | None
) -> SimulationOptions:
    from interloc.lab.config import SENSORS, SimulationOptions

    lidar = SENSORS[sensor]
    return SimulationOptions(
        seed=seed,
        keyframes_only=not every_scan,
        ground_only=ground_only,
        max_scans=max_scans,
        sensor=lidar if columns is None else replace(lidar, columns=columns),
    )


_OUT = click.option(
    "-o",
    "--out",
    required=True,
    metavar="DRIVE",
    type=options.PATH,
    help="Folder of the drive to write; an older simulated drive there is replaced.",
)
_SIMULATION = options.Group(
    "Simulation",
    click.option(
        "--every-scan",
        is_flag=True,
        help="Write all scans, ten per second (2.6 MB each), not only the keyframes that the method uses.",
    ),
    click.option(
        "--seed",
        type=click.IntRange(min=0),
        default=0,
        help="Seed of everything random: houses, cars, noise. The same seed gives the same drive.",
    ),
    click.option("--ground-only", is_flag=True, help="Write only points on the ground: about half the size."),
    click.option("--max-scans", type=click.IntRange(min=1), help="Number of scans after which the drive ends."),
    click.option(
        "--sensor",
        type=click.Choice(SENSORS),
        default="hdl-64e",
        help="LiDAR to drive with: its lasers, shots and range as published.",
    ),
    click.option(
        "--columns",
        type=click.IntRange(8, 8192),
        show_default="those of the sensor at 10 Hz",
        help="Shots of each laser per turn.",
    ),
    name="simulation",
    make=_simulation,
)


@click.group(short_help="Make a drive whose truth is known: town or KITTI twin.")
def simulate() -> None:
    """Write drives whose truth is known: a LiDAR drives through a made-up town, or along a track of KITTI over its map.

    \b
    The made-up town, with every shape of junction that matters; its map is DRIVE/map.osm:
      interloc simulate town -o DRIVE                      5 km, every shape
      interloc simulate town --part plain -o DRIVE         640 m, X, T and Y junctions only
    \b
    The town of the demo, with curved streets, market square and park:
      interloc simulate town --part quarter --ground-only --columns 720 -o DRIVE
    \b
    The twin of a KITTI sequence, as `interloc benchmark twins` measures it:
      interloc simulate twin 07 --kitti kitti -o DRIVE

    DRIVE is in SemanticKITTI format with oxts/: go on with `interloc run DRIVE -o OUT --osm MAP`.
    """
    require_lab()


@simulate.command(cls=options.Command)
@_OUT
@click.option(
    "--part",
    type=click.Choice(["full", "plain", "quarter"]),
    default="full",
    help="full: every shape of junction that matters, 5 km. plain: its X, T and Y junctions only, 640 m. "
    "quarter: a town as one knows them, 15 junctions along 2.1 km of curved streets and round a market square.",
)
@_SIMULATION
@options.QUIET
def town(out: Path, part: TownPart, simulation: SimulationOptions) -> None:
    """Drive through a made-up town whose map is its truth.

    The full one has oblique, staggered and compound junctions, a roundabout, a dual carriageway and a bridge.

    \b
    Example:
      interloc simulate town --part quarter -o drive && interloc run drive -o out --osm drive/map.osm
    """
    from interloc.lab.drive import simulate
    from interloc.lab.town import MAP_FILE, Town

    with console.progress("simulate", "scan") as bar:
        scans = simulate(Town(part, seed=simulation.seed).trip(), out, simulation, progress=bar)
    _go_on(scans, out, out / MAP_FILE)


@simulate.command(cls=options.Command)
@click.argument("sequence")
@click.option(
    "--kitti",
    required=True,
    type=options.PATH,
    help="Folder with oxts/, poses_suma/, calib/, times/, osm/ and osm_buildings/ of the sequences.",
)
@_OUT
@_SIMULATION
@options.QUIET
def twin(sequence: str, kitti: Path, out: Path, simulation: SimulationOptions) -> None:
    """Drive along the real track of KITTI odometry SEQUENCE (00, 02, ...) over its real map.

    \b
    Example:
      interloc simulate twin 07 --kitti kitti -o drive && interloc run drive -o out --osm kitti/osm/07.osm.gz
    """
    from interloc.lab.cases import twin_cases, twin_trip
    from interloc.lab.drive import simulate

    (case,) = twin_cases(kitti, [sequence])
    with console.progress("simulate", "scan") as bar:
        scans = simulate(twin_trip(kitti, sequence), out, simulation, progress=bar)
    _go_on(scans, out, case.osm)


def _go_on(scans: int, drive: Path, osm: Path) -> None:
    console.say_facts(
        [
            ("drive", f"{drive}: {scans} scans"),
            ("map", str(osm)),
            ("go on", shlex.join(["interloc", "run", str(drive), "-o", f"{drive}_result", "--osm", str(osm)])),
        ]
    )
