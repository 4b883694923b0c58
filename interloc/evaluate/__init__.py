"""Scoring of detections against OpenStreetMap nodes.

Called, it scores a run: see `interloc.evaluate.evaluate.evaluate`.
"""

from interloc._callable import make_callable

make_callable(__name__, "interloc.evaluate.evaluate", "evaluate")
