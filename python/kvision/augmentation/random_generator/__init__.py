"""Generators of random parameters: each knows the ranges of one augmentation and draws its parameters for a batch."""

from kvision.augmentation.random_generator.base import RandomGeneratorBase

__all__ = ["RandomGeneratorBase"]
