"""Crops by their overlap with a box, as SSD trains with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._constants import constant
from kvision.augmentation.crops.window_crop import WindowCrop
from kvision.augmentation.random_generator.windows import WindowGenerator, clipped_boxes
from kvision.constants import AnyResample, Resample
from kvision.core.exceptions import ValueCheckError

__all__ = ["RandomIoUCrop"]

_ROUNDS = 8  # choices of an overlap, each of which is tried `trials` times


class _IoUGenerator(WindowGenerator):
    def __init__(
        self, size: Any, scale: tuple[float, float], aspect: tuple[float, float], options: Sequence[float], trials: int
    ) -> None:
        super().__init__("RandomIoUCrop", size)
        self.scale, self.aspect, self.options, self.trials = scale, aspect, tuple(options), trials
        self.count = _ROUNDS * (1 + 4 * trials)

    def windows(self, numbers: Tensor, height: Tensor, width: Tensor, labels: Any) -> Tensor:
        """The first window that is accepted of all rounds of trials; all of the image if a round says so, or none is."""
        batch, trials, (lowest, highest) = len(numbers), self.trials, self.scale
        boxes, is_box = clipped_boxes(labels, height, width)
        choice = (numbers[:, :_ROUNDS] * len(self.options)).long()
        least = constant(self.options, numbers)[choice].repeat_interleave(trials, 1)  # (B, rounds * trials)
        a, b, c, d = numbers[:, _ROUNDS:].unflatten(1, (4, -1)).unbind(1)
        w = (width[:, None] * (lowest + (highest - lowest) * a)).floor()
        h = (height[:, None] * (lowest + (highest - lowest) * b)).floor()
        left, top = ((width[:, None] - w) * c).floor(), ((height[:, None] - h) * d).floor()
        fits = (w >= 1) & (h >= 1) & (w >= self.aspect[0] * h) & (w <= self.aspect[1] * h)
        overlap = _largest_overlap(torch.stack([left, top, left + w, top + h], -1), boxes, is_box)
        is_whole = least >= 1
        accepted = is_whole | (fits & (overlap >= least) & (overlap > 0))
        first = accepted.to(torch.uint8).argmax(1, keepdim=True)
        window = torch.stack([left, top, w, h], -1).gather(1, first[..., None].expand(batch, 1, 4))[:, 0]
        keeps_all = is_whole.gather(1, first) | ~accepted.gather(1, first)
        zero = torch.zeros_like(width)
        return torch.where(keeps_all, torch.stack([zero, zero, width, height], -1), window)


def _largest_overlap(windows: Tensor, boxes: Tensor, is_box: Tensor) -> Tensor:
    """The largest intersection over union (B, K) of windows (B, K, 4) with one of the boxes (B, N, 4) whose centers are inside.

    0 where there is no such box.
    """
    largest = torch.zeros_like(windows[..., 0])
    area = (windows[..., 2:] - windows[..., :2]).prod(-1)[..., None]
    for part, known in zip(boxes.split(16, 1), is_box.split(16, 1)):  # which bounds the memory of many boxes
        first, last = windows[:, :, None, :2], windows[:, :, None, 2:]
        near, far = part[:, None, :, :2], part[:, None, :, 2:]
        center = (near + far) / 2
        is_inside = ((first < center) & (center < last)).all(-1) & known[:, None]
        common = (torch.minimum(last, far) - torch.maximum(first, near)).clamp(min=0).prod(-1)
        overlap = common / (area + (far - near).prod(-1) - common).clamp(min=1e-12)
        largest = torch.maximum(largest, torch.where(is_inside, overlap, 0.0).amax(-1))
    return largest


class RandomIoUCrop(WindowCrop):
    """Cut windows out of images that overlap with one of their boxes, as torchvision's `RandomIoUCrop`, and resize them.

    A least intersection over union is chosen among `sampler_options`, then windows are tried: one is accepted whose sides and
    aspect are in the ranges, and that has this overlap with a box whose center it contains. If none is, a new overlap is chosen,
    up to eight times. The image stays whole where an option of 1 or more is chosen, where no window is accepted, and where it has
    no boxes.

    Boxes are those of an :class:`AugmentationSequential` at this step, or `boxes` of a call, (B, N, 4) or a list of (N, 4), as
    (left, top, right, bottom) in pixels. Those whose centers are outside of the window are removed by the container, with their
    labels and masks, as torchvision does in two steps.

    Args:
        min_scale: least width and height of windows, as fractions of the image's.
        max_scale: largest width and height of windows.
        min_aspect_ratio: least width / height of windows.
        max_aspect_ratio: largest width / height.
        sampler_options: least overlaps, all equally likely; default: 0, .1, .3, .5, .7, .9 and 1.
        trials: windows that are tried for an overlap.
        size: height and width of the results; default: those of the images.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        same_on_batch: the same random numbers for all samples, whose windows differ by their boxes.
        align_corners: the centers of the outermost pixels of the window go to those of the result; False: their edges.
        antialias: blur windows that become smaller, and read no pixel next to them.
        p: probability that a sample is cropped; with `size`, that a batch is.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.

    Raises:
        TypeError: `size` is not one or two ints, `trials` no int.
        ValueError: a range is empty or not above 0; there are no options; `trials` or a size below 1; `antialias` with 'nearest'.

    Source: W. Liu et al., "SSD: single shot multibox detector" (2016).

    Example:
        >>> import torch, kvision as K
        >>> crop = K.augmentation.RandomIoUCrop(sampler_options=[0.5], size=(32, 32))
        >>> crop(torch.rand(2, 3, 64, 80), boxes=torch.tensor([[[8.0, 8.0, 50.0, 40.0]]]).expand(2, 1, 4)).shape
        torch.Size([2, 3, 32, 32])
    """

    reads_labels = "boxes"
    removes_boxes = True

    def __init__(
        self,
        min_scale: float = 0.3,
        max_scale: float = 1.0,
        min_aspect_ratio: float = 0.5,
        max_aspect_ratio: float = 2.0,
        sampler_options: Sequence[float] | None = None,
        trials: int = 40,
        size: int | tuple[int, int] | None = None,
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        antialias: bool = True,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        op = "RandomIoUCrop"
        min_scale, max_scale, min_aspect_ratio, max_aspect_ratio = (
            _check.number(op, name, value)
            for name, value in (
                ("min_scale", min_scale),
                ("max_scale", max_scale),
                ("min_aspect_ratio", min_aspect_ratio),
                ("max_aspect_ratio", max_aspect_ratio),
            )
        )
        for name, low, high in (("scale", min_scale, max_scale), ("aspect_ratio", min_aspect_ratio, max_aspect_ratio)):
            if not 0 < low <= high:
                raise ValueCheckError(f"{op}: expected min_{name} above 0 and up to max_{name}, got {low} and {high}")
        if max_scale > 1:
            raise ValueCheckError(f"{op}: expected max_scale up to 1, got {max_scale}")
        least = (
            (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
            if sampler_options is None
            else tuple(_check.number(op, "sampler_options", x) for x in sampler_options)
        )
        if not least:
            raise ValueCheckError(f"{op}: expected sampler_options, got none")
        _check.ints(op, "trials", trials, 1)
        scale, aspect = (min_scale, max_scale), (min_aspect_ratio, max_aspect_ratio)
        generator = _IoUGenerator(size, scale, aspect, list(least), trials)
        given = dict(same_on_batch=same_on_batch, keepdim=keepdim, **options)
        super().__init__(generator, p, resample, align_corners, antialias, **given)
