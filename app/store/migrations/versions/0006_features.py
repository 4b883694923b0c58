"""The index of the features of all results."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Go to this version; the clean-up fills in the features of jobs that have ended before."""
    op.create_table(
        "feature_chunks",
        sa.Column("id", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("job_id", sa.String(length=255), nullable=False),
        sa.Column("layer", sa.String(length=255), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("count", sa.Integer(), nullable=False),
        sa.Column("preset", sa.String(length=255), nullable=True),
        sa.Column("labels", sa.String(length=255), nullable=True),
        *(sa.Column(name, sa.Float(), nullable=True) for name in ("west", "south", "east", "north")),
        *(sa.Column(name, sa.Float(), nullable=True) for name in ("first_time", "last_time")),
        sa.Column("attribution", sa.Text(), nullable=False),
        sa.Column("license", sa.String(length=255), nullable=True),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id"),
        sa.UniqueConstraint("job_id", "layer", "number", name="uq_feature_chunks"),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "feature_columns",
        sa.Column("chunk_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("content", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["chunk_id"], ["feature_chunks.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("chunk_id", "name"),
    )


def downgrade() -> None:
    """Go back to the version before."""
    op.drop_table("feature_columns")
    op.drop_table("feature_chunks")
