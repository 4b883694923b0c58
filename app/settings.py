"""Settings of the service: environment variables ``INTERLOC_*``; `interloc serve` has options for the common ones."""

import base64
import ipaddress
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self
from urllib.parse import urlsplit

from pydantic import BeforeValidator, Field, SecretStr, field_validator, model_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from interloc.storage import check_address

MB = 1024**2
GB = 1024**3

SQLITE_FILE = "interloc.sqlite3"
"""Name of the database in the data folder, where no other is set."""

_MIN_TOKEN_CHARS = 16


def _split(given: object) -> object:
    return [each for part in given.split(",") if (each := part.strip())] if isinstance(given, str) else given


Listed = Annotated[tuple[str, ...], NoDecode, BeforeValidator(_split)]
"""What a text lists, separated by commas."""


class Settings(BaseSettings):
    """How the service runs; every field is read from ``INTERLOC_<NAME>``."""

    model_config = SettingsConfigDict(env_prefix="INTERLOC_", frozen=True, extra="ignore", hide_input_in_errors=True)

    request_work_s: ClassVar[float] = 120.0
    """Maximum time of the work for one request: pictures, exports, looks."""
    max_archive_ratio: ClassVar[float] = 200.0
    """Maximum ratio of unpacked to packed size; labels alone reach more than 100."""
    max_batch_files: ClassVar[int] = 1000
    """Maximum number of files in one multipart request."""
    max_demo_scans: ClassVar[int | None] = None
    """Maximum number of scans of the demo drive; None: all."""
    max_live_sessions: ClassVar[int] = 4
    """Maximum number of live sessions of one client."""
    max_live_message_bytes: ClassVar[int] = 8 * MB
    """Maximum size of one scan of a live session: 12 bytes per point, and its head."""
    live_idle_s: ClassVar[float] = 300.0
    """Time for which a live session waits for its sender, and an ended one is shown."""
    upload_expires_h: ClassVar[float] = 7 * 24.0
    """Time after which an upload expires that nobody has touched."""

    # Where things are.
    data_dir: Path = Field(Path("interloc-data"), description="Folder of drives, results and the default database.")
    database_url: str | None = Field(
        None, description="SQLAlchemy URL, postgresql+psycopg://...; a SQLite file in the data folder by default."
    )
    static_dir: Path | None = Field(None, description="Folder of the page; the one beside the package by default.")

    models: Path | None = Field(
        None, description="Folder of networks, one folder each, by which drives without labels can be labelled."
    )

    # Where it listens.
    host: str = Field(
        "127.0.0.1", description="Address to listen on; every other address than this machine's own needs a token."
    )
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on; 0: any free port.")
    root_path: str = Field("", description="Path under which a reverse proxy shows the service, for example /interloc.")
    public_url: str = Field(
        "",
        description="Address under which people reach the service, for example https://maps.example/interloc: all "
        "full links begin with it. By default the Host of each request and the root path.",
    )
    trusted_proxies: str = Field("127.0.0.1", description="Addresses whose X-Forwarded-* headers are believed.")
    allowed_hosts: Listed = Field(
        (), description="Names under which a reverse proxy shows the service, separated by commas."
    )
    cors_origins: Listed = Field(
        (),
        description="Origins of other web pages that may read the API (GET only), separated by commas, for example "
        "https://maps.example.",
    )
    token: SecretStr | None = Field(
        None, description="An API token; further ones are made with `interloc admin token add`."
    )
    allow_anonymous: bool = Field(False, description="Serve other machines without any token.")

    # Who does the work.
    workers: int | None = Field(None, ge=1, le=256, description="Number of worker processes; one per core by default.")
    dask: str | None = Field(
        None, description="Address of a Dask scheduler that does the work instead, for example tcp://host:8786."
    )
    jobs_at_once: int = Field(
        2, ge=1, le=256, description="Number of jobs worked on at the same time, beside one of each further client."
    )
    max_attempts: int = Field(
        3, ge=1, le=20, description="Number of times that a job is tried whose worker or server dies."
    )
    lease_s: float = Field(
        30.0,
        ge=1.0,
        le=3600.0,
        description="Time in seconds after which a job is taken over from a server that gives no sign of life.",
    )
    job_stage_s: float = Field(
        1800.0,
        gt=0,
        description="Maximum time in seconds of one stage of a job: its preparation, one part of it, or its end; a job "
        "as a whole may take twelve times as long.",
    )
    worker_memory_bytes: int | None = Field(
        None,
        ge=256 * MB,
        description="Maximum memory of one worker process (Linux); by default an equal share of three quarters of the "
        "memory of the machine or container, at least 1 GB.",
    )

    # Limits.
    max_file_bytes: int = Field(
        256 * MB, ge=1, description="Maximum size of one uploaded file; a request with several may have twice as much."
    )
    max_recording_bytes: int = Field(
        32 * GB, ge=1, description="Maximum size of one uploaded ROS bag, LAS or LAZ file."
    )
    max_drive_bytes: int = Field(
        64 * GB, ge=1, description="Maximum size of all files of a drive, unpacked, and of an archive."
    )
    max_drive_files: int = Field(200_000, ge=1, description="Maximum number of files of a drive.")
    min_free_bytes: int = Field(1 * GB, ge=0, description="Free disk space below which no upload and no job begins.")
    max_queued_jobs: int = Field(100, ge=1, description="Maximum number of jobs of one client that wait or run.")
    trash_h: float = Field(
        72.0,
        ge=0,
        le=24 * 365,
        description="Time in hours for which deleted drives can be restored; 0: they are gone at once.",
    )

    # What the page may show and fetch.
    overpass_url: str = Field(
        "https://overpass-api.de/api",
        description="Address of the Overpass server that jobs may fetch the map from; empty for none.",
    )
    tile_url: str | None = Field(
        "https://tile.openstreetmap.org/{z}/{x}/{y}.png",
        description="Address pattern of the map tiles that the page offers; empty for none.",
    )
    tile_attribution: str = Field("© OpenStreetMap contributors", description="Attribution shown on the map tiles.")

    # Whom it calls.
    webhook_hosts: Listed = Field(
        (),
        description="Hosts that may be told of jobs (`subscriber`), separated by commas: names or addresses, for "
        "example hooks.example.org,10.1.0.7. Empty: none.",
    )
    webhook_secret: SecretStr | None = Field(
        None,
        description="By which calls of subscribers are signed: `whsec_` and 24 to 64 bytes in Base64; needed with "
        "`WEBHOOK_HOSTS`.",
    )

    # What it reads elsewhere.
    sources: Listed = Field(
        (),
        description="Prefixes in object storage that clients may have drives read from (`source`), separated by "
        "commas, for example s3://bucket/drives; the service reads there by its own credentials. Empty: none.",
    )

    # What is logged.
    log_format: Literal["json", "text"] = Field(
        "json", description="Format of the log: json (one object per line) or text."
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info", description="Lowest level that is logged: debug, info, warning or error; health checks are debug."
    )

    @field_validator("token")
    @classmethod
    def _check_token(cls, token: SecretStr | None) -> SecretStr | None:
        value = token.get_secret_value() if token is not None else ""
        if token is not None and (len(value) < _MIN_TOKEN_CHARS or not value.isascii() or not value.isprintable()):
            raise ValueError(
                f"a token has {_MIN_TOKEN_CHARS} or more printable ASCII characters: shorter ones can be guessed"
            )
        return token

    @model_validator(mode="after")
    def _check_webhooks(self) -> Self:
        if self.webhook_hosts and not 24 <= len(self.webhook_key) <= 64:
            raise ValueError(
                "WEBHOOK_HOSTS needs a WEBHOOK_SECRET to sign by: whsec_ and 24 to 64 bytes in Base64, for example "
                "from `python -c \"import base64, secrets; print('whsec_' + "
                'base64.b64encode(secrets.token_bytes(32)).decode())"`'
            )
        return self

    @field_validator("sources")
    @classmethod
    def _check_sources(cls, sources: tuple[str, ...]) -> tuple[str, ...]:
        for each in sources:
            check_address(each)
        return sources

    @field_validator("webhook_hosts", "allowed_hosts")
    @classmethod
    def _check_hosts(cls, hosts: tuple[str, ...]) -> tuple[str, ...]:
        for host in hosts:
            if "/" in host or host.count(":") == 1:
                raise ValueError(f"{host!r} is not the name or address of a host: list each, without https:// or port")
        return tuple(host.lower().strip("[]") for host in hosts)  # as they are in addresses

    @property
    def webhook_key(self) -> bytes:
        """The secret as bytes; empty where there is none, or it is not Base64."""
        text = "" if self.webhook_secret is None else self.webhook_secret.get_secret_value().removeprefix("whsec_")
        try:
            return base64.b64decode(text, validate=True)
        except ValueError:
            return b""

    @field_validator("root_path")
    @classmethod
    def _check_root_path(cls, path: str) -> str:
        path = path.rstrip("/")
        if path and not path.startswith("/"):
            raise ValueError("a path begins with /, for example /interloc")
        return path

    @model_validator(mode="before")
    @classmethod
    def _take_root_path_of_address(cls, given: dict[str, Any]) -> dict[str, Any]:
        """Take the root path of the public address, unless it is given, too."""
        parts = urlsplit(str(given.get("public_url", "")))
        path = parts.path.rstrip("/")
        return {"root_path": path, **given} if path and parts.netloc else given

    @field_validator("public_url", "overpass_url")
    @classmethod
    def _check_address(cls, address: str) -> str:
        parts = urlsplit(address)
        if address and (parts.scheme not in {"http", "https"} or not parts.netloc or parts.query or parts.fragment):
            raise ValueError(f"{address!r} is not an address: expected for example https://maps.example/interloc")
        return address.rstrip("/")

    @field_validator("cors_origins")
    @classmethod
    def _check_origins(cls, origins: tuple[str, ...]) -> tuple[str, ...]:
        for origin in origins:
            parts = urlsplit(origin)
            if parts.scheme not in {"http", "https"} or f"{parts.scheme}://{parts.netloc}" != origin or "*" in origin:
                raise ValueError(
                    f"{origin!r} is not an origin: expected https://maps.example or http://localhost:3000, without "
                    "a path or a slash at the end; * is not taken"
                )
        return origins

    @property
    def job_s(self) -> float:
        """Maximum time of a job from its start."""
        return 12 * self.job_stage_s

    @property
    def max_batch_bytes(self) -> int:
        """Maximum size of one multipart request."""
        return 2 * self.max_file_bytes

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can connect."""
        try:
            return self.host == "localhost" or ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def sqlalchemy_url(self) -> str:
        """Address of the database."""
        return self.database_url or f"sqlite:///{(self.data_dir.absolute() / SQLITE_FILE).as_posix()}"
