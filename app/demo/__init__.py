"""The demo drive: made on request, to try the service with."""
