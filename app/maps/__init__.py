"""Maps of many drives, and the queue of what they contradict of OpenStreetMap."""
