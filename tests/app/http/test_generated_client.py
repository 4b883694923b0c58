"""A client that openapi-python-client makes of the description: no warning, and it can do all that a pipeline needs."""

import importlib
import json
import subprocess
import sys
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any

import httpx
import pytest

from app.main import create_app
from app.settings import Settings

NAME = "generated_interloc_client"


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Folder of the package, which can be imported as `NAME`."""
    folder = tmp_path_factory.mktemp("generated")
    description = folder / "openapi.json"
    description.write_text(json.dumps(create_app(Settings()).openapi()))
    settings = folder / "settings.yaml"
    settings.write_text("post_hooks: []\nliteral_enums: true\n")  # nothing is formatted: nobody reads it
    options = ["--config", settings, "--path", description, "--meta", "none", "--output-path", folder / NAME]
    made = subprocess.run(
        [sys.executable, "-m", "openapi_python_client", "generate", *map(str, options), "--fail-on-warning"],
        capture_output=True,
        text=True,
        cwd=folder,
        check=False,
    )
    said = made.stdout + made.stderr
    assert made.returncode == 0, said
    assert "warning" not in said.lower().replace("fail-on-warning", ""), said
    sys.path.insert(0, str(folder))
    yield folder / NAME
    sys.path.remove(str(folder))
    for module in [each for each in sys.modules if each.partition(".")[0] == NAME]:
        del sys.modules[module]


@pytest.fixture
def connection(generated: Path, client: httpx.Client) -> Any:
    assert generated.is_dir()
    made = part("client").Client(base_url=str(client.base_url), timeout=httpx.Timeout(120))
    with made as opened:
        yield opened


def part(path: str) -> ModuleType:
    return importlib.import_module(f"{NAME}.{path}")


def test_it_is_small(generated: Path) -> None:
    assert len(list(generated.rglob("*.py"))) < 150


def test_a_drive_becomes_typed_intersections(connection: Any, street: Path, tmp_path: Path) -> None:
    models, types = part("models"), part("types")
    new = models.NewDrive(name="by a generated client")
    created = part("api.drives.create_drive").sync_detailed(client=connection, body=new, idempotency_key=str(tmp_path))
    assert created.status_code == 201
    again = part("api.drives.create_drive").sync_detailed(client=connection, body=new, idempotency_key=str(tmp_path))
    assert (again.status_code, again.parsed.id) == (200, created.parsed.id)
    drive = created.parsed.id
    for file in sorted(path for path in street.rglob("*") if path.is_file()):
        with file.open("rb") as content:
            sent = part("api.uploads.put_file").sync(
                drive, file.relative_to(street).as_posix(), client=connection, body=types.File(payload=content)
            )
        assert isinstance(sent, models.UploadedFile), sent
    ready = part("api.uploads.commit_drive").sync(drive, client=connection)  # without a body
    assert (ready.state, ready.report.scans) == ("ready", 40)
    assert len(ready.bbox) == 4
    order = models.NewJob(drive_id=drive, osm=models.OsmFile(file="map.osm"))
    job = part("api.jobs.create_job").sync(client=connection, body=order, prefer="wait=60")
    assert (job.state, job.error) == ("successful", None)
    assert part("api.jobs.show_job").sync(job.id, client=connection).to_dict() == job.to_dict()
    found = part("api.results.read_layer").sync(job.id, "intersections", client=connection)
    assert len(found.features) == job.summary["intersections"] > 1
    first = found.features[0]
    assert isinstance(first, models.Feature)
    assert 0 < first.properties["confidence"] <= 1
    assert part("api.exports.read_export").sync(job.id, client=connection, f="gpkg").payload.read(6) == b"SQLite"
    presets = part("api.jobs.list_presets").sync(client=connection)
    assert {preset.name for preset in presets.presets} == {"default", "paper"}


def test_a_drive_that_is_not_usable_is_refused_with_its_problems(connection: Any) -> None:
    models, types = part("models"), part("types")
    drive = part("api.drives.create_drive").sync(client=connection, body=models.NewDrive(name="half")).id
    scan = types.File(payload=BytesIO(bytes(16)))
    part("api.uploads.put_file").sync(drive, "velodyne/000000.bin", client=connection, body=scan)
    refused = part("api.uploads.commit_drive").sync_detailed(drive, client=connection)
    assert (refused.status_code, type(refused.parsed)) == (422, models.ProblemDocument)
    assert refused.parsed.type_ == "/problems/drive-not-usable"
    assert refused.parsed.problems[0].severity == "error"
    early = part("api.jobs.create_job").sync(client=connection, body=models.NewJob(drive_id=drive))
    assert (early.type_, early.status) == ("/problems/drive-not-ready", 409)
