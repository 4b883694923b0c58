"""The tables: drives, their files, jobs, the index of their features, tokens, and the id of the installation."""

import secrets
from collections.abc import Collection

from pydantic import BaseModel
from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    Connection,
    Float,
    ForeignKey,
    Index,
    Integer,
    String,
    Table,
    Text,
    UniqueConstraint,
    func,
    inspect,
    or_,
)
from sqlalchemy import delete as delete_rows
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

from app.states import DriveState, JobState, Scope
from app.work.requests import RESULT_LAYERS, StoredRequest, StoredSummary
from interloc.arrays import JsonObject
from interloc.osm.untrusted import MAP_ENDINGS
from interloc.output.layers import CITY_LAYERS, Layer


def new_id() -> str:
    """Return an id that cannot be guessed."""
    return secrets.token_hex(8)


class Base(DeclarativeBase):
    """All times are seconds since 1970 by the clock of the database."""

    type_annotation_map = {  # noqa: RUF012
        **dict.fromkeys((JsonObject, StoredRequest, StoredSummary), JSON(none_as_null=True)),
        str: String(255),
        int: BigInteger,
        float: Float,
    }


def columns_for(model: type[BaseModel], row: Base, *, but: Collection[str] = ()) -> JsonObject:
    """Return the columns of a row that a model has under the same names, except some; times become dates there."""
    shared = model.model_fields.keys() & row.__table__.columns.keys()
    return {name: getattr(row, name) for name in shared.difference(but)}


class Drive(Base):
    """A drive that is being uploaded, or is ready for jobs."""

    __tablename__ = "drives"

    id: Mapped[str] = mapped_column(primary_key=True, default=new_id)
    name: Mapped[str]
    owner: Mapped[str]
    state: Mapped[str] = mapped_column(default=DriveState.UPLOADING)
    options: Mapped[JsonObject] = mapped_column(default=dict)
    """How its files are read: label_scheme, pose_frame, layout, oxts."""
    keep_raw: Mapped[bool] = mapped_column(default=False)
    report: Mapped[JsonObject | None]
    """The `DriveReport` of its last commit, successful or not."""
    file_count: Mapped[int] = mapped_column(default=0)
    size_bytes: Mapped[int] = mapped_column(default=0)
    """Size of the files as uploaded."""
    stored_bytes: Mapped[int] = mapped_column(default=0)
    """Size of what is kept of them."""
    created_at: Mapped[float]
    touched_at: Mapped[float]
    deleted_at: Mapped[float | None]
    """Since when it lies in the trash; everything but the trash treats it as absent then."""
    deleted_by: Mapped[str | None]
    """The client that deleted it; None for an upload that expired."""
    idempotency_key: Mapped[str | None]
    request_sha256: Mapped[str | None] = mapped_column(String(64))
    """SHA-256 of the request that made it under its key: its options may change with a commit."""
    note: Mapped[str | None] = mapped_column(Text)
    """What somebody wrote about it."""
    pinned_job: Mapped[str | None]
    """Id of the job that stands for it; None, or one that is gone: see `app.jobs.view`."""
    source: Mapped[str | None] = mapped_column(Text)
    """Address in object storage that its files are read from; None where they are sent."""
    west: Mapped[float | None]
    """Where it is once it is ready, degrees; None without georeference, and for drives of older versions at first."""
    south: Mapped[float | None]
    east: Mapped[float | None]
    north: Mapped[float | None]

    __table_args__ = (
        Index("ix_drives_idempotency", "owner", "idempotency_key", unique=True),
        Index("ix_drives_state_touched", "state", "touched_at"),
    )


class DriveFile(Base):
    """An uploaded file; it stays listed when the drive was reduced, so that an upload can be resumed."""

    __tablename__ = "drive_files"

    drive_id: Mapped[str] = mapped_column(ForeignKey("drives.id", ondelete="CASCADE"), primary_key=True)
    path: Mapped[str] = mapped_column(String(512), primary_key=True)
    size_bytes: Mapped[int]
    sha256: Mapped[str] = mapped_column(String(64))
    mtime_ns: Mapped[int | None]
    """When its bytes were written: another time, or size, means other bytes. None in rows of older versions."""


IS_MAP = or_(*(func.lower(DriveFile.path).endswith(end) for end in MAP_ENDINGS))
"""That a file is an OpenStreetMap file by its name."""


