"""Features are rows of tables of their own: of development between 0.2.0 and 0.3.0."""

from alembic import op

revision = "0012"
down_revision = "0011"


def upgrade() -> None:
    """Go to this version."""
    op.drop_table("feature_columns")
    op.drop_table("feature_chunks")
