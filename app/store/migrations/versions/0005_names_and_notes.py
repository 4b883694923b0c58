"""Names of jobs beside their requests, and notes of drives and jobs."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"

_jobs = sa.table("jobs", sa.column("id", sa.String), sa.column("request", sa.JSON), sa.column("name", sa.String))


def upgrade() -> None:
    """Go to this version; a job keeps the name that its request gave it."""
    op.add_column("drives", sa.Column("note", sa.Text(), nullable=True))
    op.add_column("jobs", sa.Column("name", sa.String(length=255), nullable=True))
    op.add_column("jobs", sa.Column("note", sa.Text(), nullable=True))
    op.execute(_jobs.update().values(name=_jobs.c.request["name"].as_string()))


def downgrade() -> None:
    """Go back to the version before."""
    op.drop_column("jobs", "note")
    op.drop_column("jobs", "name")
    op.drop_column("drives", "note")
