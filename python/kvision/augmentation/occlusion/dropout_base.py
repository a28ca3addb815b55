"""What augmentations that drop parts of images share: the fill, and masks that lose the same parts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor

from kvision import _check
from kvision._constants import constant
from kvision._dtype import compute_dtype
from kvision._ops import Operator
from kvision.augmentation import ranges
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.erase import erased_where, fill_with_maps, fill_with_noise
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.lists.masks import filled_masks
from kvision.augmentation.ranges import Numbers
from kvision.core.exceptions import ShapeError
from kvision.geometry.transform.lists.arguments import like_batch
from kvision.geometry.transform.lists.kept_sizes import Operation, runs_on_lists


class DropoutBase(IntensityAugmentationBase2D, keeps_contract=True):
    """Base of augmentations that fill parts of images, which :meth:`is_dropped` says, and the same parts of masks.

    `fill` is a number within 0 and 1, one of each channel, or 'random' for the uniform noise of the parameter `fill`;
    `fill_mask` is the value of masks, None to leave them as they are.
    """

    fill_names: ClassVar[tuple[str, str]] = ("fill", "fill_mask")  # of the arguments

    def __init__(self, fill: Numbers | Literal["random"], fill_mask: float | None, **options: Any) -> None:
        super().__init__(**options)
        op, (name, mask_name) = type(self).__name__, self.fill_names
        self.fill = ranges.fill_value(op, name, fill)
        self.fill_mask = None if fill_mask is None else _check.number(op, mask_name, fill_mask)

    def is_dropped(self, params: Params, shape: tuple[int, ...], device: torch.device) -> Tensor:
        """Which pixels of images of a shape are dropped, bool (B, 1, H, W) or (B, C, H, W)."""
        raise NotImplementedError(f"{type(self).__name__}.is_dropped")

    def _values(self, input: Tensor, params: Params) -> Tensor:
        """The fill in the units of images, (1, 1, 1, 1), (1, C, 1, 1) or (B, C, H, W), of the type that is computed in."""
        most, own = 255 if input.dtype == torch.uint8 else 1, compute_dtype(input)
        if isinstance(self.fill, str):
            return most * params["fill"].to(input.device, own)
        if isinstance(self.fill, list) and len(self.fill) != input.shape[1]:
            op = type(self).__name__
            raise ShapeError(f"{op}: expected {self.fill_names[0]} of {input.shape[1]} channels, got {len(self.fill)}")
        each = self.fill if isinstance(self.fill, list) else [self.fill]
        return constant(tuple(most * value for value in each), input, own)[None, :, None, None]

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        dropped, values = self.is_dropped(params, tuple(input.shape), input.device), self._values(input, params)
        return torch.where(dropped, (values.round() if input.dtype == torch.uint8 else values).to(input.dtype), input)

    def _move_mask_list(self, masks: list[Tensor], execution: Execution, fill: Any) -> list[Tensor] | None:
        return masks if self.fill_mask is None else None

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied or self.fill_mask is None:
            return super().transform_masks(masks, execution, flags)
        params = self._params_on_device(masks, execution)
        dropped = self.is_dropped(params, execution.shape, masks.device).any(1, keepdim=True)
        if execution.chosen is not None:
            dropped = dropped & execution.chosen.to(masks.device)[:, None, None, None].bool()
        return masks.masked_fill(dropped, flags.get("mask_fill", self.fill_mask))


class ErasingDropout(DropoutBase, keeps_contract=True):
    """A class whose parts an operator sets to values."""

    eraser: ClassVar[Operator]

    def _parts(self, params: Params, shape: tuple[int, ...], device: torch.device) -> Tensor:
        """The parts of images of a shape, float32 (B, ...), as the operator takes them."""
        raise NotImplementedError(f"{type(self).__name__}._parts")

    def is_dropped(self, params: Params, shape: tuple[int, ...], device: torch.device) -> Tensor:
        kept = torch.ones((shape[0], 1, *shape[-2:]), dtype=torch.uint8, device=device)
        zero = torch.zeros(1, 1, dtype=torch.float32, device=device)
        erased: Tensor = self.eraser(kept, self._parts(params, shape, device), zero)
        return erased == 0

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        if isinstance(self.fill, str):
            return super().apply_transform(input, params, flags, transform)
        return self._operation(input, params)(input)

    def _operation(self, like: Tensor, params: Params) -> Operation:
        return self._erasing(self._parts(params, tuple(like.shape), like.device), like, params)

    def _erasing(self, parts: Tensor, like: Tensor, params: Params) -> Operation:
        """The operator that sets parts of images like a batch to the fill, but for noise."""
        values = None if isinstance(self.fill, str) else self._values(like, params)[:, :, 0, 0]
        return Operation(self.eraser, (parts, values))

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return runs_on_lists(self.eraser) and not self._is_customized()

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        erasing = self._erasing_of_list(images, like_batch(images), execution)
        if not isinstance(self.fill, str):
            return erasing.on_list(images)
        parts, _ = erasing.arguments
        if execution.params is not None:
            given = execution.params["fill"]
            return fill_with_maps(images, lambda x, own: erasing._replace(arguments=(parts, own)).on_list(x), given)
        noise = self._pixel_noise(execution, execution.redraw, images[0].device)
        return fill_with_noise(images, parts, noise)

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operation:
        return self._operation(like, self._drawn_params(like, execution))

    def _erasing_of_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operation:
        operation = self._operation_on_list(images, like, execution)
        assert isinstance(operation, Operation)
        has_columns = self.keeps_unchosen and execution.params is None
        return erased_where(operation, None if has_columns else execution.chosen)

    def _move_mask_list(self, masks: list[Tensor], execution: Execution, fill: Any) -> list[Tensor] | None:
        if self.fill_mask is None:
            return masks
        channels = len(self.fill) if isinstance(self.fill, list) else 1  # of the images
        erasing = self._erasing_of_list(masks, like_batch(masks)[:, :1].expand(-1, channels, -1, -1), execution)
        value = self.fill_mask if fill is None else fill
        return filled_masks(
            masks, value, lambda x, own: erasing._replace(arguments=(erasing.arguments[0], own)).on_list(x)
        )
