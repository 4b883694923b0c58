"""The paper's tables by one command: drives by presets by label errors by seeds, measured, pooled, and shown."""
