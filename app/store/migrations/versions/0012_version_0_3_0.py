"""The tables of version 0.3.0."""

revision = "0012"
down_revision = "0011"


def upgrade() -> None:
    """Go to this version."""
