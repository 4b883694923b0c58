"""Drives and their results for catalogues (STAC 1.1)."""
