"""A result as a recording for Foxglove and Lichtblick: an MCAP file of Foxglove's public schemas.

On the map: intersections, roads and track as GeoJSON, and a fix per keyframe. In the 3D scene: the same in metres east
and north of the first keyframe, or of W without georeference, in the frame `map`.
"""

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.errors import ConfigError, install
from interloc.files import atomic_write
from interloc.output.geojson import read_file
from interloc.output.layout import file_names, refuse_result_file
from interloc.output.read import read_results
from interloc.results import DriveResult

SUFFIX = ".mcap"

_FRAME = "map"
_USUAL_S = 0.1  # between keyframes whose times are not known
_BRANCH_M = 15.0
_YELLOW, _GREY, _WHITE = (0.94, 0.89, 0.26), (0.66, 0.69, 0.72), (0.9, 0.9, 0.9)
_GEOJSON = ("intersections", "roads", "trajectory")


def write_mcap(result: Path, out: Path) -> list[str]:
    """Write a result folder as a recording, and return its topics; without the extra ``mcap`` it is a ConfigError."""
    try:
        import foxglove  # noqa: PLC0415 - an extra
        from foxglove import channels  # noqa: PLC0415
        from foxglove import messages as fg  # noqa: PLC0415
    except ImportError as error:
        raise ConfigError(f"MCAP files need foxglove-sdk, which is not installed: {install('mcap')}") from error
    refuse_result_file(out)
    run = read_results(result)
    names = file_names(georeferenced=run.is_georeferenced)
    layers = {name: read_file(result / names[name]) for name in _GEOJSON if (result / names[name]).exists()}
    times_ns = _times_ns(run)
    first_ns = times_ns[0] if times_ns else 0
    context = foxglove.Context()
    topics = []
    with atomic_write(out) as file, foxglove.open_mcap(file, context=context):
        if run.is_georeferenced:
            for name, content in layers.items():
                channel = channels.GeoJsonChannel(topic := f"/interloc/{name}", context=context)
                channel.log(fg.GeoJson(geojson=content.decode()), log_time=first_ns)
                topics.append(topic)
            fixes = channels.LocationFixChannel("/interloc/fix", context=context)
            for row, time_ns in enumerate(times_ns):
                fixes.log(_fix(fg, run, row, time_ns), log_time=time_ns)
            topics.append("/interloc/fix")
        scene = channels.SceneUpdateChannel("/interloc/scene", context=context)
        scene.log(_scene(fg, run, layers.get("roads"), first_ns), log_time=first_ns)
        topics.append("/interloc/scene")
    return topics


def _times_ns(run: DriveResult) -> list[int]:
    seconds: FloatArray = run.keyframes.time_s
    if not np.isfinite(seconds).all():
        seconds = np.asarray(run.keyframes.frame * _USUAL_S, np.float64)
    return [round(1e9 * each) for each in seconds.tolist()]


def _fix(fg: Any, run: DriveResult, row: int, time_ns: int) -> Any:  # noqa: ANN401 - of foxglove
    keyframes = run.keyframes
    assert keyframes.lonlat is not None
    assert keyframes.enu_yaw_rad is not None
    lon, lat = keyframes.lonlat[row].tolist()
    heading_rad = (math.pi / 2 - float(keyframes.enu_yaw_rad[row])) % (2 * math.pi)
    return fg.LocationFix(
        timestamp=_timestamp(fg, time_ns), frame_id="lidar", latitude=lat, longitude=lon, heading=heading_rad
    )


def _timestamp(fg: Any, time_ns: int) -> Any:  # noqa: ANN401 - of foxglove
    return fg.Timestamp(sec=time_ns // 10**9, nsec=time_ns % 10**9)


def _scene(fg: Any, run: DriveResult, roads: bytes | None, time_ns: int) -> Any:  # noqa: ANN401 - of foxglove
    def entity(name: str, **parts: Any) -> Any:  # noqa: ANN401 - of foxglove
        return fg.SceneEntity(timestamp=_timestamp(fg, time_ns), frame_id=_FRAME, id=name, **parts)

    def line(xy: Iterable[Any], colour: tuple[float, float, float], thickness_m: float) -> Any:  # noqa: ANN401
        return fg.LinePrimitive(
            type=fg.LinePrimitiveLineType.LineStrip,
            thickness=thickness_m,
            points=[fg.Point3(x=float(x), y=float(y)) for x, y in xy],
            color=fg.Color(r=colour[0], g=colour[1], b=colour[2], a=1.0),
        )

    table = run.intersections
    places = run.local_xy(table.lonlat, table.world_xy)
    track = run.local_xy(run.trajectory_lonlat, run.trajectory_world_xy)
    entities = [entity("track", lines=[line(track, _WHITE, 0.3)])]
    for row, (x, y) in enumerate(places.tolist()):
        bearings = np.radians(table.bearings_deg[row])
        ends = np.stack([x + _BRANCH_M * np.sin(bearings), y + _BRANCH_M * np.cos(bearings)], axis=-1)
        size_m = max(1.0, 2.0 * float(table.position_std_m[row]))
        sphere = fg.SpherePrimitive(
            pose=fg.Pose(position=fg.Vector3(x=x, y=y), orientation=fg.Quaternion(w=1.0)),
            size=fg.Vector3(x=size_m, y=size_m, z=size_m),
            color=fg.Color(r=_YELLOW[0], g=_YELLOW[1], b=_YELLOW[2], a=0.4 + 0.6 * float(table.confidence[row])),
        )
        facts = {"confidence": table.confidence[row], "observations": table.observations[row]}
        entities.append(
            entity(
                f"intersection {table.id[row]}",
                spheres=[sphere],
                lines=[line([(x, y), end], _YELLOW, 0.5) for end in ends],
                metadata=[fg.KeyValuePair(key=key, value=f"{value:g}") for key, value in facts.items()],
            )
        )
    features = json.loads(roads)["features"] if roads else []
    for number, feature in enumerate(features, 1):
        xy = np.array(feature["geometry"]["coordinates"], np.float64)[:, :2]
        placed: FloatArray = run.local_xy(xy if run.is_georeferenced else None, xy)
        width_m = feature["properties"].get("width_m") or 1.0
        entities.append(entity(f"road {number}", lines=[line(placed, _GREY, width_m)]))
    return fg.SceneUpdate(entities=entities)
