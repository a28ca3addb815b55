"""Crops that keep boxes: all of them, one of them, or the neighborhood of one."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision.augmentation.crops.window_crop import WindowCrop
from kvision.augmentation.random_generator.windows import WindowGenerator, clipped_boxes, pick, up_to
from kvision.constants import AnyResample, Resample
from kvision.core.exceptions import ValueCheckError

__all__ = ["AtLeastOneBBoxRandomCrop", "RandomCropNearBBox", "RandomSizedBBoxSafeCrop"]


def _one_box(boxes: Tensor, is_box: Tensor, number: Tensor) -> tuple[Tensor, Tensor]:
    """One of the boxes (B, N, 4) of each image, (B, 4), by a random number (B,), and whether it has one, (B,)."""
    at = pick(is_box, number).clamp(max=boxes.shape[1] - 1)
    return boxes.gather(1, at[:, None, None].expand(-1, 1, 4))[:, 0], is_box.any(1)


class _SafeGenerator(WindowGenerator):
    def __init__(self, size: Any, erosion_rate: float) -> None:
        super().__init__("RandomSizedBBoxSafeCrop", size)
        self.erosion_rate = erosion_rate

    def windows(self, numbers: Tensor, height: Tensor, width: Tensor, labels: Any) -> Tensor:
        a, b, c, d = numbers.unbind(1)
        boxes, is_box = clipped_boxes(labels, height, width)
        far_away = torch.where(is_box[..., None], boxes, torch.inf)
        first = far_away[..., :2].amin(1)
        last = torch.where(is_box[..., None], boxes, -torch.inf)[..., 2:].amax(1)
        several = (is_box.sum(1) > 1)[:, None]  # one box by itself is not eroded
        margin = torch.where(several, (last - first) * (self.erosion_rate / 2), 0.0)
        first, last = first + margin, last - margin
        has_box = is_box.any(1) & ((last - first) > 1e-6 * torch.stack([width, height], 1)).all(1)
        if self.erosion_rate == 1:
            has_box = torch.zeros_like(has_box)
        sides = []
        for near, far, size, before, after in (
            (first[:, 0], last[:, 0], width, a, c),
            (first[:, 1], last[:, 1], height, b, d),
        ):
            begin = (near * before).floor()
            end = torch.maximum((far + (size - far) * after).floor(), far.ceil())
            sides.append((begin, torch.maximum(end - begin, torch.ones_like(size))))
        (x, w), (y, h) = sides
        # Without boxes: a window of the aspect of the image.
        least = (height * (1.0 - self.erosion_rate)).floor()
        free_h = (least + up_to(a, height - least)).clamp(min=1)
        free_w = (free_h * width / height).floor().clamp(min=1)
        free = up_to(b, width - free_w), up_to(c, height - free_h), free_w, free_h
        return torch.stack([torch.where(has_box, own, other) for own, other in zip((x, y, w, h), free)], 1)


class RandomSizedBBoxSafeCrop(WindowCrop):
    """Cut windows out of images that contain all their boxes, as Albumentations' `RandomSizedBBoxSafeCrop`, and resize them.

    Each side of a window is anywhere between that of the smallest rectangle around all boxes and that of the image. The window of
    an image without boxes has the aspect of the image, and a height between (1 - erosion_rate) of the image's and all of it.

    Boxes are those of an :class:`AugmentationSequential` at this step, or `boxes` of a call, (B, N, 4) or a list of (N, 4), as
    (left, top, right, bottom) in pixels.

    Args:
        height: of the results.
        width: of the results.
        erosion_rate: the fraction by which the rectangle around several boxes is smaller, 0 to 1, so that parts of them may be
            cut off; 1 ignores boxes.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        same_on_batch: the same random numbers for all samples, whose windows differ by their boxes.
        align_corners: the centers of the outermost pixels of the window go to those of the result; False: their edges.
        antialias: blur windows that become smaller, and read no pixel next to them.
        p: probability that a batch is cropped.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.

    Raises:
        TypeError: a size is not an int.
        ValueError: a size below 1; `erosion_rate` is not within 0 and 1; `antialias` with 'nearest'.

    Example:
        >>> import torch, kvision as K
        >>> crop = K.augmentation.RandomSizedBBoxSafeCrop(32, 32)
        >>> crop = K.augmentation.AugmentationSequential(crop, data_keys=["image", "bbox_xyxy"])
        >>> images, boxes = crop(torch.rand(2, 3, 64, 80), torch.tensor([[[8.0, 8.0, 50.0, 40.0]]]).expand(2, 1, 4))
        >>> bool((boxes >= 0).all() and (boxes <= 32).all())
        True
    """

    reads_labels = "boxes"

    def __init__(
        self,
        height: int,
        width: int,
        erosion_rate: float = 0.0,
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        antialias: bool = True,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        generator = _SafeGenerator(
            (height, width), _check.fraction("RandomSizedBBoxSafeCrop", "erosion_rate", erosion_rate)
        )
        given = dict(same_on_batch=same_on_batch, keepdim=keepdim, **options)
        super().__init__(generator, p, resample, align_corners, antialias, **given)


class _OneBoxGenerator(WindowGenerator):
    must_fit = True
    count = 3

    def __init__(self, size: Any, erosion_factor: float) -> None:
        super().__init__("AtLeastOneBBoxRandomCrop", size)
        self.erosion_factor = erosion_factor

    def windows(self, numbers: Tensor, height: Tensor, width: Tensor, labels: Any) -> Tensor:
        assert self.output_size is not None
        box, has_box = _one_box(*clipped_boxes(labels, height, width), numbers[:, 0])
        window = []
        for axis, (size, side) in enumerate(zip((width, height), reversed(self.output_size))):
            near, far, free = box[:, axis], box[:, axis + 2], size - side
            kept = (far - near) * (1.0 - self.erosion_factor)
            lowest, highest = ((x.clamp(min=0).minimum(free)) for x in (near + kept - side, far - kept))
            lowest, highest = torch.where(has_box, lowest, 0.0), torch.where(has_box, highest, free)
            at = (lowest + (highest - lowest) * numbers[:, 1 + axis]).floor()
            # A part of a pixel at the far side of the box is not cut off.
            at = torch.where(highest >= lowest, torch.maximum(at, lowest.ceil().minimum(free)), at)
            window.append(torch.where(has_box, at, up_to(numbers[:, 1 + axis], free)))
        h, w = self.output_size
        return torch.stack([*window, torch.full_like(width, w), torch.full_like(height, h)], 1)


class AtLeastOneBBoxRandomCrop(WindowCrop):
    """Cut windows of a size out of images that contain one of their boxes, as Albumentations' `AtLeastOneBBoxRandomCrop`.

    A box is chosen, and a window anywhere that contains it, or, where it is larger, is inside it. Images without boxes are cropped
    as by :class:`RandomCrop`. Boxes are those of an :class:`AugmentationSequential` at this step, or `boxes` of a call, (B, N, 4)
    or a list of (N, 4), as (left, top, right, bottom) in pixels.

    Args:
        height: of the windows.
        width: of the windows.
        erosion_factor: the fraction of the width and height of the box that may be cut off, 0 to 1.
        same_on_batch: the same random numbers for all samples, whose windows differ by their boxes.
        p: probability that a batch is cropped.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.

    Raises:
        TypeError: a size is not an int.
        ValueError: a size below 1; `erosion_factor` is not within 0 and 1; in a call, images smaller than the window.

    Example:
        >>> import torch, kvision as K
        >>> crop = K.augmentation.AtLeastOneBBoxRandomCrop(2, 2)
        >>> crop(torch.arange(16.0).reshape(1, 1, 4, 4), boxes=torch.tensor([[[2.0, 2.0, 4.0, 4.0]]]))
        tensor([[[[10., 11.],
                  [14., 15.]]]])
    """

    reads_labels = "boxes"
    moves_whole_pixels = stays_inside = True

    def __init__(
        self,
        height: int,
        width: int,
        erosion_factor: float = 0.0,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        op = "AtLeastOneBBoxRandomCrop"
        generator = _OneBoxGenerator((height, width), _check.fraction(op, "erosion_factor", erosion_factor))
        super().__init__(generator, p, same_on_batch=same_on_batch, keepdim=keepdim, **options)


class _NearGenerator(WindowGenerator):
    count = 5

    def __init__(self, size: Any, shift: tuple[float, float]) -> None:
        super().__init__("RandomCropNearBBox", size)
        self.shift = shift  # of height and width

    def windows(self, numbers: Tensor, height: Tensor, width: Tensor, labels: Any) -> Tensor:
        box, has_box = _one_box(*clipped_boxes(labels, height, width), numbers[:, 0])
        sides = []
        for axis, (size, part) in enumerate(zip((width, height), reversed(self.shift))):
            near, far = box[:, axis].floor(), box[:, axis + 2].ceil()
            most = ((far - near) * part).round()
            before, after = (up_to(numbers[:, 1 + 2 * axis + i], 2 * most) - most for i in (0, 1))
            begin, end = (near - before).clamp(min=0), (far + after).minimum(size)
            sides.append((near, far, begin, end))
        is_left = torch.stack([end > begin for *_, begin, end in sides]).all(0)  # of the window
        first, last = [], []
        for (near, far, begin, end), size in zip(sides, (width, height)):
            zero = torch.zeros_like(size)
            first.append(torch.where(has_box, torch.where(is_left, begin, near), zero))
            last.append(torch.where(has_box, torch.where(is_left, end, far), size))
        return torch.stack([*first, last[0] - first[0], last[1] - first[1]], 1)


class RandomCropNearBBox(WindowCrop):
    """Cut the neighborhood of one of the boxes out of images, as Albumentations' `RandomCropNearBBox`, and resize it.

    Each side of the box moves inward or outward by a whole number of pixels. All boxes of an image are equally likely; an image
    without boxes stays whole. Boxes are those of an :class:`AugmentationSequential` at this step, or `boxes` of a call,
    (B, N, 4) or a list of (N, 4), as (left, top, right, bottom) in pixels.

    Args:
        max_part_shift: by which fractions of its height and of its width the sides of a box move, each within 0 and 1.
        size: height and width of the results; default: those of the images.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        same_on_batch: the same random numbers for all samples, whose windows differ by their boxes.
        align_corners: the centers of the outermost pixels of the window go to those of the result; False: their edges.
        antialias: blur windows that become smaller, and read no pixel next to them.
        p: probability that a sample is cropped; with `size`, that a batch is.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.

    Raises:
        TypeError: `size` is not one or two ints.
        ValueError: `max_part_shift` is not two fractions within 0 and 1; a size below 1; `antialias` with 'nearest'.

    Example:
        >>> import torch, kvision as K
        >>> crop = K.augmentation.RandomCropNearBBox((0.0, 0.0), size=(2, 2))
        >>> crop(torch.arange(16.0).reshape(1, 1, 4, 4), boxes=torch.tensor([[[1.0, 2.0, 3.0, 4.0]]]))
        tensor([[[[ 9., 10.],
                  [13., 14.]]]])
    """

    reads_labels = "boxes"

    def __init__(
        self,
        max_part_shift: tuple[float, float] = (0.0, 0.3),
        size: int | tuple[int, int] | None = None,
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        antialias: bool = True,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        op = "RandomCropNearBBox"
        if not isinstance(max_part_shift, (tuple, list)) or len(max_part_shift) != 2:
            raise ValueCheckError(f"{op}: expected max_part_shift to be two fractions, got {max_part_shift!r}")
        down, across = (_check.fraction(op, "max_part_shift", x) for x in max_part_shift)
        given = dict(same_on_batch=same_on_batch, keepdim=keepdim, **options)
        super().__init__(_NearGenerator(size, (down, across)), p, resample, align_corners, antialias, **given)
