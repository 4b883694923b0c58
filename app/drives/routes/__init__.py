"""The endpoints of drives and their files."""
