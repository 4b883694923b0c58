"""What the service keeps: database, files, tokens."""
