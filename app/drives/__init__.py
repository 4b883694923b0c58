"""Uploads: names, files, batches, archives, commits."""
