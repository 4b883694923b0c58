"""What workers do for drives: unpacking, checking, reducing. No database, no web."""
