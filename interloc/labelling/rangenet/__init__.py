"""Networks of the RangeNet++ / lidar-bonnetal family: a folder with model.onnx, arch_cfg.yaml and data_cfg.yaml."""

from interloc.labelling.rangenet.labeller import open_labeller
from interloc.labelling.rangenet.model import describe

__all__ = ["describe", "open_labeller"]
