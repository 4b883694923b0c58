"""The method of the paper, one module per step, and the detector that runs them."""
