"""The tables of version 0.3.0: senders of files, pinned jobs, sources, webhooks, maps of many drives, features as rows.

A start of the server fills in the features.
"""

import sqlalchemy as sa
from alembic import op

from app.store.models import Base

revision = "0013"
down_revision = "0006"


def upgrade() -> None:
    """Go to this version; whoever changes one of the tables that are new in it writes its columns of 0.3.0 out here."""
    op.add_column("drives", sa.Column("pinned_job", sa.String(length=255)))
    op.add_column("drives", sa.Column("source", sa.Text()))
    op.add_column("drive_files", sa.Column("sender", sa.String(length=255)))
    known = sa.text("sender IS NOT NULL")
    op.create_index("ix_drive_files_sender", "drive_files", ["sender"], sqlite_where=known, postgresql_where=known)
    op.drop_table("feature_columns")
    op.drop_table("feature_chunks")
    Base.metadata.create_all(op.get_bind())
