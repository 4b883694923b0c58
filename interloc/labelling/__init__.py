"""Labels by a segmentation network: range image, network, post-processing (RangeNet++ and its family)."""
