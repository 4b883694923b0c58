"""The tables of version 0.3.0: features are rows; a start of the server fills them in."""

import sqlalchemy as sa
from alembic import op

from app.store.features import make_tables

revision = "0012"
down_revision = "0011"


def _text(name: str, *, nullable: bool = True) -> sa.Column[str]:
    return sa.Column(name, sa.String(length=255), nullable=nullable)


def upgrade() -> None:
    """Go to this version."""
    op.drop_table("feature_columns")
    op.drop_table("feature_chunks")
    op.create_table(
        "feature_layers",
        sa.Column("id", sa.Integer(), autoincrement=True, nullable=False),
        _text("job_id"),
        _text("map_id"),
        _text("layer", nullable=False),
        sa.Column("count", sa.Integer(), nullable=False),
        _text("preset"),
        _text("labels"),
        *(sa.Column(name, sa.Float()) for name in ("west", "south", "east", "north", "width")),
        *(sa.Column(name, sa.Float()) for name in ("first_time", "last_time")),
        sa.Column("outline", sa.Text()),
        sa.Column("attribution", sa.Text(), nullable=False),
        _text("license"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id"),
        sa.UniqueConstraint("job_id", "layer", name="uq_feature_layers"),
        sa.UniqueConstraint("map_id", "layer", name="uq_feature_layers_of_map"),
        sqlite_autoincrement=True,
    )
    make_tables(op.get_bind())
