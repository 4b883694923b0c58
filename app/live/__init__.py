"""Live sessions: a sender drives, everybody may watch."""
