"""Normalization as an augmentation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from kvision import enhance
from kvision.augmentation.base import Params, Shape
from kvision.augmentation.intensity_base import ColorStep, ColorSteps, IntensityAugmentationBase2D
from kvision.core.exceptions import TypeCheckError

__all__ = ["Denormalize", "Normalize"]

Statistics = Tensor | Sequence[float] | float


class _Statistics(IntensityAugmentationBase2D):
    """A mean and a standard deviation, for all channels or of each."""

    step: ClassVar[str]

    def __init__(self, mean: Statistics, std: Statistics, p: float, keepdim: bool, **options: Any) -> None:
        super().__init__(p=p, same_on_batch=True, keepdim=keepdim, **options)
        op = type(self).__name__
        self.flags = {name: _tensor(op, name, value) for name, value in (("mean", mean), ("std", std))}
        self._mean, self._std = (x.flatten().tolist() for x in self.flags.values())

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> ColorSteps | None:
        if shape[1] != 3 or len(self._mean) not in (1, 3) or len(self._std) not in (1, 3):
            return None
        mean, std = (x * (3 // len(x)) for x in (self._mean, self._std))
        return ColorSteps(
            [ColorStep(self.step, (*mean, *std) if self.step == "standardize_rgb" else (*std, *mean, 0.0))]
        )


def _tensor(op: str, name: str, value: Any) -> Tensor:
    try:
        return torch.as_tensor(value).float()
    except (TypeError, ValueError, RuntimeError):
        raise TypeCheckError(f"{op}: expected {name} to be a number or one of each channel, got {value!r}") from None


class Normalize(_Statistics):
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

    step = "standardize_rgb"

    def __init__(
        self, mean: Statistics, std: Statistics, p: float = 1.0, keepdim: bool = False, **options: Any
    ) -> None:
        super().__init__(mean, std, p, keepdim, **options)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return enhance.normalize(input, flags["mean"].to(input.device), flags["std"].to(input.device))


class Denormalize(_Statistics):
    """Multiply by a standard deviation and add a mean, of all channels or of each.

    Args:
        mean: a number, or one of each channel.
        std: a number, or one of each channel.
        p: probability that a sample is changed.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError: `mean` or `std` holds no numbers.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.Denormalize(mean=0.5, std=0.25)(torch.ones(1, 3, 1, 1)).flatten()
        tensor([0.7500, 0.7500, 0.7500])
    """

    step = "scale_shift_rgb"

    def __init__(
        self, mean: Statistics, std: Statistics, p: float = 1.0, keepdim: bool = False, **options: Any
    ) -> None:
        super().__init__(mean, std, p, keepdim, **options)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return enhance.denormalize(input, flags["mean"].to(input.device), flags["std"].to(input.device))
