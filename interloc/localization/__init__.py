"""Placing a drive on a road map without GNSS; `locate.py` is the method on one page.

The package is not named as its function: `interloc.locate` is the function.
"""
