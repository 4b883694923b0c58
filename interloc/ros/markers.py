"""The map as it is known now, as messages of ROS."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from interloc.live.documents import intersection_document
from interloc.live.growing_map import MapIntersection

_BRANCH_M = 15.0
_SIZE_M = 3.0
_SURE, _UNSURE = ColorRGBA(r=0.94, g=0.89, b=0.26, a=1.0), ColorRGBA(r=0.94, g=0.89, b=0.26, a=0.35)


def map_markers(header: Header, intersections: Sequence[MapIntersection], z_m: float) -> MarkerArray:
    """Return the intersections as spheres, those that are not confirmed yet paler, and their branches as lines.

    They are drawn at a height in metres, in the frame of the poses, which the header names.
    """
    spheres = _marker(header, "intersections", Marker.SPHERE_LIST, _SIZE_M)
    lines = _marker(header, "branches", Marker.LINE_LIST, _SIZE_M / 6)
    for each in intersections:
        x, y = each.world_xy.tolist()
        colour = _SURE if each.is_confirmed else _UNSURE
        spheres.points.append(Point(x=x, y=y, z=z_m))
        spheres.colors.append(colour)
        for bearing in np.radians(each.bearings_deg).tolist():  # clockwise from +y
            end = Point(x=x + _BRANCH_M * math.sin(bearing), y=y + _BRANCH_M * math.cos(bearing), z=z_m)
            lines.points.extend([Point(x=x, y=y, z=z_m), end])
            lines.colors.extend([colour, colour])
    for marker in (spheres, lines):
        marker.action = Marker.ADD if marker.points else Marker.DELETE  # RViz complains of empty lists
    return MarkerArray(markers=[spheres, lines])


def map_json(header: Header, intersections: Sequence[MapIntersection]) -> str:
    """Return the intersections with covariances and branches, as JSON: no message of ROS has a place for them."""
    stamp = header.stamp.sec + header.stamp.nanosec / 1e9
    document: dict[str, Any] = {"stamp": stamp, "frame_id": header.frame_id}
    return json.dumps(document | {"intersections": [intersection_document(each) for each in intersections]})


def _marker(header: Header, namespace: str, kind: int, size_m: float) -> Marker:
    marker = Marker(header=header, ns=namespace, id=0, type=kind)
    marker.scale.x = marker.scale.y = marker.scale.z = size_m
    marker.pose.orientation.w = 1.0
    return marker
