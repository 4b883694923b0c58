"""A service of InterLoc as seen from outside: drives are pushed to it, jobs submitted and followed, results fetched.

`connection.Connection` knows how to talk to a service; `consignment.consign` gets a drive ready, and `push.push` brings
it there; `jobs.submit` and `jobs.follow` have the service find its intersections; `fetch.fetch` brings the result back.
"""
