"""Areas of boxes, boxes inside of images, boxes around masks."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError
from kvision.geometry.conversions.labels import convert_boxes

__all__ = ["box_area", "clip_boxes_to_image", "masks_to_boxes", "remove_small_boxes"]

BoxFormat: TypeAlias = Literal["xyxy", "xywh", "cxcywh", "cxcywhr", "xywhr", "xyxyxyxy"]
MaskBoxMode: TypeAlias = Literal["xyxy_plus", "xyxy", "xywh", "cxcywh"]
_MODES = get_args(MaskBoxMode)
_FORMATS: dict[BoxFormat, int] = {
    "xyxy": 4,
    "xywh": 4,
    "cxcywh": 4,
    "cxcywhr": 5,
    "xywhr": 5,
    "xyxyxyxy": 8,
}  # and numbers of a box


def box_area(boxes: Tensor, fmt: BoxFormat = "xyxy") -> Tensor:
    """Compute the areas of boxes by their edges: a box of pixels 0 to 9 along each axis is (0, 0, 10, 10) and has 100.

    Args:
        boxes: boxes of shape (*, 4), rotated ones of shape (*, 5) or (*, 8). Integers are computed in float32.
        fmt: 'xyxy' for two corners, 'xywh' for the first corner and the size, 'cxcywh' for middle and size; 'cxcywhr', 'xywhr'
            and 'xyxyxyxy' for the rotated modes of :func:`convert_boxes`.

    Returns:
        Areas of shape (*). One negative side gives a negative area; corners in a circle give a positive one.

    Raises:
        TypeError: `boxes` is not a tensor of real numbers.
        ValueError: `boxes` is not of the shape of its format, or `fmt` is unknown.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.box_area(torch.tensor([[1.0, 2, 4, 6]]))
        tensor([12.])
    """
    _check.choice("box_area", "fmt", fmt, tuple(_FORMATS))
    _check.trailing_shape("box_area", "boxes", boxes, _FORMATS[fmt])
    return _area(floats(boxes), fmt)


@with_kernel_casts
def _area(boxes: Tensor, fmt: BoxFormat) -> Tensor:
    if fmt == "xyxyxyxy":
        a, b, c, d = boxes.unflatten(-1, (4, 2)).unbind(-2)
        x, y = c - a, d - b  # the diagonals
        return (x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]).abs() / 2
    size = boxes[..., 2:4] - boxes[..., :2] if fmt == "xyxy" else boxes[..., 2:4]
    return size[..., 0] * size[..., 1]


def clip_boxes_to_image(boxes: Tensor, size: tuple[int, int]) -> Tensor:
    """Cut boxes off at the edges of an image.

    Args:
        boxes: boxes (x1, y1, x2, y2) of shape (*, 4), by their edges: all of an image is (0, 0, W, H).
        size: height and width of the image in pixels.

    Returns:
        Boxes of the shape and type of `boxes`. One that is outside of the image has no area.

    Raises:
        TypeError: `boxes` is not a tensor of real numbers, or `size` is not two ints.
        ValueError: `boxes` is not of shape (*, 4), or a size is below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.clip_boxes_to_image(torch.tensor([[-3.0, 2, 40, 6]]), (20, 30))
        tensor([[ 0.,  2., 30.,  6.]])
    """
    _check.trailing_shape("clip_boxes_to_image", "boxes", boxes, 4)
    height, width = _check.ints("clip_boxes_to_image", "size", size, 2)
    x, y = boxes[..., 0::2].clamp(0, width), boxes[..., 1::2].clamp(0, height)
    return torch.stack([x[..., 0], y[..., 0], x[..., 1], y[..., 1]], -1)


def remove_small_boxes(boxes: Tensor, min_size: float) -> Tensor:
    """Find the boxes whose width and height are at least a size. Waits for the device, as the result's size depends on values.

    Args:
        boxes: boxes (x1, y1, x2, y2) of shape (N, 4), whose size is the difference of both corners.
        min_size: the least width and height.

    Returns:
        The indices of these boxes, int64, in their order.

    Raises:
        TypeError: `boxes` is not a tensor of real numbers, or `min_size` is not a number.
        ValueError: `boxes` is not of shape (N, 4).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.remove_small_boxes(torch.tensor([[0.0, 0, 9, 1], [0, 0, 3, 4]]), 2)
        tensor([1])
    """
    _check.shape("remove_small_boxes", "boxes", boxes, "N", 4)
    _check.subtractable("remove_small_boxes", boxes=boxes)
    least = _check.number("remove_small_boxes", "min_size", min_size)
    return (boxes[:, 2:] - boxes[:, :2] >= least).all(-1).nonzero()[:, 0]


def masks_to_boxes(masks: Tensor, mode: MaskBoxMode = "xyxy_plus") -> Tensor:
    """Find the boxes around masks, on the device.

    Args:
        masks: masks of shape (*, H, W); what is not 0 is inside.
        mode: 'xyxy_plus' for the first and the last pixel, as torchvision gives them: one pixel has no area then. 'xyxy', 'xywh'
            and 'cxcywh' are by edges, where a box of pixels 0 to 9 ends at 10; :func:`convert_boxes` describes them.

    Returns:
        Boxes of shape (*, 4), float32. A mask that is 0 everywhere gives zeros, in every mode.

    Raises:
        TypeError: `masks` is not a tensor of real numbers.
        ValueError: `masks` is not of shape (*, H, W) with pixels, or `mode` is unknown.

    Example:
        >>> import torch, kvision as K
        >>> mask = torch.zeros(1, 6, 8)
        >>> mask[0, 2:4, 3:7] = 1
        >>> K.geometry.masks_to_boxes(mask), K.geometry.masks_to_boxes(mask, "xywh")
        (tensor([[3., 2., 6., 3.]]), tensor([[3., 2., 4., 2.]]))
    """
    op = "masks_to_boxes"
    _check.trailing_shape(op, "masks", masks, "H", "W")
    _check.choice(op, "mode", mode, _MODES)
    if 0 in masks.shape[-2:]:
        raise ShapeError(f"{op}: expected masks with H, W of at least 1, got {tuple(masks.shape)}")
    inside = masks.detach() != 0
    (x0, x1), (y0, y1) = _ends(inside.any(-2)), _ends(inside.any(-1))
    boxes = convert_boxes(torch.stack([x0, y0, x1, y1], -1).float(), "xyxy_plus", mode)
    return torch.where(inside.any(-1).any(-1)[..., None], boxes, 0)


def _ends(inside: Tensor) -> tuple[Tensor, Tensor]:
    """The first and the last position that is True along the last axis."""
    marks = inside.to(torch.uint8)
    return marks.argmax(-1), inside.shape[-1] - 1 - marks.flip(-1).argmax(-1)
