"""Reading of drives: layouts, poses, labels, georeference, and the checks of all of them.

Whatever reads a file raises a `DriveError` (`GeoreferenceError`) that names it where it is missing, damaged or does
not fit the others. What takes `Findings` lists it there instead, where they do not stop at the first.
"""
