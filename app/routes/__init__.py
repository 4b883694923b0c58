"""The REST endpoints, one module a resource; they check and call, no more."""
