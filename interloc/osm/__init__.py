"""OpenStreetMap: the road graph, the ground truth policies, Overpass."""
