"""Containers: chains of augmentations, for images alone or with their masks, boxes, key points and labels."""

from kvision.augmentation.container.augmentation import AugmentationSequential
from kvision.augmentation.container.dispatcher import ManyToManyAugmentationDispather, ManyToOneAugmentationDispather
from kvision.augmentation.container.image import ImageSequential, ImageSequentialBase, ParamItem
from kvision.augmentation.container.patch import PatchSequential
from kvision.augmentation.container.video import VideoSequential

__all__ = [
    "AugmentationSequential",
    "ImageSequential",
    "ImageSequentialBase",
    "ManyToManyAugmentationDispather",
    "ManyToOneAugmentationDispather",
    "ParamItem",
    "PatchSequential",
    "VideoSequential",
]
