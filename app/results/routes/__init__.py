"""The endpoints of results."""
