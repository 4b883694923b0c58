"""Uploads: names, files, batches, archives, limits, clean-up."""
