"""Policies of augmentations: each sample gets operations that are drawn for it."""

from kvision.augmentation.auto import operations
from kvision.augmentation.auto.aug_mix import AugMix
from kvision.augmentation.auto.policies import AutoAugment, RandAugment, TrivialAugment
from kvision.augmentation.auto.policy_base import PolicyAugmentBase

__all__ = ["AugMix", "AutoAugment", "PolicyAugmentBase", "RandAugment", "TrivialAugment", "operations"]
