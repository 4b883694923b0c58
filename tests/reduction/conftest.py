"""Small drives on disk, to be reduced."""

from tests.samples import sample, sample_result
from tests.small_drives import drive, make, reduced

__all__ = ["drive", "make", "reduced", "sample", "sample_result"]
