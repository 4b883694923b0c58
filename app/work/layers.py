"""The layers that the service has of each result: those of its files, those made of them, and where it was driven."""

from pydantic import Field

from interloc.output.layers import DERIVED, LAYERS, Layer
from interloc.output.properties import Properties, Time


class FootprintProperties(Properties):
    """The surroundings of the track of a drive: up to 25 m from it."""

    scans: int = Field(title="Scans", description="Number of scans of the drive.")
    keyframes: int = Field(title="Keyframes", description="Number of keyframes.")
    detections: int = Field(title="Detections", description="Number of detections.")
    intersections: int = Field(title="Intersections", description="Number of intersections found.")
    first_time: Time = Field(
        title="Begin", description="Time of the first keyframe, RFC 3339; null where the drive has no times of day."
    )
    last_time: Time = Field(
        title="End", description="Time of the last keyframe, RFC 3339; null where the drive has no times of day."
    )


FOOTPRINTS = Layer("drives", "Areas that were driven through", "Polygon", FootprintProperties, "Drive")
"""The layer that is made for the service of the others."""

RESULT_LAYERS = {**LAYERS, **DERIVED, FOOTPRINTS.name: FOOTPRINTS}
"""The layers of a result that have tables."""
