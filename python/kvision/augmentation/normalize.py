"""Normalization as an augmentation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from kvision import enhance
from kvision.augmentation.engine import Params, Shape
from kvision.augmentation.intensity_base import ColorStep, IntensityAugmentationBase2D
from kvision.core.exceptions import TypeCheckError, ValueCheckError

__all__ = ["Denormalize", "Normalize"]

Statistics = Tensor | Sequence[float] | float


class _Statistics(IntensityAugmentationBase2D):
    """A mean and a standard deviation, for all channels or of each."""

    step: ClassVar[str]
    _is_by_pixel = True

    def __init__(self, mean: Statistics, std: Statistics, p: float, keepdim: bool, **options: Any) -> None:
        super().__init__(p=p, same_on_batch=True, keepdim=keepdim, **options)
        op = type(self).__name__
        self.flags = {name: _tensor(op, name, value) for name, value in (("mean", mean), ("std", std))}
        enhance.Normalize(**self.flags)  # whose constructor checks them
        self._known = {name: (x, x.flatten().tolist()) for name, x in self.flags.items()}

    def _result_dtype(self, dtype: torch.dtype) -> torch.dtype:
        if dtype != torch.uint8:
            return dtype
        mean = self._numbers(self.flags, "mean")
        if max(mean, default=0.0) > 1:
            raise ValueCheckError(
                f"{type(self).__name__}: expected mean of at most 1 for uint8 images, which count as x / 255, got "
                f"{mean}; divide mean and std by 255"
            )
        return torch.float32  # the values leave [0, 1]

    def _numbers(self, flags: dict[str, Any], name: str) -> list[float]:
        """A mean or a standard deviation as numbers, which compilers cannot read from tensors."""
        known, numbers = self._known[name]
        return numbers if flags[name] is known else _tensor(type(self).__name__, name, flags[name]).flatten().tolist()

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep] | None:
        mean, std = self._numbers(flags, "mean"), self._numbers(flags, "std")
        if shape[1] != 3 or len(mean) not in (1, 3) or len(std) not in (1, 3):
            return None
        mean, std = (x * (3 // len(x)) for x in (mean, std))
        return [ColorStep(self.step, *((mean + std) if self.step == "standardize_rgb" else (std + mean)))]


def _tensor(op: str, name: str, value: Any) -> Tensor:
    try:
        return (value if isinstance(value, Tensor) else torch.as_tensor(value, device="cpu")).float()
    except (TypeError, ValueError, RuntimeError):
        raise TypeCheckError(f"{op}: expected {name} to be a number or one of each channel, got {value!r}") from None


class Normalize(_Statistics, keeps_contract=True):
    """Subtract a mean and divide by a standard deviation, of all channels or of each.

    uint8 images count as x / 255 and give float32, unless `p` is 0. `kvision.enhance.normalize` stays in the unit of its images.

    Args:
        mean: a number, or one of each channel.
        std: a number, or one of each channel.
        p: probability that a sample is normalized.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError: `mean` or `std` holds no numbers.
        ValueError: there are not as many of one as of the other; in a call with uint8 images, `mean` is above 1.

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


class Denormalize(_Statistics, keeps_contract=True):
    """Multiply by a standard deviation and add a mean, of all channels or of each.

    uint8 images count as x / 255 and give float32, unless `p` is 0. `kvision.enhance.denormalize` stays in the unit of its images.

    Args:
        mean: a number, or one of each channel.
        std: a number, or one of each channel.
        p: probability that a sample is changed.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError: `mean` or `std` holds no numbers.
        ValueError: there are not as many of one as of the other; in a call with uint8 images, `mean` is above 1.

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
