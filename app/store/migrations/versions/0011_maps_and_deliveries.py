"""Senders of files, pinned jobs, sources of drives, what subscribers are told, maps of many drives."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0006"


def _text(name: str, length: int = 255, *, nullable: bool = True) -> sa.Column[str]:
    return sa.Column(name, sa.String(length=length), nullable=nullable)


def _json(name: str, *, nullable: bool = True) -> sa.Column[object]:
    return sa.Column(name, sa.JSON(none_as_null=True), nullable=nullable)


def _map_id() -> sa.Column[str]:
    return _text("map_id", nullable=False)


def _of_map() -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(["map_id"], ["maps.id"], ondelete="CASCADE")


def upgrade() -> None:
    """Go to this version, but for the index of features, which the next one makes anew."""
    op.add_column("drives", _text("pinned_job"))
    op.add_column("drives", sa.Column("source", sa.Text()))
    op.add_column("drive_files", _text("sender"))
    known = sa.text("sender IS NOT NULL")
    op.create_index("ix_drive_files_sender", "drive_files", ["sender"], sqlite_where=known, postgresql_where=known)
    op.create_table(
        "deliveries",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        *(_text(name, nullable=False) for name in ("id", "job_id", "type")),
        *(sa.Column(name, sa.Text(), nullable=False) for name in ("uri", "host", "body")),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("next_at", sa.Float()),
        sa.Column("error", sa.Text()),
        sa.Column("delivered_at", sa.Float()),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("number"),
        sa.UniqueConstraint("id"),
    )
    op.create_index("ix_deliveries_next", "deliveries", ["next_at"])
    op.create_index("ix_deliveries_job", "deliveries", ["job_id"])
    op.create_table(
        "maps",
        *(_text(name, nullable=False) for name in ("id", "name", "owner")),
        sa.Column("holds_all", sa.Boolean(), nullable=False),
        sa.Column("created_at", sa.Float(), nullable=False),
        sa.Column("revision", sa.BigInteger(), nullable=False),
        sa.Column("merged_at", sa.Float()),
        sa.Column("epsg", sa.BigInteger()),
        _json("summary"),
        _text("audited"),
        _json("audit"),
        _text("lease_owner"),
        sa.Column("lease_until", sa.Float()),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_table(
        "map_drives",
        _map_id(),
        _text("drive_id", nullable=False),
        sa.Column("is_member", sa.Boolean()),
        _text("label"),
        _text("job_id"),
        sa.Column("problem", sa.Text()),
        _of_map(),
        sa.PrimaryKeyConstraint("map_id", "drive_id"),
    )
    op.create_table(
        "map_places",
        _map_id(),
        _text("uid", 32, nullable=False),
        *(sa.Column(name, sa.Float(), nullable=False) for name in ("lon", "lat")),
        _of_map(),
        sa.PrimaryKeyConstraint("map_id", "uid"),
    )
    op.create_table(
        "map_verdicts",
        _text("id", nullable=False),
        _map_id(),
        _text("finding", 64, nullable=False),
        sa.Column("at", sa.Float(), nullable=False),
        _json("judgement", nullable=False),
        _of_map(),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index("ix_map_verdicts", "map_verdicts", ["map_id", "finding"])
