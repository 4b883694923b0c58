"""Maps of many drives, and the queue of their findings, as clients see them."""

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, Field

from app.http.patterns import ID, Name, Note
from interloc.city.models import Judgement, Kind, Precision, Verdict
from interloc.output.properties import FindingProperties


class NewMap(BaseModel):
    """A map of many drives to be made."""

    name: Name
    drives: Annotated[list[Annotated[str, Field(pattern=ID)]], Field(max_length=10_000)] = Field(
        [], description="Ids of the drives that belong to it; more can be put into it later."
    )


class MapModel(BaseModel):
    """A map of many drives."""

    id: str
    name: str
    owner: str
    holds_all: bool = Field(
        description="Whether all drives of the server belong to it but those that were taken out: the map `default`."
    )
    created_at: datetime
    revision: int = Field(description="How many times it was brought up to date.")
    merged_at: datetime | None = Field(description="When that was; null: it is empty as yet.")
    is_waiting: bool = Field(description="Whether results wait to be merged, or to be compared with OpenStreetMap.")
    is_at_work: bool = Field(description="Whether a worker merges or compares it now.")
    drives: int = Field(description="Drives on the map.")
    refused: int = Field(description="Drives that could not be merged; its list of drives says why.")
    intersections: int
    seen_by_several: int = Field(description="Intersections that were seen in several passes.")
    median_position_std_m: float | None
    median_relative_std_m: float | None
    findings: int | None = Field(description="What OpenStreetMap has wrong; null: it was not compared yet.")
    junctions_passed: int | None = Field(description="Junctions of OpenStreetMap that enough passes came by.")
    osm: str | None = Field(description="OSM file of the comparison.")
    is_made_up: bool = Field(description="Whether that file is of a made-up town, not of OpenStreetMap.")
    problem: str | None = Field(description="Why it could not be compared with OpenStreetMap.")
    bbox: list[float] | None = Field(description="West, south, east, north of its intersections, degrees.")


class MapList(BaseModel):
    """A page of the maps of the service, that of the server first."""

    maps: list[MapModel]
    next: str | None = Field(description="Value of `after` for the next page; null on the last page.")


class MapDriveModel(BaseModel):
    """A drive of a map."""

    drive_id: str
    name: str | None = Field(description="Name of the drive; null: it was deleted, and will be taken off the map.")
    label: str | None = Field(description="Its name on the map; no two of a map have the same.")
    job_id: str | None = Field(description="Job whose result was merged; null: none yet.")
    problem: str | None = Field(description="Why it is not on the map.")


class MapDriveList(BaseModel):
    """A page of the drives of a map, by their ids."""

    drives: list[MapDriveModel]
    next: str | None = Field(description="Value of `after` for the next page; null on the last page.")


class NewVerdict(BaseModel):
    """What somebody saw."""

    verdict: Verdict = Field(
        description="right: OpenStreetMap is wrong there; wrong: it is not, and the place never comes back; "
        "cannot_tell; fixed: it was wrong, and has been mended."
    )
    note: Note | None = None


class Links(BaseModel):
    """Where to look at a place, and to mend it."""

    osm: str
    id: str = Field(description="The editor iD.")
    josm: str = Field(description="Remote control of JOSM on the machine of whoever follows the link.")
    mapillary: str
    panoramax: str


class QueueEntry(BaseModel):
    """A finding, and what was said of it."""

    id: str
    lon: float
    lat: float
    properties: FindingProperties | None = Field(
        description="As of the layer `findings`; null: the last audit has it no more, as where it was marked wrong."
    )
    kind: Kind
    verdict: Judgement | None = Field(description="The last one; null: nobody has looked at it.")
    picture: str | None = Field(description="Address of the ground around it as the drives saw it.")
    links: Links


class WholeEntry(QueueEntry):
    """The same with its neighbours among those that nobody has looked at, and all that was said of it."""

    next: str | None
    previous: str | None
    history: list[Judgement]


State = Literal["open", "judged", "all"]


class QueuePage(BaseModel):
    """A page of the queue."""

    entries: list[QueueEntry]
    open: int = Field(description="Findings that nobody has looked at.")
    judged: int = Field(description="Findings that somebody has looked at.")
    precision: Precision
    by_kind: dict[Kind, Precision]
    next: str | None = Field(description="Value of `after` for the next page; null on the last page.")
