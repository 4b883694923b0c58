"""The web service; its layers, from the server down to the settings, are in pyproject.toml (import-linter)."""
