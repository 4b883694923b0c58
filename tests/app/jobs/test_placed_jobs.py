"""Jobs that place a drive without GNSS on the map."""

import json
from pathlib import Path

import httpx
import pytest

from interloc.cli.main import run
from tests.app.processes import API, assert_as_by_command, ended, submit, upload
from tests.app.street import write_street
from tests.localization.town import LAT_DEG, LON_DEG, MadeDrive, write_town_drive, write_town_map

BY_MAP = {"georeference": "map", "osm": {"file": "map.osm"}}
NEAR = {"lat_deg": LAT_DEG, "lon_deg": LON_DEG, "radius_km": 0.6}


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, MadeDrive]:
    root = tmp_path_factory.mktemp("drives") / "town"
    drive = write_town_drive(root, every_m=8)
    write_town_map(root / "map.osm")
    return root, drive


def test_a_job_places_a_drive_as_the_command_line_does(
    client: httpx.Client, town: tuple[Path, MadeDrive], tmp_path: Path
) -> None:
    root, truth = town
    job = ended(client, submit(client, upload(client, root), near=NEAR, **BY_MAP))
    lon, lat = truth.true_lonlat[0]
    location = job["summary"]["location"]
    assert (location["lat_deg"], location["lon_deg"]) == pytest.approx((lat, lon), abs=3e-5)
    assert 0.0 < location["position_std_m"] < 3.0
    assert job["summary"]["georeferenced"] is True

    out = tmp_path / "out"
    near = ["--near", f"{LAT_DEG},{LON_DEG}", "--radius", "0.6"]
    assert run(["run", str(root), "-o", str(out), "--osm", str(root / "map.osm"), "--locate", *near, "--quiet"]) == 0
    assert_as_by_command(client, job, out, "osm_nodes", "places")
    assert client.get(f"{API}/jobs/{job['id']}/export?f=kml&layer=places").status_code == 200
    told = client.get(job["links"]["run"]).json()["location"]
    assert (told["source"], told["outcome"]) == ("map", "found")
    report = client.get(job["links"]["report"], headers={"Accept": "application/json"}).json()
    assert any("left this node out" in warning for warning in report["warnings"])

    other = ended(client, submit(client, job["drive_id"], near=NEAR | {"lon_deg": 9.0}, **BY_MAP))
    assert (other["state"], other["error"]["status"]) == ("failed", 422)
    assert "no road" in other["error"]["detail"] or "no highway" in other["error"]["detail"]


def test_what_cannot_be_placed_fails_with_the_places_and_what_would_help(client: httpx.Client, tmp_path: Path) -> None:
    street = write_street(tmp_path / "street", 60)
    drive = upload(client, street)
    job = ended(client, submit(client, drive, **BY_MAP))
    assert (job["state"], job["error"]["status"]) == ("failed", 422)
    assert "A longer drive" in job["error"]["detail"]
    assert "49.00" in job["error"]["detail"]
    assert "places" not in job["links"]
    scored = ended(client, submit(client, drive, osm={"file": "map.osm"}))  # by its GNSS all is as before
    assert scored["state"] == "successful"
    assert "places" not in scored["links"]
    assert client.get(f"{API}/jobs/{scored['id']}/layers/places").status_code == 404


@pytest.mark.parametrize(
    ("job", "says"),
    [
        ({"georeference": "map"}, "osm names none"),
        ({"georeference": "map", "osm": {"overpass": True}}, "Say roughly where"),
        ({"near": NEAR}, "give both"),
        ({**BY_MAP, "near": {"lat_deg": 91, "lon_deg": 0}}, "near.lat_deg"),
        ({**BY_MAP, "near": {"lat_deg": 49, "lon_deg": 8, "radius_km": 1e9}}, "near.radius_km"),
        ({**BY_MAP, "georeference": "sun"}, "georeference"),
    ],
)
def test_a_request_that_makes_no_sense_is_refused(client: httpx.Client, job: dict[str, object], says: str) -> None:
    drive = client.post(f"{API}/drives", json={"name": "empty"}).json()["id"]
    client.put(f"{API}/drives/{drive}/files/map.osm", content=b"<osm/>").raise_for_status()
    answer = client.post(f"{API}/jobs", json={"drive_id": drive, **job})
    assert answer.status_code == 422
    assert says in json.dumps(answer.json())
