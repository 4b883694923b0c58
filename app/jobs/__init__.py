"""The queue and those who work on it: leases, runner, executors."""
