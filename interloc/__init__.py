"""Find road intersections in LiDAR drives, map them, and score them against OpenStreetMap."""
