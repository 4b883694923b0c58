"""The group: help, exit codes, and what only a process of its own shows."""

import fcntl
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Callable
from pathlib import Path

import pytest

from interloc.cli.main import COMMANDS, MOVED
from tests.app.processes import Command, wait_until
from tests.cli.conftest import ENVIRONMENT

SETTINGS = (sys.executable, "-c", "from interloc.cli.main import main; main()", "info", "--settings")


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_explains_itself(command: str, interloc: Callable) -> None:
    outcome = interloc(command, "--help")
    assert outcome.code == 0
    assert "Example" in outcome.out or command in {"simulate", "benchmark"}


@pytest.mark.parametrize("command", MOVED)
def test_a_command_that_moved_says_where_in_a_line(command: str, interloc: Callable) -> None:
    outcome = interloc(command, "drive", "-o", "out")
    assert outcome.code == 2
    assert MOVED[command] in outcome.complaint


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nonsense"], "No such command 'nonsense'"),
        (["run"], "Missing argument 'DRIVE'"),
        (["info"], "Missing argument 'DRIVE'"),
        (["push", "--fetch", "job"], "--fetch JOB needs -o OUT"),
        (["convert", "drive", "-o", "out", "--all-scans"], "need --reduce"),
        (["run", "drive"], "Missing option '-o'"),
        (["run", "drive", "-o", "out", "--preset", "best"], "'best' is not one of 'default', 'paper'"),
        (["run", "drive", "-o", "out", "--workers", "0"], "0 is not in the range"),
        (["run", "drive", "-o", "out", "--osm", "a.osm", "--osm", "b.osm"], "--osm is given 2 times"),
        (["run", "drive", "-o", "out", "--osm", "map.osm", "--overpass"], "one of --osm FILE and --overpass"),
        (["evaluate", "out"], "one of --osm FILE and --overpass"),
        (["evaluate", "out", "--osm", "map.osm", "--policy", "mine"], "'mine' is not one of"),
        (["explain", "drive", "-o", "out"], "Missing option '--frame'"),
        (["label", "drive"], "one of the two"),
        (["label", "drive", "--by", "network"], "one of the two"),
        (["label", "drive", "--by", "geometry", "--model", "model"], "one of the two"),
        (["live", "drive"], "give --print"),
        (["live", "drive", "--print", "--name", "town"], "--keep and --name need --server"),
        (["locate", "drive"], "say where to look"),
        (["locate", "drive", "--osm", "map.osm", "--gpx", "watch.gpx"], "say where to look"),
        (["locate", "drive", "--osm", "map.osm", "--near", "49.0"], "2 numbers with commas"),
        (["locate", "drive", "--gpx", "a.gpx", "--track-only"], "--near, --radius and --track-only belong to --osm"),
        (["push", "drive", "-o", "out"], "-o, --overpass, --locate and --near need --run"),
        (["push", "drive", "--run", "--osm", "map.osm", "--overpass"], "one of --osm FILE and --overpass"),
        (["push", "drive", "--near", "49,8"], "-o, --overpass, --locate and --near need --run"),
        (["push", "drive", "--run", "--locate"], "place the drive on a map: give it by --osm FILE or --overpass"),
        (["push", "drive", "--run", "--locate", "--overpass"], "Say it by --near LAT,LON"),
        (["push", "drive", "--osm", "map.txt"], "is not an OpenStreetMap file by its name"),
        (["push", "drive", "--name", "a/b"], "without slashes"),
        (["push", "drive", "--server", "localhost:8000"], "expected an address such as http://127.0.0.1:8000"),
        (["push", "drive", "--run", "--set", "bev.resolution_m=cats"], "bev.resolution_m"),
        (["push", "drive", "--model", "model", "--labels", "labels"], "--model labels the scans here"),
        (["ros"], "interloc ros /velodyne_points"),
    ],
)
def test_wrong_usage_is_exit_code_2(arguments: list[str], says: str, interloc: Callable) -> None:
    outcome = interloc(*arguments)
    assert outcome.code == 2
    assert says in outcome.err
    assert not outcome.out


