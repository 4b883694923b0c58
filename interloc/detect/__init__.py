"""The method of the paper, a module a step, and the detector that strings them together.

Called, it runs a whole drive: see `interloc.pipeline.detect`.
"""

from interloc._callable import make_callable

make_callable(__name__, "interloc.pipeline", "detect")
