"""OGC API - Features: results as rows that a GIS asks for."""
