"""Where in object storage the files of a drive are."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"


def upgrade() -> None:
    """Go to this version; the files of all drives there are were sent."""
    op.add_column("drives", sa.Column("source", sa.Text(), nullable=True))


def downgrade() -> None:
    """Go back to the version before."""
    op.drop_column("drives", "source")
