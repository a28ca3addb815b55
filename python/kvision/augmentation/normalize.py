"""Normalization as an augmentation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import enhance
from kvision.augmentation.base import Params, Shape
from kvision.augmentation.intensity_base import ColorStep, ColorSteps, IntensityAugmentationBase2D

__all__ = ["Normalize"]

Statistics = Tensor | Sequence[float] | float


class Normalize(IntensityAugmentationBase2D):
    """Subtract a mean and divide by a standard deviation, of all channels or of each.

    Args:
        mean: a number, or one of each channel.
        std: a number, or one of each channel.
        p: probability that a sample is normalized.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError: `mean` or `std` holds no numbers.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.Normalize(mean=0.5, std=0.25)(torch.ones(1, 3, 1, 1)).flatten()
        tensor([2., 2., 2.])
    """

    def __init__(
        self, mean: Statistics, std: Statistics, p: float = 1.0, keepdim: bool = False, **options: Any
    ) -> None:
        super().__init__(p=p, same_on_batch=True, keepdim=keepdim, **options)
        self.flags = {"mean": torch.as_tensor(mean).float(), "std": torch.as_tensor(std).float()}
        self._mean, self._std = (x.flatten().tolist() for x in self.flags.values())

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> ColorSteps | None:
        if shape[1] != 3:
            return None
        values = [x * (3 // len(x)) for x in (self._mean, self._std)]
        return ColorSteps([ColorStep("standardize_rgb", (*values[0], *values[1]))])

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return enhance.normalize(input, flags["mean"].to(input.device), flags["std"].to(input.device))
