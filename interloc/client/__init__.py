"""A service of InterLoc as seen from outside: drives are pushed to it, jobs submitted, results fetched.

`Connection` knows how to talk to it, `push`, `submit`, `follow` and `fetch` what to say.
"""

from interloc.client.connection import Connection
from interloc.client.fetch import fetch
from interloc.client.jobs import follow, submit

__all__ = ["Connection", "fetch", "follow", "submit"]
