"""Which job of a drive was pinned as its result."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"


def upgrade() -> None:
    """Go to this version; nothing is pinned."""
    op.add_column("drives", sa.Column("pinned_job", sa.String(length=255), nullable=True))


def downgrade() -> None:
    """Go back to the version before."""
    op.drop_column("drives", "pinned_job")
