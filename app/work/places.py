"""Where the work on uploads leaves what it made, for the server that takes it from there."""

from __future__ import annotations

from interloc.mapping.layout import file_names

REDUCED = "reduced"
"""Folder of a reduced drive in the folder of the result of a commit."""

TRAJECTORY = tuple(file_names(georeferenced=known)["trajectory"] for known in (True, False))
"""Beside it: the trajectory, with and without georeference."""

UNPACKED = "unpacked"
"""Folder of the files of an archive in the scratch folder."""

LISTING = "unpacked.json"
"""Beside it: a list of their paths, sizes and SHA-256."""
