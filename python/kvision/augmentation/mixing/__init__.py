"""Augmentations that mix the samples of a batch."""

from kvision.augmentation.mixing.mix import (
    MixAugmentationBaseV2,
    PatchMix,
    RandomCutMixV2,
    RandomJigsaw,
    RandomMixUpV2,
    RandomMosaic,
)

__all__ = ["MixAugmentationBaseV2", "PatchMix", "RandomCutMixV2", "RandomJigsaw", "RandomMixUpV2", "RandomMosaic"]
