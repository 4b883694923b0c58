"""Who sent a file into the drive of somebody else."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"

_INDEX = "ix_drive_files_sender"


def upgrade() -> None:
    """Go to this version; what is there counts for the owners of the drives."""
    op.add_column("drive_files", sa.Column("sender", sa.String(length=255), nullable=True))
    known = sa.text("sender IS NOT NULL")
    op.create_index(_INDEX, "drive_files", ["sender"], sqlite_where=known, postgresql_where=known)


def downgrade() -> None:
    """Go back to the version before."""
    op.drop_index(_INDEX, "drive_files")
    op.drop_column("drive_files", "sender")
