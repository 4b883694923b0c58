"""Small drives on disk, to be reduced."""

from tests.small_drives import drive, make, reduced, sample, sample_result, sequence

__all__ = ["drive", "make", "reduced", "sample", "sample_result", "sequence"]
