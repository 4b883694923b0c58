"""Upkeep: rows and files are compared, and rows are made for folders that have none."""
