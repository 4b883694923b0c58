"""Scoring of detections against the nodes of OpenStreetMap (paper, section IV)."""
