"""Random erasing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._dtype import compute_dtype
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.erase import erase_rectangles, erased_where, fill_with_maps, fill_with_noise, is_erased
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.lists.masks import filled_masks
from kvision.augmentation.random_generator.erase import RectangleEraseGenerator
from kvision.augmentation.ranges import Numbers
from kvision.geometry.transform.lists.arguments import like_batch
from kvision.geometry.transform.lists.kept_sizes import Operation

__all__ = ["RandomErasing"]


class RandomErasing(IntensityAugmentationBase2D, keeps_contract=True):
    """Fill a random rectangle of each image with a value, and of its masks with 0.

    Args:
        scale: pair of lowest and highest area, as fractions of the image's.
        ratio: pair of lowest and highest height to width.
        value: the fill value, within 0 and 1: a number, one of each channel, or 'random' for uniform noise.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> erase = K.augmentation.RandomErasing((0.25, 0.25), (1.0, 1.0), p=1.0)
        >>> erase(torch.ones(1, 1, 4, 4)).sum()
        tensor(12.)
    """

    keeps_unchosen = True

    def __init__(
        self,
        scale: Numbers = (0.02, 0.33),
        ratio: Numbers = (0.3, 3.3),
        value: float | Sequence[float] | Tensor | str = 0.0,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator: RectangleEraseGenerator = RectangleEraseGenerator(scale, ratio, value)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        if params["values"].dim() < 4:
            return self._operation(input, params)(input)
        boxes, noise = self._boxes_and_values(input, params)
        noise = noise.round() if input.dtype == torch.uint8 else noise
        return torch.where(is_erased(input, boxes), noise.to(input.dtype), input)

    def _operation(self, like: Tensor, params: Params) -> Operation:
        boxes, values = self._boxes_and_values(like, params)
        return Operation(erase_rectangles, (boxes, values if values.dim() == 2 else values[:, None]))

    def _operates_on(self, dtype: torch.dtype) -> bool:
        if self._param_generator.per_pixel:
            return not self._is_customized()
        return super()._operates_on(dtype)

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        like = like_batch(images)
        params = self._drawn_params(like, execution)
        if self._param_generator.per_pixel and execution.params is not None:
            return fill_with_maps(images, self._erasing_mask(like, execution), params["values"])
        if self._param_generator.per_pixel:
            noise = self._pixel_noise(execution, execution.redraw, like.device)
            return fill_with_noise(images, self._boxes(params, tuple(like.shape)), noise)
        operation = self._operation(like, params)
        return erased_where(operation, None if execution.params is None else execution.chosen).on_list(images)

    def _boxes(self, params: Params, shape: tuple[int, ...]) -> Tensor:
        boxes: Tensor = self._param_generator.to_columns(params, shape)[:, None]
        return boxes

    def _boxes_and_values(self, like: Tensor, params: Params) -> tuple[Tensor, Tensor]:
        """The boxes (B, 1, 4), and the values in the units of images."""
        values = params["values"].to(compute_dtype(like))
        boxes = self._boxes(params, tuple(like.shape))
        return boxes, values * 255 if like.dtype == torch.uint8 else values

    def _move_mask_list(self, masks: list[Tensor], execution: Execution, fill: Any) -> list[Tensor] | None:
        return filled_masks(masks, fill or 0, self._erasing_mask(like_batch(masks), execution))

    def _erasing_mask(self, like: Tensor, execution: Execution) -> Callable[[list[Tensor], Tensor], list[Tensor]]:
        """What sets the rectangles of images of a list to values (1, 1)."""
        boxes = self._boxes(self._drawn_params(like, execution), execution.shape)
        chosen = None if execution.params is None else execution.chosen
        return lambda x, value: erased_where(Operation(erase_rectangles, (boxes, value)), chosen).on_list(x)

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied:
            return masks
        params = self._params_on_device(masks, execution)
        erased = is_erased(masks, self._boxes(params, execution.shape))
        if execution.chosen is not None:
            erased = erased & execution.chosen.to(masks.device)[:, None, None, None]
        return masks.masked_fill(erased, flags.get("mask_fill", 0))
