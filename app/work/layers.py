"""The layers that the service has of each result, as tables: those of its files, and those made of them."""

from interloc.output.layers import DERIVED, LAYERS

RESULT_LAYERS = {**LAYERS, **DERIVED}
"""By name."""
