"""Random changes of brightness, contrast, saturation and hue."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from kvision.augmentation.engine import Shape
from kvision.augmentation.intensity_base import ColorStep, IntensityAugmentationBase2D
from kvision.augmentation.random_generator.color_jitter import ColorJiggleGenerator, ColorJitterGenerator
from kvision.augmentation.ranges import Numbers
from kvision.core.exceptions import ValueCheckError

__all__ = ["ColorJiggle", "ColorJitter"]


class ColorJitter(IntensityAugmentationBase2D):
    """Change brightness, contrast, saturation and hue of RGB images in a random order, as torchvision does.

    Args:
        brightness, contrast, saturation: factors: a number s for max(0, 1 - s) to 1 + s, or a pair.
        hue: turns: a number s for -s to s, or a pair, within -0.5 and 0.5.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.
        order: a permutation of 0 to 3, for brightness, contrast, saturation, hue; None for a random one a sample.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds; `order` is not a permutation.

    Example:
        >>> import torch, kvision as K
        >>> brighter = K.augmentation.ColorJitter(brightness=(2.0, 2.0))
        >>> brighter(torch.full((1, 3, 1, 1), 0.25)).flatten()
        tensor([0.5000, 0.5000, 0.5000])
    """

    order_of_steps = "order"

    def __init__(
        self,
        brightness: Numbers = 0.0,
        contrast: Numbers = 0.0,
        saturation: Numbers = 0.0,
        hue: Numbers = 0.0,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        order: Sequence[int] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        _check_order("ColorJitter", order)
        self._param_generator = ColorJitterGenerator(brightness, contrast, saturation, hue, order)

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep]:
        return [
            ColorStep("scale_shift", "brightness_factor", 0.0, 1.0),  # clamped
            ColorStep("contrast", "contrast_factor"),
            ColorStep("saturation_gray", "saturation_factor"),
            ColorStep("hue", "radians"),
        ]


class ColorJiggle(IntensityAugmentationBase2D):
    """Change brightness, contrast, saturation and hue of RGB images in a random order, by the functions of kvision.enhance.

    Brightness is added (a factor of 1 adds nothing), contrast is multiplied, saturation and hue change in HSV.

    Args:
        brightness, contrast, saturation: factors: a number s for max(0, 1 - s) to 1 + s, or a pair; brightness at most 2.
        hue: turns: a number s for -s to s, or a pair, within -0.5 and 0.5.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.
        order: a permutation of 0 to 3, for brightness, contrast, saturation, hue; None for a random one a sample.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds; `order` is not a permutation.

    Example:
        >>> import torch, kvision as K
        >>> brighter = K.augmentation.ColorJiggle(brightness=(1.5, 1.5))
        >>> brighter(torch.full((1, 3, 1, 1), 0.25)).flatten()
        tensor([0.7500, 0.7500, 0.7500])
    """

    order_of_steps = "order"

    def __init__(
        self,
        brightness: Numbers = 0.0,
        contrast: Numbers = 0.0,
        saturation: Numbers = 0.0,
        hue: Numbers = 0.0,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        order: Sequence[int] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        _check_order("ColorJiggle", order)
        self._param_generator = ColorJiggleGenerator(brightness, contrast, saturation, hue, order)

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep]:
        return [
            ColorStep("scale_shift", 1.0, "addition", 1.0),
            ColorStep("scale_shift", "contrast_factor", 0.0, 1.0),
            ColorStep("saturation", "saturation_factor"),
            ColorStep("hue", "radians"),
        ]


def _check_order(op: str, order: Sequence[int] | None) -> None:
    listed = order.tolist() if isinstance(order, Tensor) else order
    if listed is not None and sorted(listed) != [0, 1, 2, 3]:
        raise ValueCheckError(f"{op}: expected order to be a permutation of 0 to 3, got {order!r}")
