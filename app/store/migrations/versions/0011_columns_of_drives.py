"""Pinned jobs, sources of drives: of development between 0.2.0 and 0.3.0."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0006"


def upgrade() -> None:
    """Go to this version; the tables that came with it are made by the last one."""
    op.add_column("drives", sa.Column("pinned_job", sa.String(length=255)))
    op.add_column("drives", sa.Column("source", sa.Text()))
