"""What the service speaks: requests, answers, problem documents, limits, and the files of the page."""
