"""Idempotency keys of drives, and where drives are."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"

_EXTENT = ("west", "south", "east", "north")

# The table must not be made anew, as a constraint would need it on SQLite: files and jobs would go with the old one.


def upgrade() -> None:
    """Go to this version; the clean-up fills in where drives are that were committed before."""
    op.add_column("drives", sa.Column("idempotency_key", sa.String(length=255), nullable=True))
    op.add_column("drives", sa.Column("request_sha256", sa.String(length=64), nullable=True))
    for name in _EXTENT:
        op.add_column("drives", sa.Column(name, sa.Float(), nullable=True))
    op.create_index("ix_drives_idempotency", "drives", ["owner", "idempotency_key"], unique=True)


def downgrade() -> None:
    """Go back to the version before."""
    op.drop_index("ix_drives_idempotency", "drives")
    for name in (*reversed(_EXTENT), "request_sha256", "idempotency_key"):
        op.drop_column("drives", name)
