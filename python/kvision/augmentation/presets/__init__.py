"""Ready-made pipelines."""

from kvision.augmentation.presets import ada

__all__ = ["ada"]
