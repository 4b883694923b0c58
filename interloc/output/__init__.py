"""The files of a result: written, read back, and converted for GIS."""
