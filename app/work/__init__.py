"""What worker processes do: pure functions of a task, without database and web."""
