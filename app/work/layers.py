"""The layers that the service has of each result, as tables: those of its files, and those made of them."""

from interloc.output.layers import DERIVED, LAYERS, Layer
from interloc.output.properties import ORIGIN, Attribute, ResultProperties

RESULT_LAYERS = {**LAYERS, **DERIVED}
"""By name."""


def own_attributes(layer: Layer) -> list[Attribute]:
    """Return the properties of a layer that its table holds: those of the result as a whole stand in other tables."""
    of_result = ORIGIN if issubclass(layer.properties, ResultProperties) else ()
    return [each for each in layer.attributes if each.name not in of_result]
