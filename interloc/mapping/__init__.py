"""From detections to a map: georeferencing, fusion, result files."""
