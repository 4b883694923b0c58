"""What workers do for jobs that find intersections. No database, no web."""
