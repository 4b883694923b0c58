"""Poses of the LiDAR from its points alone: each scan is laid onto those before it."""
