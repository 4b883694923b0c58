"""The tables of version 0.2.0, the oldest one whose databases are opened."""

revision = "0006"
down_revision = None


def upgrade() -> None:
    """Do nothing: what is older is refused, and a new database is made with the tables of this version."""
