"""Scans of a drive: as recorded with their labels, or reduced to their ground points."""
