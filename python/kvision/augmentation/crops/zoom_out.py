"""Images on a larger canvas."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision.augmentation import ranges
from kvision.augmentation.crops.window_crop import WindowCrop
from kvision.augmentation.engine import Shape
from kvision.augmentation.geometric_base import AntialiasedByMatrix
from kvision.augmentation.random_generator.windows import WindowGenerator
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.transforms import Transform
from kvision.augmentation.warp_and_color import Resampling
from kvision.constants import AnyResample, Resample
from kvision.core.exceptions import ValueCheckError

__all__ = ["RandomZoomOut"]


class _CanvasGenerator(WindowGenerator):
    count = 3

    def __init__(self, size: Any, side_range: tuple[float, float]) -> None:
        super().__init__("RandomZoomOut", size)
        self.side_range = side_range

    def windows(self, numbers: Tensor, height: Tensor, width: Tensor, labels: Any) -> Tensor:
        lowest, highest = self.side_range
        ratio = lowest + (highest - lowest) * numbers[:, 0]
        w, h = (width * ratio).floor(), (height * ratio).floor()
        left, top = ((w - width) * numbers[:, 1]).floor(), ((h - height) * numbers[:, 2]).floor()
        return torch.stack([-left, -top, w, h], 1)


class RandomZoomOut(AntialiasedByMatrix, WindowCrop):
    """Put images on a larger canvas at random positions, as torchvision's `RandomZoomOut`, and resize it.

    Args:
        fill: value of the canvas: a number, or one of each channel.
        side_range: range of the sides of the canvas, as multiples of the image's.
        p: probability that a sample is augmented; with `size`, that a batch is.
        size: height and width of the results; default: those of the images.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        same_on_batch: all samples get the same canvas.
        align_corners: the centers of the outermost pixels of the canvas go to those of the result; False: their edges.
        antialias: average the pixels that a pixel of the result covers; for 'bilinear'.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.

    Raises:
        TypeError: `size` is not one or two ints; `fill` is not a number.
        ValueError: `side_range` is not two numbers of at least 1, the first one not above the second.

    Source: W. Liu et al., "SSD: single shot multibox detector" (2016).

    Example:
        >>> import torch, kvision as K
        >>> zoom = K.augmentation.RandomZoomOut(fill=0.5, side_range=(2.0, 2.0), p=1.0, size=(8, 8))
        >>> y = zoom(torch.ones(1, 1, 4, 4))
        >>> y.shape, (y == 1).sum().item(), (y == 0.5).sum().item()
        (torch.Size([1, 1, 8, 8]), 16, 48)
    """

    def __init__(
        self,
        fill: Numbers = 0,
        side_range: tuple[float, float] = (1.0, 4.0),
        p: float = 0.5,
        size: int | tuple[int, int] | None = None,
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        antialias: bool = True,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        op = "RandomZoomOut"
        if not isinstance(side_range, (tuple, list)) or len(side_range) != 2 or not 1 <= side_range[0] <= side_range[1]:
            raise ValueCheckError(
                f"{op}: expected side_range to be two numbers of at least 1 in order, got {side_range!r}"
            )
        generator = _CanvasGenerator(size, (float(side_range[0]), float(side_range[1])))
        given = dict(same_on_batch=same_on_batch, keepdim=keepdim, **options)
        super().__init__(generator, p, resample, align_corners, **given)
        self.flags = {**self.flags, "fill": ranges.fill(op, "fill", fill)}
        self._set_antialias(antialias)

    def matrix_transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform] | None:
        return WindowCrop.transforms(self, shape, flags)

    def resampling(self, flags: dict[str, Any]) -> Resampling:
        mode = Resample.get(flags["resample"]).name.lower()
        return Resampling(mode, "fill", bool(flags["align_corners"]), flags["fill"])
