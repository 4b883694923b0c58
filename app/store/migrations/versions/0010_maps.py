"""Maps of many drives, what people said of their findings; the index holds their features, too."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"


def _of_map() -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(["map_id"], ["maps.id"], ondelete="CASCADE")


def _map_id() -> sa.Column[str]:
    return sa.Column("map_id", sa.String(length=255), nullable=False)


def _text(name: str, length: int = 255, *, nullable: bool = True) -> sa.Column[str]:
    return sa.Column(name, sa.String(length=length), nullable=nullable)


def _make_index(*, of_maps: bool) -> None:
    """Make the tables of the index anew, empty: a start fills them in."""
    op.drop_table("feature_columns")
    op.drop_table("feature_chunks")
    more = [_text("map_id")] if of_maps else []
    constraints = [_of_map(), sa.UniqueConstraint("map_id", "layer", "number", name="uq_feature_chunks_of_map")]
    op.create_table(
        "feature_chunks",
        sa.Column("id", sa.Integer(), autoincrement=True, nullable=False),
        _text("job_id", nullable=of_maps),
        *more,
        _text("layer", nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("count", sa.Integer(), nullable=False),
        _text("preset"),
        _text("labels"),
        *(
            sa.Column(name, sa.Float(), nullable=True)
            for name in ("west", "south", "east", "north", "first_time", "last_time")
        ),
        sa.Column("attribution", sa.Text(), nullable=False),
        _text("license"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id"),
        sa.UniqueConstraint("job_id", "layer", "number", name="uq_feature_chunks"),
        *(constraints if of_maps else []),
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


def upgrade() -> None:
    """Go to this version; the server makes its map, and fills in the index."""
    op.create_table(
        "maps",
        _text("id", nullable=False),
        _text("name", nullable=False),
        _text("owner", nullable=False),
        sa.Column("holds_all", sa.Boolean(), nullable=False),
        sa.Column("created_at", sa.Float(), nullable=False),
        sa.Column("revision", sa.BigInteger(), nullable=False),
        sa.Column("merged_at", sa.Float(), nullable=True),
        sa.Column("epsg", sa.BigInteger(), nullable=True),
        sa.Column("summary", sa.JSON(none_as_null=True), nullable=True),
        _text("audited"),
        sa.Column("audit", sa.JSON(none_as_null=True), nullable=True),
        _text("lease_owner"),
        sa.Column("lease_until", sa.Float(), nullable=True),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_table(
        "map_drives",
        _map_id(),
        _text("drive_id", nullable=False),
        sa.Column("is_member", sa.Boolean(), nullable=True),
        _text("label"),
        _text("job_id"),
        sa.Column("problem", sa.Text(), nullable=True),
        _of_map(),
        sa.PrimaryKeyConstraint("map_id", "drive_id"),
    )
    op.create_table(
        "map_places",
        _map_id(),
        _text("uid", 32, nullable=False),
        sa.Column("lon", sa.Float(), nullable=False),
        sa.Column("lat", sa.Float(), nullable=False),
        _of_map(),
        sa.PrimaryKeyConstraint("map_id", "uid"),
    )
    op.create_table(
        "map_verdicts",
        _text("id", nullable=False),
        _map_id(),
        _text("finding", 64, nullable=False),
        sa.Column("at", sa.Float(), nullable=False),
        sa.Column("judgement", sa.JSON(none_as_null=True), nullable=False),
        _of_map(),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index("ix_map_verdicts", "map_verdicts", ["map_id", "finding"])
    _make_index(of_maps=True)


def downgrade() -> None:
    """Go back to the version before."""
    _make_index(of_maps=False)
    for table in ("map_verdicts", "map_places", "map_drives", "maps"):
        op.drop_table(table)
