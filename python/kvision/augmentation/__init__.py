"""Random augmentation of images with their masks, boxes, key points and labels."""

from kvision.augmentation import container, draws, random_generator
from kvision.augmentation.affine import RandomAffine
from kvision.augmentation.base import (
    AugmentationBase2D,
    AugmentationBase3D,
    RigidAffineAugmentationBase2D,
    RigidAffineAugmentationBase3D,
)
from kvision.augmentation.color_jitter import ColorJitter
from kvision.augmentation.container import AugmentationSequential, ImageSequential
from kvision.augmentation.flip import RandomHorizontalFlip, RandomVerticalFlip
from kvision.augmentation.geometric_base import GeometricAugmentationBase2D
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D, IntensityAugmentationBase3D
from kvision.augmentation.normalize import Normalize

__all__ = [
    "AugmentationBase2D",
    "AugmentationBase3D",
    "AugmentationSequential",
    "ColorJitter",
    "GeometricAugmentationBase2D",
    "ImageSequential",
    "IntensityAugmentationBase2D",
    "IntensityAugmentationBase3D",
    "Normalize",
    "RandomAffine",
    "RandomHorizontalFlip",
    "RandomVerticalFlip",
    "RigidAffineAugmentationBase2D",
    "RigidAffineAugmentationBase3D",
    "container",
    "random_generator",
]
