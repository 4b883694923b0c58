"""Whose data a file of a result holds, and under which licence: the one place that decides it."""

from dataclasses import dataclass

ATTRIBUTION = "Detections: InterLoc."
OSM_ATTRIBUTION = "OSM data (c) OpenStreetMap contributors, ODbL 1.0, https://www.openstreetmap.org/copyright."
MADE_UP_ATTRIBUTION = "The map was made up by a simulator; its ids are not those of OpenStreetMap."
ODBL = "https://opendatacommons.org/licenses/odbl/1-0/"


@dataclass(frozen=True)
class Credit:
    """What is to be said of a file."""

    attribution: str = ATTRIBUTION
    """Whose data it holds."""
    license: str | None = None
    """Address of the licence of OpenStreetMap where the file holds data of it."""

    @property
    def members(self) -> dict[str, str]:
        """The same as foreign members of GeoJSON (RFC 7946, 6.1)."""
        license_ = {} if self.license is None else {"license": self.license}
        return {"attribution": self.attribution, **license_}


OWN_CREDIT = Credit()


def map_credit(*, is_made_up: bool) -> Credit:
    """Return the credit of what was compared with a map: of OpenStreetMap, or made up by a simulator."""
    if is_made_up:
        return Credit(f"{ATTRIBUTION} {MADE_UP_ATTRIBUTION}")
    return Credit(f"{ATTRIBUTION} {OSM_ATTRIBUTION}", ODBL)
