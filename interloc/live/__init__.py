"""Intersections while driving: scans in, detections and a growing map out; session.py is the whole on one page."""
