"""The web service of InterLoc."""

# Imports only go down in this order (what stands on one line may use what stands further left):
#   settings, paths
#   store
#   metrics, logs, context, security
#   http
#   schemas, work
#   jobs
#   drives, results
#   routes
#   main, server
