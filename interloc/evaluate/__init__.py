"""Scoring detections against OpenStreetMap nodes."""
