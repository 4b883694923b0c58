"""The product without `interloc.lab`, as a wheel that leaves it out."""

import os
import subprocess
import sys
from pathlib import Path

import interloc

SCRIPT = """
import sys
from types import SimpleNamespace
import interloc
from interloc.cli.main import run
assert interloc.__file__.startswith(sys.argv[1]), interloc.__file__
assert run(["info", sys.argv[2]]) == 0
few = ["--frames", ":12", "--workers", "1", "--quiet"]
assert run(["run", sys.argv[2], "-o", "out", "--osm", sys.argv[2] + "/map.osm", *few]) == 0
assert run(["--help"]) == run(["simulate", "--help"]) == run(["benchmark", "twins", "--help"]) - 1 == 0
assert run(["simulate", "town", "-o", "drive"]) == 1
from app.demo.work import prepare
import app.main
try:
    prepare(SimpleNamespace())
except interloc.InterLocError as error:
    print(error, file=sys.stderr)
"""


def test_everything_but_simulations_benchmarks_and_the_demo_works(town: Path, tmp_path: Path) -> None:
    package = tmp_path / "interloc"
    package.mkdir()
    for entry in Path(interloc.__file__).parent.iterdir():
        if entry.name != "lab":
            (package / entry.name).symlink_to(entry)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(tmp_path), str(town)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    said = [line for line in done.stderr.splitlines() if "this installation has no interloc.lab" in line]
    assert len(said) == 3
    assert (tmp_path / "out/report.html").is_file()
    assert "Traceback" not in done.stderr
