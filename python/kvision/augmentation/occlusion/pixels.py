"""Single pixels that are dropped from images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype
from kvision.augmentation import ranges
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.erase import erase_marked_list
from kvision.augmentation.lists.masks import filled_masks
from kvision.augmentation.lists.pixels import PixelRow, given_maps
from kvision.augmentation.lists.replays import chosen_rows, maps_of_rows
from kvision.augmentation.maps import as_batch
from kvision.augmentation.noise import BY_CHANNEL, RANDOM, fill_pixels_list, salt_and_pepper
from kvision.augmentation.occlusion.dropout_base import DropoutBase
from kvision.augmentation.random_generator.occlusion import PixelDropoutGenerator, is_hit
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.sample_rows import index_of
from kvision.geometry.transform.lists.arguments import like_batch, sizes
from kvision.geometry.transform.lists.kept_sizes import Operation


class PixelDropout(DropoutBase, keeps_contract=True):
    """Set random pixels to a value. Masks stay as they are, unless they get a value as well.

    Args:
        dropout_prob: probability that a pixel is dropped: a number, or a pair within 0 and 1.
        per_channel: channels lose pixels of their own; masks lose those that any channel loses.
        drop_value: the value, within 0 and 1: a number, one of each channel, or 'random' for uniform noise.
        mask_drop_value: the value of masks at dropped pixels; None leaves masks as they are.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: an argument does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.PixelDropout(1.0, drop_value=0.5, p=1.0)(torch.zeros(1, 1, 1, 2))
        tensor([[[[0.5000, 0.5000]]]])
    """

    fill_names = ("drop_value", "mask_drop_value")
    fuses_noise = True

    def __init__(
        self,
        dropout_prob: Numbers = 0.01,
        per_channel: bool = False,
        drop_value: Numbers | Literal["random"] = 0.0,
        mask_drop_value: float | None = None,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(drop_value, mask_drop_value, p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        op = "PixelDropout"
        self._form = BY_CHANNEL if _check.switch(op, "per_channel", per_channel) else 0
        probability = ranges.as_pair(dropout_prob)
        self._param_generator = PixelDropoutGenerator(probability, self._form, self.fill)

    def is_dropped(self, params: Params, shape: tuple[int, ...], device: torch.device) -> Tensor:
        if "_noise" not in params:
            return params["dropped"].to(device)
        columns, noise = params["_noise"]
        return is_hit(columns, noise, self._form, shape)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        if "_noise" not in params or not self._fills_by_operator:
            return super().apply_transform(input, params, flags, transform)
        return self._operation(input, params)(input)

    @property
    def _fills_by_operator(self) -> bool:
        """Whether the operator on batches that hits pixels has the fill."""
        return self.fill in (0.0, "random")

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        if execution.params is not None:
            return self._replay_list(images, execution.params)
        if self._fills_by_operator:
            return super()._run_list(images, execution)
        like = like_batch(images)
        columns, noise = self._params_on_device(like, execution, for_users=False)["_noise"]
        values = self._values(like, {})[0, :, 0, 0]
        return list(
            fill_pixels_list(images, columns.to(compute_dtype(like)), values, *noise.arguments(form=self._form))
        )

    def _replay_list(self, images: Sequence[Tensor], params: Params) -> list[Tensor]:
        results, rows = list(images), chosen_rows(params)
        if not rows:
            return results
        row = PixelRow([images[i] for i in rows])
        x, like = row.of(row.images), like_batch(images)
        if isinstance(self.fill, str):
            fill = {"fill": row.of_maps(maps_of_rows(params["fill"], rows))}
            values = self._values(x, fill)
        else:
            values = row.of_channels(self._values(like, {})[:, :, 0, 0])
        values = values.round() if x.dtype == torch.uint8 else values
        y = torch.where(row.of_maps(maps_of_rows(params["dropped"], rows)), values.to(x.dtype), x)
        for i, result in zip(rows, row.split(y)):
            results[i] = result
        return results

    def _marks(self, masks: Sequence[Tensor], execution: Execution) -> Tensor:
        """1 at the pixels that are dropped from images of the sizes of masks, (B, 1, H, W) uint8 of the largest sides."""
        if execution.params is not None:
            marks = as_batch(given_maps(execution.params["dropped"], masks[0].device, torch.uint8))
        else:
            assert execution.columns is not None
            columns, channels = execution.columns.values.detach(), execution.shape[1] if self._form else 1
            noise, sides = self._pixel_noise(execution, execution.redraw, columns.device), sizes(masks)
            shapes = [(channels, h, w) for h, w in zip(sides[::2], sides[1::2])]
            counts = [math.prod(shape) for shape in shapes]
            zero = torch.zeros(sum(counts), dtype=torch.uint8, device=columns.device)
            kept = [own.view(shape) for own, shape in zip(zero.split(counts), shapes)]
            one = columns.new_ones(1, dtype=compute_dtype(zero))
            hit = fill_pixels_list(kept, columns.to(one), one, *noise.arguments(form=self._form))
            marks = as_batch(hit)
        marks, chosen = marks.amax(1, keepdim=True), execution.chosen
        return marks if chosen is None else marks * chosen.to(marks)[:, None, None, None]

    def _move_mask_list(self, masks: list[Tensor], execution: Execution, fill: Any) -> list[Tensor] | None:
        if self.fill_mask is None:
            return masks
        whole, rows = execution.whole or (execution, None)
        of_images = masks if rows is None else [masks[rows.index(b)] for b in range(whole.shape[0])]
        marks = self._marks(of_images, whole)
        if marks.device != masks[0].device:
            return None
        marks = marks if rows is None else marks.index_select(0, index_of(rows, marks))
        value = self.fill_mask if fill is None else fill
        return filled_masks(masks, value, lambda x, own: erase_marked_list(x, marks, own))

    def _operation(self, like: Tensor, params: Params) -> Operation:
        columns, noise = params["_noise"]
        form = self._form if self.fill == 0.0 else self._form | RANDOM
        return Operation(salt_and_pepper, (columns.to(compute_dtype(like)), *noise.arguments(form=form)))