class Job(Base):
    """A piece of work: find intersections, or check and unpack an upload. Durable, leased by one server at a time."""

    __tablename__ = "jobs"

    id: Mapped[str] = mapped_column(primary_key=True, default=new_id)
    kind: Mapped[str]
    """See `JobKind`."""
    drive_id: Mapped[str] = mapped_column(ForeignKey("drives.id", ondelete="CASCADE"))
    owner: Mapped[str]
    request: Mapped[StoredRequest]
    """As it was sent; its `name` is only what the job was called at first."""
    name: Mapped[str | None]
    """None: it is called by what it was asked for, see `app.jobs.view.title_of`."""
    note: Mapped[str | None] = mapped_column(Text)
    """What somebody wrote about it."""
    idempotency_key: Mapped[str | None]

    state: Mapped[str] = mapped_column(default=JobState.ACCEPTED)
    stage: Mapped[str] = mapped_column(default="waiting")
    message: Mapped[str | None] = mapped_column(Text)
    """What it is waiting for, for the client."""
    done: Mapped[int] = mapped_column(default=0)
    total: Mapped[int | None]
    """Keyframes (intersections), scans (commit), files (unpack)."""
    version: Mapped[int] = mapped_column(default=1)
    """Number of changes; the id of the events."""
    error: Mapped[JsonObject | None]
    """The problem document of its failure."""
    summary: Mapped[StoredSummary | None]
    """The outcome as a few figures, with timings and memory."""

    created_at: Mapped[float]
    started_at: Mapped[float | None]
    finished_at: Mapped[float | None]
    deleted_at: Mapped[float | None]
    """Set while it is being purged; that its drive lies in the trash is not written here."""
    deleted_by: Mapped[str | None]

    attempts: Mapped[int] = mapped_column(Integer, default=0)
    lease_owner: Mapped[str | None]
    lease_until: Mapped[float | None]
    cancel_requested: Mapped[bool] = mapped_column(default=False)

    __table_args__ = (
        UniqueConstraint("owner", "idempotency_key", name="uq_jobs_idempotency"),
        Index("ix_jobs_state_created", "state", "created_at"),
        Index("ix_jobs_drive", "drive_id"),
    )


class CityMap(Base):
    """A map of many drives. What it shows is in its folder, and can be made anew from the results of its drives."""

    __tablename__ = "maps"

    id: Mapped[str] = mapped_column(primary_key=True, default=new_id)
    name: Mapped[str]
    owner: Mapped[str]
    holds_all: Mapped[bool] = mapped_column(default=False)
    """Whether all drives belong to it but those that were taken out: the map of the server."""
    created_at: Mapped[float]
    revision: Mapped[int] = mapped_column(default=0)
    """How many times it was brought up to date."""
    merged_at: Mapped[float | None]
    summary: Mapped[JsonObject | None]
    """Figures of its `city.json`."""
    audited: Mapped[str | None]
    """Of which revision, OSM file and verdicts its audit is."""
    audit: Mapped[JsonObject | None]
    """Its `audit.json`; or the problem that it had."""
    lease_owner: Mapped[str | None]
    lease_until: Mapped[float | None]
    osm: Mapped[str | None]
    """Name of its own OSM file, in its folder."""
    osm_bytes: Mapped[int | None]


class MapDrive(Base):
    """A drive that belongs to a map, or is on it, or was taken out of it."""

    __tablename__ = "map_drives"

    map_id: Mapped[str] = mapped_column(ForeignKey("maps.id", ondelete="CASCADE"), primary_key=True)
    drive_id: Mapped[str] = mapped_column(primary_key=True)
    """It may be gone: then it is taken off the map."""
    is_member: Mapped[bool | None]
    """None: it belongs to the map because all drives do."""
    label: Mapped[str | None]
    """Name of the drive on the map."""
    job_id: Mapped[str | None]
    """Job whose result the map holds, or refuses."""
    problem: Mapped[str | None] = mapped_column(Text)
    """Why it does not hold it."""


class MapVerdict(Base):
    """What somebody said of a finding of a map; the last one of a finding counts."""

    __tablename__ = "map_verdicts"

    id: Mapped[str] = mapped_column(primary_key=True, default=new_id)
    map_id: Mapped[str] = mapped_column(ForeignKey("maps.id", ondelete="CASCADE"))
    finding: Mapped[str] = mapped_column(String(64))
    at: Mapped[float]
    judgement: Mapped[JsonObject]
    """See `interloc.city.models.Judgement`."""

    __table_args__ = (Index("ix_map_verdicts", "map_id", "finding"),)


class Delivery(Base):
    """What a subscriber is told of a job: see `app.jobs.webhooks`."""

    __tablename__ = "deliveries"

    number: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(unique=True)
    """Of the message, the same at each try."""
    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"))
    type: Mapped[str]
    uri: Mapped[str] = mapped_column(Text)
    host: Mapped[str] = mapped_column(Text)
    body: Mapped[str] = mapped_column(Text)
    attempts: Mapped[int] = mapped_column(Integer, default=0)
    next_at: Mapped[float | None]
    """When it is tried next; None: it was delivered, or given up."""
    error: Mapped[str | None] = mapped_column(Text)
    """Why the last try failed."""
    delivered_at: Mapped[float | None]

    __table_args__ = (Index("ix_deliveries_next", "next_at"), Index("ix_deliveries_job", "job_id"))


