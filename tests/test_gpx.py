"""Tracks in GPX files, and what is no track."""

from datetime import UTC, datetime
from pathlib import Path

import pytest

from interloc.errors import DriveError
from interloc.localization.gpx import read_gpx


def gpx_text(points: str) -> str:
    return f'<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{points}</trkseg></trk></gpx>'


def test_a_file_is_read_with_and_without_times_and_heights(tmp_path: Path) -> None:
    path = tmp_path / "a.gpx"
    points = "".join(
        f'<trkpt lat="49.0" lon="8.4{i}"><ele>11{i}</ele><time>2026-01-01T00:00:0{i}Z</time></trkpt>' for i in range(3)
    )
    path.write_text(gpx_text(points))
    track = read_gpx(path)
    assert track.lonlat.tolist() == [[8.40, 49.0], [8.41, 49.0], [8.42, 49.0]]
    assert datetime.fromtimestamp(track.time_s[2], UTC) == datetime(2026, 1, 1, 0, 0, 2, tzinfo=UTC)
    assert track.alt_m.tolist() == [110, 111, 112]
    path.write_text(gpx_text('<trkpt lat="49.0" lon="8.4"><ele>110</ele></trkpt><trkpt lat="49.0" lon="8.5"/>'))
    bare = read_gpx(path)
    assert (bare.time_s, bare.alt_m) == (None, None)


def test_a_route_is_read_where_there_is_no_track(tmp_path: Path) -> None:
    path = tmp_path / "a.gpx"
    path.write_text('<gpx version="1.0"><rte><rtept lat="49" lon="8"/><rtept lat="49" lon="8.1"/></rte></gpx>')
    assert read_gpx(path).lonlat.tolist() == [[8.0, 49.0], [8.1, 49.0]]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "it is no GPX file"),
        ("no xml", "it is no GPX file"),
        (gpx_text('<trkpt lat="49" lon="8"/>')[:-6], "it is no GPX file"),
        ("<kml/>", r"holds 0 points of a track or route \(it starts with <kml>\)"),
        (gpx_text(""), "holds 0 points"),
        ('<gpx version="1.1"><wpt lat="1" lon="2"/></gpx>', "waypoints are not enough"),
        (gpx_text('<trkpt lat="x" lon="8"/>'), "it is no GPX file"),
        (gpx_text('<trkpt lat="49" lon="8"/><trkpt lat="95" lon="8"/>'), "point 2 is at latitude 95"),
        (gpx_text('<trkpt lat="49" lon="nan"/><trkpt lat="49" lon="8"/>'), "beyond 180 degrees"),
        ('<!DOCTYPE gpx [<!ENTITY a "b">]>' + gpx_text(""), "declares entities or a DOCTYPE"),
    ],
)
def test_what_is_no_track_is_refused(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.gpx"
    path.write_text(text)
    with pytest.raises(DriveError, match=says):
        read_gpx(path)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DriveError, match="could not be read"):
        read_gpx(tmp_path / "none.gpx")
    with (tmp_path / "large.gpx").open("wb") as file:
        file.truncate(200_000_000)
    with pytest.raises(DriveError, match="at most 100,000,000"):
        read_gpx(tmp_path / "large.gpx")
