"""The method of the paper, a module a step, and the detector that strings them together."""
