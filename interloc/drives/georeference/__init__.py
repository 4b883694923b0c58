"""Georeference of a drive: OXTS (GNSS/INS of KITTI) and geo.csv."""
