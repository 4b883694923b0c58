"""Towns, LiDAR and drives whose truth is known."""
