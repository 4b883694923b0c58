"""Care for what is kept: backups of it, and their restoration."""
