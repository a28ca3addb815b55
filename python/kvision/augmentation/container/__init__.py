"""Containers: chains of augmentations, for images alone or with their masks, boxes, key points and labels."""

from kvision.augmentation.container.dispatcher import ManyToManyAugmentationDispather, ManyToOneAugmentationDispather
from kvision.augmentation.engine.augmentation_sequential import AugmentationSequential
from kvision.augmentation.engine.image_sequential import ImageSequential, ImageSequentialBase, ParamItem
from kvision.augmentation.engine.patch_sequential import PatchSequential
from kvision.augmentation.engine.video_sequential import VideoSequential

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
