"""The tables of 0.3.0: webhooks, maps of many drives and their files, features as rows, which a start fills in."""

import sqlalchemy as sa
from alembic import op

from app.store.models import Base

revision = "0013"
down_revision = "0006"


def upgrade() -> None:
    """Go to this version; whoever changes one of the tables that are new in it writes its columns of 0.3.0 out here."""
    op.add_column("drives", sa.Column("pinned_job", sa.String(length=255)))
    op.add_column("drives", sa.Column("source", sa.Text()))
    op.drop_table("feature_columns")
    op.drop_table("feature_chunks")
    op.drop_index("ix_drive_files_folded", "drive_files")
    op.drop_column("drive_files", "folded")
    Base.metadata.create_all(op.get_bind())
