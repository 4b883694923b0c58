"""LAS and LAZ files: one per scan, or a cloud of mobile mapping that is cut into scans along its trajectory."""
