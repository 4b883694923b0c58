"""The tables of version 0.2.0, the oldest one whose databases are opened."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = None


def _text(name: str, length: int = 255, *, nullable: bool = True) -> sa.Column[str]:
    return sa.Column(name, sa.String(length=length), nullable=nullable)


def _json(name: str, *, nullable: bool = True) -> sa.Column[object]:
    return sa.Column(name, sa.JSON(none_as_null=True), nullable=nullable)


def _number(name: str, *, nullable: bool = True) -> sa.Column[int]:
    return sa.Column(name, sa.BigInteger(), nullable=nullable)


def _time(name: str, *, nullable: bool = True) -> sa.Column[float]:
    return sa.Column(name, sa.Float(), nullable=nullable)


def upgrade() -> None:
    """Make the tables."""
    op.create_table(
        "drives",
        *(_text(name, nullable=False) for name in ("id", "name", "owner", "state")),
        _json("options", nullable=False),
        sa.Column("keep_raw", sa.Boolean(), nullable=False),
        _json("report"),
        *(_number(name, nullable=False) for name in ("file_count", "size_bytes", "stored_bytes")),
        *(_time(name, nullable=False) for name in ("created_at", "touched_at")),
        _time("deleted_at"),
        _text("deleted_by"),
        _text("idempotency_key"),
        _text("request_sha256", 64),
        sa.Column("note", sa.Text()),
        *(sa.Column(name, sa.Float()) for name in ("west", "south", "east", "north")),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index("ix_drives_state_touched", "drives", ["state", "touched_at"])
    op.create_index("ix_drives_idempotency", "drives", ["owner", "idempotency_key"], unique=True)
    op.create_table(
        "drive_files",
        _text("drive_id", nullable=False),
        _text("path", 512, nullable=False),
        _number("size_bytes", nullable=False),
        _text("sha256", 64, nullable=False),
        _number("mtime_ns"),
        _text("folded", 32),
        sa.ForeignKeyConstraint(["drive_id"], ["drives.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("drive_id", "path"),
    )
    known = sa.text("folded IS NOT NULL")
    op.create_index(
        "ix_drive_files_folded", "drive_files", ["drive_id", "folded"], sqlite_where=known, postgresql_where=known
    )
    op.create_table(
        "jobs",
        *(_text(name, nullable=False) for name in ("id", "kind", "drive_id", "owner")),
        _json("request", nullable=False),
        _text("name"),
        sa.Column("note", sa.Text()),
        _text("idempotency_key"),
        *(_text(name, nullable=False) for name in ("state", "stage")),
        sa.Column("message", sa.Text()),
        _number("done", nullable=False),
        _number("total"),
        _number("version", nullable=False),
        *(_json(name) for name in ("error", "summary")),
        _time("created_at", nullable=False),
        *(_time(name) for name in ("started_at", "finished_at", "deleted_at")),
        _text("deleted_by"),
        sa.Column("attempts", sa.Integer(), nullable=False),
        _text("lease_owner"),
        _time("lease_until"),
        sa.Column("cancel_requested", sa.Boolean(), nullable=False),
        sa.ForeignKeyConstraint(["drive_id"], ["drives.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id"),
        sa.UniqueConstraint("owner", "idempotency_key", name="uq_jobs_idempotency"),
    )
    op.create_index("ix_jobs_drive", "jobs", ["drive_id"])
    op.create_index("ix_jobs_state_created", "jobs", ["state", "created_at"])
    op.create_table(
        "tokens",
        _text("name", nullable=False),
        _text("sha256", 64, nullable=False),
        _time("created_at", nullable=False),
        sa.Column("scope", sa.String(length=255), server_default="write", nullable=False),
        *(_time(name) for name in ("expires_at", "last_used_at")),
        *(_number(name) for name in ("max_bytes", "max_jobs")),
        sa.PrimaryKeyConstraint("name"),
        sa.UniqueConstraint("sha256"),
    )
    op.create_table(
        "installation",
        _text("id", nullable=False),
        _time("created_at", nullable=False),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_table(
        "feature_chunks",
        sa.Column("id", sa.Integer(), autoincrement=True, nullable=False),
        *(_text(name, nullable=False) for name in ("job_id", "layer")),
        *(sa.Column(name, sa.Integer(), nullable=False) for name in ("number", "count")),
        *(_text(name) for name in ("preset", "labels")),
        *(_time(name) for name in ("west", "south", "east", "north", "first_time", "last_time")),
        sa.Column("attribution", sa.Text(), nullable=False),
        _text("license"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id"),
        sa.UniqueConstraint("job_id", "layer", "number", name="uq_feature_chunks"),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "feature_columns",
        sa.Column("chunk_id", sa.Integer(), autoincrement=False, nullable=False),
        _text("name", 64, nullable=False),
        sa.Column("content", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["chunk_id"], ["feature_chunks.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("chunk_id", "name"),
    )
