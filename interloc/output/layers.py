"""The layers of a result: what they are called, what they hold, and who is to be named for them."""

from __future__ import annotations

from dataclasses import dataclass

ATTRIBUTION = "Detections: InterLoc."
OSM_ATTRIBUTION = "OSM data (c) OpenStreetMap contributors, ODbL 1.0, https://www.openstreetmap.org/copyright."


@dataclass(frozen=True)
class Layer:
    """A layer of a result.

    Attributes
    ----------
    name : str
        Of the layer, and of its GeoJSON file.
    title : str
    geometry : str
        Point or LineString.
    fields : dict of str to str
        Property -> int, float, bool, text or list.
    label : str
        Name of a feature in a KML file, a format string over its properties.
    is_osm : bool
        Whether it holds data of OpenStreetMap.
    """

    name: str
    title: str
    geometry: str
    fields: dict[str, str]
    label: str
    is_osm: bool = False

    @property
    def attribution(self) -> str:
        """Who is to be named where the layer is shown."""
        return f"{ATTRIBUTION} {OSM_ATTRIBUTION}" if self.is_osm else ATTRIBUTION


def _fields(**kinds: str) -> dict[str, str]:
    return {name: kind for kind, names in kinds.items() for name in names.split()}


LAYERS = {
    layer.name: layer
    for layer in (
        Layer(
            "intersections",
            "Intersections found",
            "Point",
            _fields(
                int="id observations branch_count first_frame last_frame",
                float="position_std_m confidence world_x_m world_y_m",
                list="branch_bearings_deg",
            ),
            "Intersection {id}",
        ),
        Layer(
            "detections",
            "Detections, one a keyframe",
            "Point",
            _fields(
                int="frame branch_count intersection",
                float="x_m y_m world_x_m world_y_m score",
                list="branch_bearings_deg",
            ),
            "Detection at frame {frame}",
        ),
        Layer("trajectory", "Way of the LiDAR", "LineString", _fields(int="scans", float="thinned_to_m"), "Trajectory"),
        Layer(
            "keyframes",
            "Keyframes",
            "Point",
            _fields(int="frame detections", float="time_s heading_deg world_x_m world_y_m world_yaw_rad"),
            "Keyframe {frame}",
        ),
        Layer(
            "osm_nodes",
            "Intersections of OpenStreetMap",
            "Point",
            _fields(
                int="osm_id degree keyframes_in_zone keyframes_missed detections",
                bool="in_zone found",
                float="median_error_m",
            ),
            "OSM node {osm_id}",
            is_osm=True,
        ),
        Layer(
            "matches",
            "Detections and the OpenStreetMap nodes that they were matched to",
            "LineString",
            _fields(int="frame osm_id", float="error_m", text="outcome"),
            "{outcome}, frame {frame}",
            is_osm=True,
        ),
        Layer(
            "osm_roads",
            "Roads of OpenStreetMap",
            "LineString",
            _fields(int="osm_id", text="highway name", bool="is_drivable"),
            "OSM way {osm_id}",
            is_osm=True,
        ),
    )
}
