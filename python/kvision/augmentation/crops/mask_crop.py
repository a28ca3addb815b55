"""Crops that contain what a mask marks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision.augmentation.crops.window_crop import WindowCrop
from kvision.augmentation.maps import as_batch
from kvision.augmentation.random_generator.windows import WindowGenerator, pick, up_to
from kvision.augmentation.sample_rows import index_of

__all__ = ["CropNonEmptyMaskIfExists"]


class _NonEmptyGenerator(WindowGenerator):
    must_fit = True

    def __init__(self, size: Any, ignore_values: Sequence[int], ignore_channels: Sequence[int]) -> None:
        super().__init__("CropNonEmptyMaskIfExists", size)
        self.ignore_values, self.ignore_channels = tuple(ignore_values), tuple(ignore_channels)

    def windows(self, numbers: Tensor, height: Tensor, width: Tensor, labels: Any) -> Tensor:
        assert self.output_size is not None
        row, column, within_x, within_y = numbers.unbind(1)
        at: list[Tensor] = []
        is_marked = torch.zeros_like(height, dtype=torch.bool)
        if labels is not None:
            of_batch = all(isinstance(masks, Tensor) for masks in labels)
            marks = self._marks(labels) if of_batch else self._marks_of_list(labels)  # (B, H, W)
            marks = marks.to(height.device)
            in_row = marks.sum(-1, dtype=torch.int32)
            # Row by row all marked pixels are equally likely: first their rank, then its row and its rank in the row.
            total = in_row.cumsum(1)
            is_marked = total[:, -1] > 0
            rank = (row * total[:, -1]).floor()
            y = torch.searchsorted(total, rank[:, None].to(total) + 1)[:, 0].clamp(max=marks.shape[1] - 1)
            x = pick(marks[torch.arange(len(marks), device=y.device), y], column).clamp(max=marks.shape[2] - 1)
            at = [x.to(height), y.to(height)]
        window = []
        for axis, (size, side, number) in enumerate(
            zip((width, height), reversed(self.output_size), (within_x, within_y))
        ):
            free = size - side
            first = up_to(number, free)
            if at:
                around = (at[axis] - (number * side).floor()).clamp(min=0).minimum(free)
                first = torch.where(is_marked, around, first)
            window.append(first)
        h, w = self.output_size
        return torch.stack([*window, torch.full_like(width, w), torch.full_like(height, h)], 1)

    def _marks(self, masks: Sequence[Tensor]) -> Tensor:
        """The pixels (B, H, W) that any of the masks (B, C, H, W) marks."""
        marks = []
        for mask in masks:
            channels = self._channels(mask.shape[1])
            own = mask if len(channels) == mask.shape[1] else mask[:, channels]
            marks.append(self._is_marked(own).any(1))
        return torch.stack(marks).any(0)

    def _marks_of_list(self, masks: Sequence[Sequence[Tensor]]) -> Tensor:
        """The same of masks (N, h, w) of each image of a list, with the largest sides."""
        planes: list[Tensor] = []  # (1, h, w) uint8
        samples: list[int] = []
        for of_images in masks:
            values = torch.cat([mask.flatten() for mask in of_images])
            marked = self._is_marked(values).view(torch.uint8).split([mask.numel() for mask in of_images])
            for b, (mask, own) in enumerate(zip(of_images, marked)):
                each, channels = own.view(mask.shape).split(1), self._channels(len(mask))
                planes += [each[c] for c in channels]
                samples += [b] * len(channels)
        count = len(masks[0])
        if not planes:
            return torch.zeros(count, 1, 1, dtype=torch.bool, device=masks[0][0].device)
        marks = as_batch(planes)[:, 0]
        if samples != list(range(count)):
            of_samples = marks.new_zeros(count, *marks.shape[1:], dtype=torch.int32)
            marks = of_samples.index_add(0, index_of(samples, marks), marks.int())
        return marks > 0

    def _channels(self, count: int) -> list[int]:
        """Those of `count` channels that mark pixels."""
        return [c for c in range(count) if c not in self.ignore_channels or count == 1]

    def _is_marked(self, values: Tensor) -> Tensor:
        """Whether values of masks mark pixels."""
        is_marked = values != 0
        for value in self.ignore_values:
            is_marked = is_marked & (values != value)
        return is_marked


class CropNonEmptyMaskIfExists(WindowCrop):
    """Cut windows of a size out of images that contain a pixel that their mask marks, as Albumentations' class of this name.

    A pixel that is not 0 is chosen among all of them, and a window around it. Images whose masks are empty, and those
    without masks, are cropped as by :class:`RandomCrop`. Masks are those of an :class:`AugmentationSequential` at this step,
    several of which mark what any of them does, or `masks` of a call, (B, C, H, W) or (B, H, W).

    Args:
        height: of the windows.
        width: of the windows.
        ignore_values: values of masks that mark nothing, as 0 does.
        ignore_channels: channels of masks of several channels that mark nothing.
        same_on_batch: the same random numbers for all samples, whose windows differ by their masks.
        p: probability that a batch is cropped.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.

    Raises:
        TypeError: a size, a value or a channel is not an int.
        ValueError: a size below 1; in a call, images smaller than the window.

    Example:
        >>> import torch, kvision as K
        >>> crop = K.augmentation.CropNonEmptyMaskIfExists(1, 1)
        >>> image = torch.arange(16.0).reshape(1, 1, 4, 4)
        >>> crop(image, masks=image == 6)
        tensor([[[[6.]]]])
    """

    reads_labels = "masks"
    moves_whole_pixels = stays_inside = True

    def __init__(
        self,
        height: int,
        width: int,
        ignore_values: Sequence[int] | None = None,
        ignore_channels: Sequence[int] | None = None,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        op = "CropNonEmptyMaskIfExists"
        values = [_check.ints(op, "ignore_values", x, 1, -_check.LARGEST_INT)[0] for x in ignore_values or ()]
        channels = [_check.ints(op, "ignore_channels", x, 1, 0)[0] for x in ignore_channels or ()]
        generator = _NonEmptyGenerator((height, width), values, channels)
        super().__init__(generator, p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
