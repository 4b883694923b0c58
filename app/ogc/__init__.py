"""OGC API - Features: results as a GIS asks for them, from the index of features."""
