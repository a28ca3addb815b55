"""Containers: chains of augmentations, for images alone or with their masks, boxes, key points and labels."""

from kvision.augmentation.container.augmentation import AugmentationSequential
from kvision.augmentation.container.image import ImageSequential, ImageSequentialBase

__all__ = ["AugmentationSequential", "ImageSequential", "ImageSequentialBase"]
