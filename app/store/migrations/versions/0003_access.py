"""Scopes, expiry and quotas of tokens; names of files that differ in case only."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """Go to this version; tokens that exist may write, as before."""
    with op.batch_alter_table("tokens", schema=None) as batch_op:
        batch_op.add_column(sa.Column("scope", sa.String(length=255), server_default="write", nullable=False))
        batch_op.add_column(sa.Column("expires_at", sa.Float(), nullable=True))
        batch_op.add_column(sa.Column("last_used_at", sa.Float(), nullable=True))
        batch_op.add_column(sa.Column("max_bytes", sa.BigInteger(), nullable=True))
        batch_op.add_column(sa.Column("max_jobs", sa.BigInteger(), nullable=True))
    with op.batch_alter_table("drive_files", schema=None) as batch_op:
        batch_op.add_column(sa.Column("folded", sa.String(length=32), nullable=True))
    known = sa.text("folded IS NOT NULL")
    op.create_index(
        "ix_drive_files_folded", "drive_files", ["drive_id", "folded"], sqlite_where=known, postgresql_where=known
    )


def downgrade() -> None:
    """Go back to the version before."""
    op.drop_index("ix_drive_files_folded", "drive_files")
    with op.batch_alter_table("drive_files", schema=None) as batch_op:
        batch_op.drop_column("folded")
    with op.batch_alter_table("tokens", schema=None) as batch_op:
        for name in ("max_jobs", "max_bytes", "last_used_at", "expires_at", "scope"):
            batch_op.drop_column(name)
