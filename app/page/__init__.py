"""The page: its files, what it is told about the service, the documentation of the API."""
