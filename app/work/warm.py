"""What nearly all work needs, imported ahead of the first, which need not wait for it then: seconds on busy cores.

Worker processes are forks of one that has imported this module. None of them gives any of it back, so no collection of
garbage may look through it: that takes each process half a second, and a copy of all of it. Most of what work makes
lives to its end, so garbage is also looked for less often, as by the command line.
"""

import gc
from importlib import import_module

from interloc.processes import GARBAGE_THRESHOLD

for name in (
    "app.jobs.work.intersections",
    "interloc.evaluation.evaluate",
    "interloc.evaluation.figures",
    "interloc.evaluation.report",
    "interloc.osm.reader",
    "osmium",
    "shapely",
):
    import_module(name)

gc.collect()
gc.freeze()
gc.set_threshold(GARBAGE_THRESHOLD)
