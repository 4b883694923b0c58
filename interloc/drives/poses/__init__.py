"""Poses of a drive: the lines of pose files, whose poses they are, and the calibrations between the sensors."""
