"""The page of the service and its documentation: files that are served as they are."""
