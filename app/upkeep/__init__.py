"""Upkeep: clean-up, comparison of rows and files, backups and their restoration."""
