"""Upkeep: rows and files are compared, made anew, backed up and restored."""
