"""All drives on one map."""
