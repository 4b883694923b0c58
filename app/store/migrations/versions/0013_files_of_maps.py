"""OSM files of maps have a row, so that quotas and backups know them."""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"


def upgrade() -> None:
    """Go to this version."""
    op.add_column("maps", sa.Column("osm", sa.String(length=255)))
    op.add_column("maps", sa.Column("osm_bytes", sa.BigInteger()))
    op.add_column("maps", sa.Column("osm_sender", sa.String(length=255)))
