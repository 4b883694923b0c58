"""The id of the installation, deleted drives and jobs that can be restored, times of uploaded files."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """Go to this version."""
    op.create_table(
        "installation",
        sa.Column("id", sa.String(length=255), nullable=False),
        sa.Column("created_at", sa.Float(), nullable=False),
        sa.PrimaryKeyConstraint("id"),
    )
    for table in ("drives", "jobs"):
        op.add_column(table, sa.Column("deleted_at", sa.Float(), nullable=True))
        op.add_column(table, sa.Column("deleted_by", sa.String(length=255), nullable=True))
    op.add_column("drive_files", sa.Column("mtime_ns", sa.BigInteger(), nullable=True))


def downgrade() -> None:
    """Go back to the version before; what lies in the trash is alive again."""
    op.drop_column("drive_files", "mtime_ns")
    for table in ("jobs", "drives"):
        op.drop_column(table, "deleted_by")
        op.drop_column(table, "deleted_at")
    op.drop_table("installation")
