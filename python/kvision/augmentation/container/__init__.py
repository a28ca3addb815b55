"""Containers: chains of augmentations, for images alone or with their masks, boxes, key points and labels."""

from kvision.augmentation.container.choices import OneOf, RandomApply, RandomOrder, SomeOf
from kvision.augmentation.container.dispatcher import ManyToManyAugmentationDispather, ManyToOneAugmentationDispather
from kvision.augmentation.engine import (
    AugmentationSequential,
    ImageSequential,
    ImageSequentialBase,
    ParamItem,
    PatchSequential,
    VideoSequential,
)

__all__ = [
    "AugmentationSequential",
    "ImageSequential",
    "ImageSequentialBase",
    "ManyToManyAugmentationDispather",
    "ManyToOneAugmentationDispather",
    "OneOf",
    "ParamItem",
    "PatchSequential",
    "RandomApply",
    "RandomOrder",
    "SomeOf",
    "VideoSequential",
]
