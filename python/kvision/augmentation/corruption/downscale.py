"""Images of fewer pixels, enlarged again."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._constants import constant
from kvision._modes import BLOCK_VALUE
from kvision.augmentation import ranges
from kvision.augmentation.corruption.pixelate import pixelate
from kvision.augmentation.engine import Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.random_generator.mapped import MappedGenerator
from kvision.augmentation.ranges import Numbers


class Downscale(IntensityAugmentationBase2D, keeps_contract=True):
    """Shrink images by a random factor and enlarge them again, so that pixels become blocks.

    Args:
        scale_range: pair of the lowest and the highest factor, above 0 and at most 1; at least one pixel remains.
        antialias: blocks are means of their pixels; otherwise one of them.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0.0, 0.2, 0.4, 0.6]]]])
        >>> K.augmentation.Downscale((0.5, 0.5), antialias=True, p=1.0)(x)
        tensor([[[[0.1000, 0.1000, 0.5000, 0.5000]]]])
    """

    def __init__(
        self,
        scale_range: Numbers = (0.25, 0.25),
        antialias: bool = False,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self.antialias = _check.switch("Downscale", "antialias", antialias)
        self._param_generator = MappedGenerator(
            (ranges.without_gradient("Downscale", "scale_range", scale_range), "scale", None, (1e-6, 1.0)),
            identity=[1.0],
            op="Downscale",
        )

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        scale = params["scale"].to(input.device, torch.float64)[:, None]
        counts = (scale * constant(tuple(input.shape[-2:]), scale)).round().clamp(min=1)
        value = BLOCK_VALUE["mean" if self.antialias else "pixel"]
        blocks: Tensor = pixelate(input, counts.float(), value)
        return blocks
