"""From the mosaic of a drive to a map of its roads: centrelines, widths, junctions, surface."""