def test_a_fault_of_our_own_is_one_line(interloc: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr("interloc.drives.inspect.inspect_drive", broken)
    assert "a fault of InterLoc itself: ZeroDivisionError: division by zero" in interloc("info", "drive").complaint
    monkeypatch.setenv("INTERLOC_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        interloc("info", "drive")


LIGHT = {"numba", "scipy", "shapely", "geopandas", "pyproj"}


@pytest.mark.parametrize(
    ("does", "slow"),
    [
        ("run(['--help'])", {"numba", "numpy", "scipy", "matplotlib", "osmnx", "pydantic", "osmium", "cv2", "httpx"}),
        ("run(['info', sys.argv[1]])", LIGHT),
        ("import app.main", LIGHT),
        ("run(['run', *sys.argv[1:]])", {"scipy.ndimage", "scipy.sparse", "scipy.spatial", "geopandas"}),
    ],
    ids=["help", "info", "web process", "run"],
)
def test_nothing_slow_is_imported_that_is_not_needed(does: str, slow: set[str], drive: Path, tmp_path: Path) -> None:
    code = (
        f"import sys; from interloc.cli.main import run; {does};"
        f"print('slow imports:', sorted({slow} & sys.modules.keys()), file=sys.stderr)"
    )
    arguments = [sys.executable, "-c", code, str(drive), "-o", str(tmp_path / "out"), "--quiet"]
    process = subprocess.run(arguments, capture_output=True, text=True, env=ENVIRONMENT, check=True)
    assert process.stderr == "slow imports: []\n"


def test_the_console_script(tmp_path: Path) -> None:
    script = Path(sys.executable).with_name("interloc")
    if not script.exists():
        pytest.skip("interloc is not installed, only importable")
    arguments = [script, "export", tmp_path, "-o", tmp_path / "out.kml"]
    process = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert process.returncode == 1
    assert process.stderr.startswith(f"interloc: {tmp_path} is not an InterLoc result: it has no run.json")


def test_a_reader_that_went_away_is_no_error() -> None:
    with subprocess.Popen(SETTINGS, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=ENVIRONMENT) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_output_that_cannot_be_written() -> None:
    with Path("/dev/full").open("w") as full:
        process = subprocess.run(SETTINGS, stdout=full, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT, check=False)
    assert process.returncode == 1
    assert process.stderr == "interloc: the output could not be written: no space left on device\n"


@pytest.mark.skipif(sys.platform == "win32", reason="signals and terminals of Unix")
@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_a_run_that_is_stopped_leaves_nothing(stop: signal.Signals, drive: Path, tmp_path: Path) -> None:
    place = tmp_path / "place"
    place.mkdir()
    arguments = ["run", drive, "-o", "out", "--workers", "1", "--set", "keyframes.distance_m=0.1"]
    process = Command(arguments, ENVIRONMENT, tmp_path / "said", tmp_path / "err", place)
    # Its temporary folder is there: detection has begun.
    wait_until(lambda: bool(list(place.iterdir())) or process.exitcode is not None, "the temporary folder")
    process.send(stop)
    code, out, err = process.ended()
    assert code == 1, err
    assert err.strip() == "interloc: interrupted; nothing was written"
    assert not out
    assert not list(place.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="signals and terminals of Unix")
def test_progress_is_shown_on_a_terminal_only(interloc: Callable, short_drive: Path, tmp_path: Path) -> None:
    detect = ["run", str(short_drive), "--workers", "1", "-o", str(tmp_path / "a")]
    shown = stderr_on_terminal(detect, tmp_path / "out")
    assert shown.startswith(f"reading {short_drive}")
    assert "detect" in shown
    assert "keyframe" in shown
    assert not stderr_on_terminal([*detect, "--quiet"], tmp_path / "out").strip()
    piped = interloc("run", short_drive, "-o", tmp_path / "c")
    assert (piped.code, piped.err) == (0, "")


def stderr_on_terminal(arguments: list[str], out: Path) -> str:
    """Run a command whose stderr is a terminal, and return what it shows there."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
    shown = b""
    try:
        process = Command(arguments, ENVIRONMENT, out, Path(os.ttyname(theirs)))
        while process.is_alive() or select.select([ours], [], [], 0)[0]:
            if select.select([ours], [], [], 0.1)[0]:
                shown += os.read(ours, 65536)
    finally:
        os.close(theirs)
        os.close(ours)
    assert process.exitcode == 0
    return shown.decode()


def test_the_token_is_not_shown(interloc: Callable, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("INTERLOC_TOKEN", "a b-secret")
    outcome = interloc("push", "--fetch", "9b1e44f00c7a2d53", "-o", tmp_path / "out")
    assert outcome.code == 2
    assert outcome.complaint.startswith("interloc: token: ")
    assert "secret" not in outcome.err
    assert "secret" not in interloc("push", "--help").out
