"""Scopes, expiry and quotas of tokens."""

import sqlalchemy as sa
from alembic import op

revision = "0002_tokens"
down_revision = "0001"


def upgrade() -> None:
    """Go to this version; tokens that exist may write, as before."""
    with op.batch_alter_table("tokens", schema=None) as batch_op:
        batch_op.add_column(sa.Column("scope", sa.String(length=255), server_default="write", nullable=False))
        batch_op.add_column(sa.Column("expires_at", sa.Float(), nullable=True))
        batch_op.add_column(sa.Column("last_used_at", sa.Float(), nullable=True))
        batch_op.add_column(sa.Column("max_bytes", sa.BigInteger(), nullable=True))
        batch_op.add_column(sa.Column("max_jobs", sa.BigInteger(), nullable=True))


def downgrade() -> None:
    """Go back to the version before."""
    with op.batch_alter_table("tokens", schema=None) as batch_op:
        for name in ("max_jobs", "max_bytes", "last_used_at", "expires_at", "scope"):
            batch_op.drop_column(name)
