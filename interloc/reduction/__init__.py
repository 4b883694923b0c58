"""Reduction of drives to the ground points that the method looks at: the plan, and the writing."""
