"""Images of different sizes as one batch: resized with their aspect ratio, or as they are, with a fill around them."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import ResizeInterpolation
from kvision.core.exceptions import TypeCheckError
from kvision.geometry.transform.lists.arguments import check_list
from kvision.geometry.transform.lists.warp_list import warped
from kvision.geometry.transform.resize import INTERPOLATIONS, resize_each

__all__ = ["Letterboxed", "PaddedBatch", "letterbox", "pad_to_batch"]


class Letterboxed(NamedTuple):
    """What :func:`letterbox` returns: the batch, and what moves coordinates (x, y) of each image to it.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.letterbox([torch.rand(3, 20, 40)], 64).offset
        tensor([[ 0., 16.]])
    """

    images: Tensor
    scale: Tensor
    offset: Tensor


class PaddedBatch(NamedTuple):
    """What :func:`pad_to_batch` returns: the batch, and height and width of each image in it.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.pad_to_batch([torch.rand(3, 20, 40)]).sizes
        tensor([[20, 40]])
    """

    images: Tensor
    sizes: Tensor


def letterbox(
    images: Tensor | list[Tensor],
    size: int | tuple[int, int],
    fill_value: float | None = None,
    interpolation: ResizeInterpolation = "bilinear",
    antialias: bool = False,
) -> Letterboxed:
    """Resize images with their aspect ratio to fit a size, and center them on a fill.

    The factor is min(h / H, w / W), and the sides of the resized image are rounded to pixels, half to even. An odd rest goes to the
    right and below. These are the sizes and positions of Ultralytics.

    Args:
        images: a list of images (C, H, W) of any sizes, or a batch (B, C, H, W), floating point or uint8.
        size: height and width of the result, or one number for both.
        fill_value: the value around the images; None for 114/255, which is 114 for uint8.
        interpolation: see :func:`resize`.
        antialias: see :func:`resize`.

    Returns:
        A named tuple of `images` (B, C, h, w), `scale` (B, 2) and `offset` (B, 2), float32, along x and y: coordinates of the
        edges of boxes in an image, times `scale`, plus `offset`, are those in the result. Centers of pixels are moved by
        `(x + 0.5) * scale + offset - 0.5`.

    Raises:
        TypeError: `images` is not a tensor of real numbers or a list of these of one type; `size` is not one or two ints;
            `fill_value` is not a number; `antialias` is not a bool.
        ValueError: `images` is not (B, C, H, W), or a list without images or of different devices or numbers of channels;
            `size` is below 1; `interpolation` is unknown.

    Example:
        >>> import torch, kvision as K
        >>> boxed = K.geometry.letterbox([torch.rand(3, 20, 40), torch.rand(3, 50, 25)], 64)
        >>> boxed.images.shape, boxed.offset.tolist()
        (torch.Size([2, 3, 64, 64]), [[0.0, 16.0], [16.0, 0.0]])
        >>> boxes = torch.tensor([[0.0, 0, 40, 20], [0, 0, 25, 50]])  # (x1, y1, x2, y2), one of each image
        >>> (boxes.view(2, 2, 2) * boxed.scale[:, None] + boxed.offset[:, None]).view(2, 4)
        tensor([[ 0., 16., 64., 48.],
                [16.,  0., 48., 64.]])
    """
    op = "letterbox"
    if isinstance(images, Tensor):
        _check.images(op, "images", images)
        images = list(images)
    images = _check_list(op, images)
    h, w = _check.ints(op, "size", size, 2)
    _check.choice(op, "interpolation", interpolation, INTERPOLATIONS)
    _check.flag(op, "antialias", antialias)
    if fill_value is None:
        fill_value = 114 / 255 if images[0].is_floating_point() else 114.0
    fill_value = _check.number(op, "fill_value", fill_value)
    sizes, scales, offsets = [], [], []
    for x in images:
        height, width = x.shape[1:]
        factor = min(h / height, w / width)
        inner_h, inner_w = max(1, round(height * factor)), max(1, round(width * factor))
        sizes += [inner_h, inner_w]
        scales.append((inner_w / width, inner_h / height))
        offsets.append(((w - inner_w) // 2, (h - inner_h) // 2))
    resized = resize_each(images, sizes, interpolation, False, antialias, True)
    device = images[0].device
    return Letterboxed(
        _placed(op, resized, offsets, (h, w), fill_value),
        torch.tensor(scales, dtype=torch.float32, device=device),
        torch.tensor(offsets, dtype=torch.float32, device=device),
    )


def pad_to_batch(images: list[Tensor], multiple: int = 1, fill_value: float = 0.0) -> PaddedBatch:
    """Pad images of different sizes on the right and below to one batch.

    Args:
        images: a list of images (C, H, W), of any type.
        multiple: height and width of the batch are the smallest multiples of this number that hold all images.
        fill_value: the value around the images.

    Returns:
        A named tuple of `images` (B, C, h, w), of the type of the images, and `sizes` (B, 2), int64: height and width of each.

    Raises:
        TypeError: `images` is not a list of tensors of real numbers of one type; `multiple` is not an int; `fill_value` is not a
            number.
        ValueError: `images` has no images, or of different devices or numbers of channels; `multiple` is below 1.

    Example:
        >>> import torch, kvision as K
        >>> batch = K.geometry.pad_to_batch([torch.ones(1, 3, 5), torch.ones(1, 4, 2)], multiple=4)
        >>> batch.images.shape, batch.sizes.tolist()
        (torch.Size([2, 1, 4, 8]), [[3, 5], [4, 2]])
    """
    op = "pad_to_batch"
    images = _check_list(op, images)
    (multiple,) = _check.ints(op, "multiple", multiple, 1)
    fill_value = _check.number(op, "fill_value", fill_value)
    sizes = [tuple(x.shape[1:]) for x in images]
    height, width = (-(-max(sides) // multiple) * multiple for sides in zip(*sizes))
    batch = _placed(op, images, [(0, 0)], (height, width), fill_value)
    return PaddedBatch(batch, torch.tensor(sizes, device=images[0].device))


def _check_list(op: str, images: object) -> list[Tensor]:
    if not isinstance(images, list):
        raise TypeCheckError(
            f"{op}: expected images to be a list of Tensors, got {_check.described(images)}", actual_type=type(images)
        )
    return check_list(op, "images", images)


def _placed(
    op: str, images: list[Tensor], offsets: list[tuple[int, int]], size: tuple[int, int], fill_value: float
) -> Tensor:
    """Images with their first pixel at `offsets` (x, y), one for each or for all, in a batch of `size`."""
    matrix = torch.tensor([[[1.0, 0.0, -x], [0.0, 1.0, -y]] for x, y in offsets], dtype=torch.float64, device="cpu")
    placed: Tensor = warped(op, images, "offset", matrix, list(size), "nearest", "fill", True, fill_value)
    return placed
