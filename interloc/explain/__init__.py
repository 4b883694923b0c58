"""Pictures of the steps of the method for one keyframe (paper, Fig. 2 and 5)."""

from interloc.explain.figures import explain

__all__ = ["explain"]
