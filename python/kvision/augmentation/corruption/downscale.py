"""Images of fewer pixels, enlarged again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._constants import constant
from kvision._modes import BLOCK_VALUE
from kvision.augmentation import ranges
from kvision.augmentation.corruption.pixelate import pixelate
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.lists.sides import sizes_of_list
from kvision.augmentation.random_generator.mapped import MappedGenerator
from kvision.augmentation.ranges import Numbers
from kvision.geometry.transform.lists.kept_sizes import Operation


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

    filters_chosen = True

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self._operation(input, params)(input)

    def _operation(self, like: Tensor, params: Params) -> Operation:
        sides = constant(tuple(like.shape[-2:]), like, torch.float64)
        return self._blocks(params["scale"].to(like.device, torch.float64), sides)

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operation:
        scale = self._params_on_device(like, execution, for_users=False)["scale"]
        return self._blocks(scale.to(like.device, torch.float64), sizes_of_list(images))

    def _blocks(self, scale: Tensor, sides: Tensor) -> Operation:
        counts = (scale[:, None] * sides).round().clamp(min=1)
        return Operation(pixelate, (counts.float(), BLOCK_VALUE["mean" if self.antialias else "pixel"]))
