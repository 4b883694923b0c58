"""One map of many drives; citymap.py is the whole on one page."""