class FeatureLayer(Base):
    """A layer of a result or of a map of many drives; its features are rows of the table of the layer.

    Successful jobs with longitude and latitude have one for each layer of their result, also for those without
    features. All of it can be made anew from the results at any time: see `make_tables`.
    """

    __tablename__ = "feature_layers"

    id: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=True)
    """Pages of features are in this order; none is used twice."""
    job_id: Mapped[str | None] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"))
    """None: it is of a map of many drives."""
    map_id: Mapped[str | None] = mapped_column(ForeignKey("maps.id", ondelete="CASCADE"))
    layer: Mapped[str]
    count: Mapped[int] = mapped_column(Integer)
    """Number of features."""
    preset: Mapped[str | None]
    labels: Mapped[str | None]
    west: Mapped[float | None]
    """Box around the features, degrees; across the 180th meridian east is more than 180."""
    south: Mapped[float | None]
    east: Mapped[float | None]
    north: Mapped[float | None]
    width: Mapped[float | None]
    """Of the widest feature, degrees of longitude."""
    first_time: Mapped[float | None]
    last_time: Mapped[float | None]
    attribution: Mapped[str] = mapped_column(Text)
    license: Mapped[str | None]

    __table_args__ = (
        UniqueConstraint("job_id", "layer", name="uq_feature_layers"),
        UniqueConstraint("map_id", "layer", name="uq_feature_layers_of_map"),
        {"sqlite_autoincrement": True},
    )


class Token(Base):
    """An API token; only its SHA-256 is kept."""

    __tablename__ = "tokens"

    name: Mapped[str] = mapped_column(primary_key=True)
    sha256: Mapped[str] = mapped_column(String(64), unique=True)
    created_at: Mapped[float]
    scope: Mapped[str] = mapped_column(default=Scope.WRITE, server_default=Scope.WRITE.value)
    expires_at: Mapped[float | None]
    last_used_at: Mapped[float | None]
    """To within some minutes."""
    max_bytes: Mapped[int | None]
    """Bytes that its drives may keep on disk."""
    max_jobs: Mapped[int | None]
    """Jobs of each kind that may wait or run."""


class Installation(Base):
    """The id that this database shares with its data folder, in one row: see `app.store.installation`."""

    __tablename__ = "installation"

    id: Mapped[str] = mapped_column(primary_key=True)
    created_at: Mapped[float]


# The tables of features: a layer is a table, as in a GeoPackage, and its properties are the columns. Filters are SQL
# over typed columns; properties as JSON took ten times as long. The rows of a layer of a result lie side by side, by
# the key, and one index finds them by their west: a box is a range of it, since `FeatureLayer.width` says how far to
# the west of a box a feature can begin that touches it. The tables hold nothing that the results do not: where
# properties differ from those of this version they are made anew, empty, and a start of the server fills them in.

_TEXT = Text().with_variant(Text(collation="C"), "postgresql")  # compared by code points, as SQLite does
_TYPES: JsonObject = {"int": BigInteger, "float": Float, "bool": Boolean, "text": _TEXT, "time": _TEXT}
SOUGHT = ("outcome", "osm_id")
"""Properties that have an index: what features are asked for by most."""
_SEARCHED = "reason"
"""The text that is searched for words, which few features have: its index holds no others."""


def _table(prefix: str, layer: Layer) -> Table:
    """Return the table of a layer; lists and geometries are JSON, those of points only their west and south."""
    name = f"{prefix}_{layer.name}"
    is_point = layer.geometry == "Point"
    box = ["west", "south"] if is_point else ["west", "south", "east", "north"]
    attributes = layer.attributes
    table = Table(
        name,
        Base.metadata,
        Column("layer_id", Integer, ForeignKey(FeatureLayer.id, ondelete="CASCADE"), primary_key=True),
        Column("number", Integer, primary_key=True, autoincrement=False),
        *(Column(side, Float) for side in box),
        *(Column(each.name, _TYPES[each.kind]) for each in attributes if each.kind != "list"),
        Column("feature_id", _TEXT, nullable=False),
        *(Column(each.name, Text) for each in attributes if each.kind == "list"),
        *([] if is_point else [Column("geometry", Text)]),
        Index(f"ix_{name}", "layer_id", *box),
        *(Index(f"ix_{name}_{each}", "layer_id", each, *box) for each in SOUGHT if each in layer.fields),
        sqlite_with_rowid=False,
    )
    if _SEARCHED in table.c:
        own, has_text = table.c[_SEARCHED], table.c[_SEARCHED].is_not(None)
        Index(f"ix_{name}_{_SEARCHED}", table.c.layer_id, own, sqlite_where=has_text, postgresql_where=has_text)
    return table


OF_RESULTS = {name: _table("features", layer) for name, layer in RESULT_LAYERS.items()}
OF_MAPS = {name: _table("features_of_map", layer) for name, layer in CITY_LAYERS.items()}
_TABLES = {table.name: table for table in (*OF_RESULTS.values(), *OF_MAPS.values())}


def make_tables(connection: Connection) -> None:
    """Make the tables anew, empty, unless all are there with the columns of this version."""
    there = inspect(connection).get_multi_columns(filter_names=list(_TABLES))
    columns = {str(name): {each["name"] for each in found} for (_, name), found in there.items()}
    if columns != {name: set(table.columns.keys()) for name, table in _TABLES.items()}:
        Base.metadata.drop_all(connection, tables=list(_TABLES.values()))
        connection.execute(delete_rows(FeatureLayer))
        Base.metadata.create_all(connection, tables=list(_TABLES.values()))
