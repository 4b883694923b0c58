"""A client of InterLoc's web service: sends drives, submits and follows jobs, fetches results.

`connection.Connection` talks to a service; `push.prepare` gets a drive ready and `push.push` sends it; `jobs.submit`
and `jobs.follow` have the service find its intersections; `jobs.fetch` brings the result back.
"""
