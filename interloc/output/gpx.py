"""The track of a result as GPX 1.1, for navigation devices and their programs; its intersections as waypoints."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING

from interloc.output.credits import joint_credit
from interloc.output.layers import LAYERS, Rows

if TYPE_CHECKING:
    from gpxpy.gpx import GPXTrack, GPXWaypoint

GPX_LAYERS = ("trajectory", "intersections")
"""What a GPX file holds."""


def write_gpx(drive: str, track: tuple[Rows, Rows], intersections: Rows) -> str:
    """Return the text of a GPX file.

    Parameters
    ----------
    drive
        Name of the drive.
    track
        The layers `trajectory` and `keyframes` of a result with longitude and latitude. Where keyframes have a time of
        day they are the points of the track, each with its time; otherwise the line of the trajectory is it.
    intersections
        The layer of this name; they are the waypoints.
    """
    from gpxpy.gpx import GPX  # noqa: PLC0415 - needed for this alone

    credit = joint_credit(rows.credit for rows in (*track, intersections))
    gpx = GPX()
    gpx.creator, gpx.name, gpx.description = "InterLoc", drive, credit.attribution
    if credit.license is not None:
        gpx.copyright_author, gpx.copyright_license = "OpenStreetMap contributors", credit.license
    gpx.waypoints = _waypoints(intersections)
    gpx.tracks = [_track(drive, *track)]
    return gpx.to_xml(version="1.1") + "\n"


def _track(drive: str, trajectory: Rows, keyframes: Rows) -> GPXTrack:
    from gpxpy.gpx import GPXTrack, GPXTrackPoint, GPXTrackSegment  # noqa: PLC0415

    times = keyframes.column("time")
    places = keyframes.points().tolist()
    if any(each is None for each in times):
        places = next((each.geometry.coordinates for each in trajectory.features if each.geometry is not None), [])
        times = [None] * len(places)
    track = GPXTrack(name=drive, description=trajectory.credit.attribution)
    track.segments.append(
        GPXTrackSegment(
            [GPXTrackPoint(lat, lon, time=_moment(each)) for (lon, lat), each in zip(places, times, strict=True)]
        )
    )
    return track


def _waypoints(intersections: Rows) -> list[GPXWaypoint]:
    from gpxpy.gpx import GPXWaypoint  # noqa: PLC0415

    made = []
    for feature in intersections.features:
        found = feature.properties
        lon, lat = feature.geometry.coordinates
        told = [f"{found.branch_count} branches", f"confidence {found.confidence:.2f}"]
        if found.outcome != "unscored":
            told.append(found.outcome)
        if found.osm_id is not None:
            told.append(f"OSM node {found.osm_id}")
        name = LAYERS["intersections"].label.format(id=found.id)
        made.append(GPXWaypoint(lat, lon, time=_moment(found.first_time), name=name, description=", ".join(told)))
    return made


def _moment(text: str | None) -> datetime | None:
    return None if text is None else datetime.fromisoformat(text)
