"""Compiled pixel and point loops; each has its plain twin in the tests."""
