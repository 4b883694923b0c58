"""What jobs are asked, and what comes of them, by kind: the JSON of the members `request` and `summary` of their rows.

Rows outlive versions: what older ones did not write has a default, and what this one does not know is ignored.
"""

from typing import Literal, TypedDict, cast

from pydantic import BaseModel, ConfigDict, Field

from interloc.arrays import JsonObject
from interloc.config import DetectorConfig
from interloc.drives.inspect import DriveReport
from interloc.drives.options import LabelChoice, LabelFolder, ReadingOptions
from interloc.osm.policies import Policy
from interloc.output.layers import DERIVED, LAYERS


class StoredMap(TypedDict, total=False):
    """Where the map of a job comes from, in its row."""

    file: str
    overpass: bool


class StoredRequest(TypedDict, total=False):
    """What a row holds as `request`, whatever the kind and version of its job; the work reads it as a `JobRequest`."""

    name: str | None
    preset: str
    config: JsonObject
    labels: str | None
    osm: StoredMap | None
    policy: str
    subscriber: dict[str, str]
    options: JsonObject
    source: str
    archive: str


class StoredSummary(TypedDict, total=False):
    """What of the `summary` of a row is looked at without its model: older ones lack members that this needs."""

    ok: bool
    georeferenced: bool
    has_roads: bool
    report: JsonObject | None
    location: JsonObject | None


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True)


class JobRequest(_Document):
    """What a job is asked to do; that of the demo has nothing else to say."""


class MapSource(_Document):
    """Where the map comes from: a file of the drive, or an Overpass server where none is named."""

    file: str | None = None


class Near(_Document):
    """Roughly where a drive was."""

    lat_deg: float
    lon_deg: float
    radius_km: float


class IntersectionsJob(JobRequest):
    """Find the intersections of a drive, and score them where a map is given: what of `NewJob` the work needs."""

    config: DetectorConfig
    labels: LabelFolder | None = None
    osm: MapSource | None = None
    georeference: Literal["drive", "map"] = "drive"
    near: Near | None = None
    policy: Policy = "drive"
    tolerance_m: float = 15.0

    @property
    def map_file(self) -> str | None:
        """Path of the map among the files of the drive; None where it is fetched, or there is none."""
        return None if self.osm is None else self.osm.file


class UploadOptions(ReadingOptions):
    """How the files of a drive are read; paths are those among its files."""

    labels: LabelChoice = "auto"
    """Which labels count; auto: all of which there are files."""

    model: str | None = None
    """Name of the network that labels the scans."""


class CommitJob(JobRequest):
    """Check a drive, and reduce it."""

    options: UploadOptions = UploadOptions()
    source: str | None = None
    """Where in object storage the files are, where they are not among those of the drive."""


class UnpackJob(JobRequest):
    """Unpack an archive into a drive."""

    archive: str | None = None
    """Path in the folder of the drive, where version 0.2 put it."""


class Outcome(_Document):
    """What comes of a job."""

    def summary(self) -> StoredSummary:
        """Return the figures for the client: what was given, also where it is None."""
        return cast("StoredSummary", self.model_dump(exclude_unset=True))


class MapScores(_Document):
    """Figures of a report, of thresholds those at 5 m."""

    policy: str
    ace_m: float | None
    precision_at_5: float | None
    recall_at_5: float | None
    f1_at_5: float | None
    nodes_in_zone: int
    nodes_found: int
    map_line: str | None = None  # results of versions before had none
    map_f1: float | None = None  # likewise


class MapPlace(_Document):
    """Where a drive was placed on the map, and how surely."""

    lat_deg: float
    lon_deg: float
    heading_deg: float
    score: float
    position_std_m: float | None
    heading_std_deg: float | None
    seconds: float


class IntersectionsOutcome(Outcome):
    """What was found, and what it took."""

    keyframes: int
    detections: int
    intersections: int
    georeferenced: bool
    seconds: float
    stage_seconds: dict[str, float]
    peak_memory_bytes: int
    location: MapPlace | None
    report: MapScores | None
    has_roads: bool = False
    """Whether its layers hold a map of the roads: those of versions before do not."""
    missing: list[str] = []
    """What beside the intersections could not be made, each with the reason."""
    doubtful_labels_m: list[tuple[float, float]] = []
    """From where to where along the track labels by geometry are doubtful."""
    dropped: JsonObject | None = None
    """Scans that were lost before they came into the drive: `FolderDrive.dropped`."""


class CommitOutcome(Outcome):
    """Whether a drive is sound, and what was kept of it; None where it has errors."""

    ok: bool
    scans: int | None = None
    kept_scans: int | None = None
    reduced_bytes: int | None = None
    seconds: float | None = None
    report: DriveReport | None = Field(None, exclude=True)
    """What the check found; it goes into the row of the drive."""


class FilesOutcome(Outcome):
    """The files that were made for a drive."""

    files: int
    size_bytes: int


# The layers that the service has of each result, as tables: those of its files, and those made of them.

RESULT_LAYERS = {**LAYERS, **DERIVED}
"""By name."""
