"""The tables of version 0.3.0: webhooks, maps of many drives and their files, features, which a start fills in."""

import sqlalchemy as sa
from alembic import op

from app.store.models import Base

revision = "0013"
down_revision = "0012"


def upgrade() -> None:
    """Go to this version; whoever changes one of the tables that are new in it writes its columns of 0.3.0 out here."""
    if sa.inspect(op.get_bind()).has_table("maps"):  # made in development
        op.add_column("maps", sa.Column("osm", sa.String(length=255)))
        op.add_column("maps", sa.Column("osm_bytes", sa.BigInteger()))
        op.drop_column("maps", "epsg")
    for name in {each["name"] for each in sa.inspect(op.get_bind()).get_columns("drive_files")} & {"folded", "sender"}:
        op.drop_index(f"ix_drive_files_{name}", "drive_files")
        op.drop_column("drive_files", name)
    Base.metadata.create_all(op.get_bind())
