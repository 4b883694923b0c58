"""Fusion of the detections of a drive into a map of intersections."""
