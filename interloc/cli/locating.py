"""What the commands that place a drive on a map share: where to search."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from interloc.cli import options

if TYPE_CHECKING:
    from interloc.osm.graph import RoadGraph


class _Place(click.ParamType):  # type: ignore[type-arg, unused-ignore] # generic in the newest click only
    """Latitude and longitude with a comma between them: 49.01,8.43."""

    name = "LAT,LON"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        if isinstance(value, tuple):
            return value
        try:
            lat, lon = map(float, str(value).split(","))
        except ValueError:
            self.fail(f"{value!r} is not LAT,LON: 2 numbers with commas between them.", param, ctx)
        return lat, lon


locate_option = click.option(
    "--locate",
    is_flag=True,
    help="Place the drive on the map by its roads; a georeference is not used. --near does that where there is none.",
)

near_options = options.together(
    click.option("--near", type=_Place(), metavar="LAT,LON", help="Search only around here; with --radius."),
    click.option(
        "--radius", "radius_km", type=click.FloatRange(min=0.1), help="How far around --near, km.  [default: 3]"
    ),
)
"""Where to search."""


def search_area(
    near: tuple[float, float] | None, radius_km: float | None
) -> tuple[tuple[float, float] | None, float | None]:
    """Return `near` and `radius_m` of `locate` by the values of `near_options`."""
    if near is not None:
        return near, 1000.0 * (3.0 if radius_km is None else radius_km)
    if radius_km is not None:
        raise click.UsageError("--radius says how far around --near to search; give --near too")
    return None, None


def fetch_map_around(near: tuple[float, float] | None, radius_m: float | None) -> RoadGraph:
    """Fetch the map to search from Overpass."""
    import numpy as np

    if near is None or radius_m is None:
        raise click.UsageError("the map of which place is to be fetched? Say it by --near LAT,LON, or give --osm FILE")
    return options.fetch_roads(np.array([near[::-1]]), margin_m=radius_m)
