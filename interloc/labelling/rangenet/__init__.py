"""Networks of the RangeNet++ / lidar-bonnetal family: a folder with model.onnx, arch_cfg.yaml and data_cfg.yaml.

What another kind of network provides to be used in the same places is `describe` and `open_labeller`, see
`interloc.labelling.networks`.
"""

from interloc.labelling.rangenet.labeller import open_labeller
from interloc.labelling.rangenet.model import describe

__all__ = ["describe", "open_labeller"]
