"""Small drives on disk, to be reduced."""

from tests.small_drives import drive, make, reduced

__all__ = ["drive", "make", "reduced"]
