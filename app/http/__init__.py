"""What the service speaks: requests, answers, problem documents, limits."""
