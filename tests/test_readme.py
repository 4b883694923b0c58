"""The two commands at the top of README.md, as make would carry them out in a new clone; nothing is installed."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
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


def commands() -> list[str]:
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
    assert commands() == list(STEPS)


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
