"""The code in README.md, in docs/ and in the docstring of the package runs, on a small drive of the names used there.

Python blocks of a page run one after the other, in one namespace; `<!-- not run: reason -->` before a block leaves it
out. Blocks of the console run after `<!-- run -->`: their commands, within this process, must print what stands there,
`...` standing for anything. The two commands of `make` are carried out as in a new clone; nothing is installed.
"""

import contextlib
import inspect
import io
import re
import shlex
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import pytest

import interloc
from interloc.cli.main import cli, run
from interloc.evaluation.evaluate import Evaluation
from interloc.results import DriveResult
from tests.crossing import write_drive

ROOT = Path(__file__).resolve().parents[1]
PAGES = ["README.md", *sorted(f"docs/{page.name}" for page in (ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(
    r"(?:^<!-- (?P<mark>[^\n]*?) -->\s*)?^```(?P<language>python|console)\n(?P<code>.*?)^```", re.MULTILINE | re.DOTALL
)


@dataclass(frozen=True)
class Block:
    """A block of code of a page."""

    language: str
    code: str
    mark: str

    @property
    def runs(self) -> bool:
        if self.language == "console":
            return self.mark == "run"
        assert self.mark in {"", "run"} or re.fullmatch(r"not run: .{10,}", self.mark)
        return not self.mark.startswith("not run")


def blocks(page: str) -> list[Block]:
    found = BLOCK.finditer((ROOT / page).read_text())
    return [Block(each["language"], each["code"], each["mark"] or "") for each in found]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a drive and a map of the names that the pages use."""
    folder = tmp_path_factory.mktemp("snippets")
    with contextlib.chdir(folder):
        write_drive(Path("sequences/07"), Path("2011_09_30_drive_0027_sync"))
    return folder


def console(code: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Run the commands of a block and compare what they print."""
    for command, expected in re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", code, re.MULTILINE):
        program, *arguments = shlex.split(command, comments=True)
        if (program, *arguments[:2]) == ("python", "-m", "interloc"):
            program, arguments = "interloc", arguments[2:]
        assert program == "interloc"
        capsys.readouterr()
        assert run(arguments) == 0
        printed = capsys.readouterr().out
        assert re.fullmatch(re.escape(expected).replace(r"\.\.\.", ".*"), printed, re.DOTALL), (command, printed)


@pytest.mark.parametrize("page", PAGES)
def test_blocks_of(page: str, place: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(place)
    names: dict[str, Any] = {}
    for block in blocks(page):
        if not block.runs:
            continue
        if block.language == "console":
            console(block.code, capsys)
        else:
            exec(compile(block.code, page, "exec"), names)  # noqa: S102 - our own words


def commands(page: str) -> list[list[str]]:
    """The arguments of every command line of InterLoc that a page shows."""
    shown = [line for block in blocks(page) if block.language == "console" for line in block.code.splitlines()]
    return [shlex.split(line, comments=True)[2:] for line in shown if line.startswith("$ interloc ")]


@pytest.mark.parametrize("page", PAGES)
def test_commands_shown_in(page: str) -> None:
    """They name commands and options that there are; nothing is run."""
    for arguments in commands(page):
        command: click.Command = cli
        context = click.Context(cli)
        rest = arguments
        while isinstance(command, click.Group):
            name, *rest = rest
            found = command.get_command(context, name)
            assert found is not None, arguments
            command, context = found, click.Context(found, parent=context, info_name=name)
        command.make_parser(context).parse_args(rest)


def test_the_docstring_of_the_package(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(place)
    text = inspect.getdoc(interloc) or ""
    code = "\n".join(line.removeprefix("    ") for line in text.splitlines() if line.startswith("    ") or not line)
    names: dict[str, Any] = {}
    with contextlib.redirect_stdout(io.StringIO()):
        exec(code.split("Open a drive;")[0], names)  # noqa: S102
    shows_itself(names["result"], names["evaluation"])


def shows_itself(result: DriveResult, evaluation: Evaluation) -> None:
    """What a notebook shows of them: short lines, and tables on the map."""
    assert repr(result) == (
        f"<DriveResult 07: 48 keyframes, {len(result.detections)} detections, 1 intersection, with georeference>"
    )
    assert re.fullmatch(
        r"<Evaluation 07: ACE \d\.\d\d m, precision 100\.0 %, recall 100\.0 % at 5 m, 1 of 1 nodes>", repr(evaluation)
    )
    assert evaluation.precision == evaluation.recall == evaluation.f1 == 1.0
    table = evaluation.geodataframe("intersections")
    assert (table.crs.to_epsg(), table["outcome"].tolist()) == (4326, ["right"])
    assert evaluation.geodataframe("roads").geom_equals(result.geodataframe("roads")).all(), "of the result as it was"
    assert {result, result} == {result}
    assert result != evaluation.result


TOOLS = ("sh", "make", "git", "python3")
STEPS = {
    "demo": [
        "-m venv .venv",
        'pip install .* -c constraints.txt -e "',
        "simulate town .* -o demo/drive$",
        "run demo/drive -o demo/drive_result --osm demo/drive/map.osm",
        "push demo/drive --osm demo/drive/map.osm --run .*interloc serve --port 8000 --data-dir demo/service",
    ],
    "test": [
        "-m venv .venv",
        'pip install .* -c constraints.txt -e "',
        'pip install .* -c constraints.txt .*-e ".*,dev.*"',
        "ruff check",
        "lint-imports",
        "mypy",
        "-m tests.forks",
        " -m pytest ",
    ],
}
INSTALLS_THE_PAGE = {"demo": ["ci --silent --omit=dev --prefix static"], "test": ["ci --silent --prefix static"]}


def make_commands() -> list[str]:
    section = (ROOT / "README.md").read_text().split("\n## Install\n")[1].split("\n## ")[0]
    return re.findall(r"^\$ make (\w+)", section, re.MULTILINE)


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What is in the repository, and nothing else."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not a clone of the repository")
    folder = tmp_path_factory.mktemp("clone")
    for name in filter(None, listed.stdout.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)
    return folder


@pytest.fixture(params=["npm", "no npm"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """A PATH with the tools that README.md asks for; npm only writes down how it was called."""
    for tool in TOOLS:
        place = shutil.which(tool)
        assert place is not None
        (tmp_path / tool).symlink_to(place)
    if request.param == "npm":
        (tmp_path / "npm").write_text(f'#!/bin/sh\necho "$@" >> {tmp_path}/called\n')
        (tmp_path / "npm").chmod(0o755)
    return str(tmp_path)


def test_there_are_two_commands() -> None:
    assert make_commands() == list(STEPS)


@pytest.mark.parametrize("command", STEPS)
def test_a_command_does_all_from_a_new_clone(command: str, clone: Path, path: str) -> None:
    variables = {"PATH": path, "HOME": path}
    plan = subprocess.run(["make", "-n", command], cwd=clone, env=variables, capture_output=True, text=True, check=True)
    steps = plan.stdout.replace("\\\n", "")
    lines = iter(steps.splitlines())
    for step in STEPS[command]:  # in this order
        assert any(re.search(step, line) for line in lines), f"{step}: {steps}"
    # What may be missing is asked for at the time: these lines are carried out.
    asks = [line for line in steps.splitlines() if "command -v npm" in line]
    told = ""
    for line in asks:
        told += subprocess.run(["sh", "-ec", line], cwd=clone, env=variables, text=True, check=True, stdout=-1).stdout
    called = Path(path, "called")
    if Path(path, "npm").exists():
        assert set(INSTALLS_THE_PAGE[command]) <= set(called.read_text().splitlines())
        assert not told
    else:
        assert "npm was not found: everything but the page of the web service will work" in told
