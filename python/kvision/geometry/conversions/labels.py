"""Boxes and key points of data sets and of other libraries: corners or sizes, pixels or fractions, edges or centers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ValueCheckError
from kvision.geometry.conversions.pixels import filled

__all__ = ["convert_boxes", "convert_keypoints"]

BoxFormat: TypeAlias = Literal[
    "xyxy",
    "xywh",
    "cxcywh",
    "xyxy_plus",
    "normalized_xyxy",
    "normalized_xywh",
    "normalized_cxcywh",
    "cxcywhr",
    "xywhr",
    "xyxyxyxy",
]
_BOXES = get_args(BoxFormat)
PointFormat: TypeAlias = Literal["centers", "edges", "normalized_edges"]
_POINTS = get_args(PointFormat)
_NORMALIZED = "normalized_"
_CORNERS = ("xyxy", "xywh", "cxcywh")
_ROTATED = {"cxcywhr": 5, "xywhr": 5, "xyxyxyxy": 8}  # and how many numbers a box has


def convert_boxes(
    boxes: Tensor, in_mode: BoxFormat, out_mode: BoxFormat, image_size: tuple[int, int] | None = None
) -> Tensor:
    """Convert boxes from one of the formats of data sets and libraries to another.

    The modes, x before y, where all of an image is a box of width W and height H:

    - "xyxy": the edges at the upper left and the lower right, (0, 0, W, H), as torchvision and Pascal VOC in Albumentations;
    - "xywh": the edge at the upper left and the size, (0, 0, W, H), as COCO;
    - "cxcywh": the middle and the size, (W / 2, H / 2, W, H), as DETR;
    - "xyxy_plus": the first and the last pixel, (0, 0, W - 1, H - 1), as torchvision's masks_to_boxes;
    - "normalized_xyxy", "normalized_xywh", "normalized_cxcywh": the same in fractions of the image; the last is YOLO's;
    - "cxcywhr", "xywhr", "xyxyxyxy": rotated boxes by edges, as torchvision: middle or first corner, size, and degrees
      counter-clockwise in the picture; or the corners, of which the first is the upper left one before the rotation, and
      the others follow clockwise.

    Args:
        boxes: boxes of shape (*, 4), rotated ones (*, 5) or (*, 8), in pixels or in fractions of the image. Integers give
            float32.
        in_mode: the mode of `boxes`.
        out_mode: the mode of the result.
        image_size: height and width of the image in pixels, needed where one mode alone is normalized.

    Returns:
        Boxes of shape (*, 4), (*, 5) or (*, 8). Boxes of size 0 or less are converted by the same formulas. Rotated modes give
        degrees in (-180, 180] from corners and 0 from upright boxes.

    Raises:
        TypeError: `boxes` is not a tensor of real numbers, or `image_size` is not two ints.
        ValueError: `boxes` is not of the shape of its mode, a mode is unknown, `image_size` is missing or below 1, or
            rotated boxes are to become upright ones: the box around their corners is another box.

    Example:
        >>> import torch, kvision as K
        >>> coco = torch.tensor([[10.0, 20, 30, 40]])
        >>> K.geometry.convert_boxes(coco, "xywh", "xyxy")
        tensor([[10., 20., 40., 60.]])
        >>> K.geometry.convert_boxes(coco, "xywh", "normalized_cxcywh", (80, 100))
        tensor([[0.2500, 0.5000, 0.3000, 0.5000]])
    """
    op = "convert_boxes"
    _check.choice(op, "in_mode", in_mode, _BOXES)
    _check.choice(op, "out_mode", out_mode, _BOXES)
    _check.trailing_shape(op, "boxes", boxes, _ROTATED.get(in_mode, 4))
    if in_mode in _ROTATED and out_mode not in _ROTATED:
        raise ValueCheckError(
            f"{op}: expected out_mode to be one of {tuple(_ROTATED)} from {in_mode!r}, got {out_mode!r}; the edges around "
            "rotated boxes are the least and the largest of their corners, 'xyxyxyxy'"
        )
    size = _size(op, in_mode, out_mode, image_size)
    if out_mode in _ROTATED:
        return _rotated_boxes(floats(boxes), in_mode, out_mode, size)
    return _converted_boxes(floats(boxes), in_mode, out_mode, size)


@with_kernel_casts
def _converted_boxes(boxes: Tensor, in_mode: str, out_mode: str, size: Sequence[int] | None) -> Tensor:
    near, far = boxes.split(2, -1)
    form = in_mode.removeprefix(_NORMALIZED)
    if form == "xywh":
        far = near + far
    elif form == "cxcywh":
        near, far = near - far / 2, near + far / 2
    elif form == "xyxy_plus":
        far = far + 1
    near, far = (_scaled(edge, in_mode, out_mode, size) for edge in (near, far))
    form = out_mode.removeprefix(_NORMALIZED)
    if form == "xywh":
        far = far - near
    elif form == "cxcywh":
        near, far = (near + far) / 2, far - near
    elif form == "xyxy_plus":
        far = far - 1
    return torch.cat([near, far], -1)


@with_kernel_casts
def _rotated_boxes(boxes: Tensor, in_mode: str, out_mode: str, size: Sequence[int] | None) -> Tensor:
    """Boxes of any mode in a rotated one, by way of their middles, sizes and angles."""
    if in_mode == out_mode:
        return boxes.clone()
    if in_mode == "xyxyxyxy":
        first, second, third, _ = boxes.unflatten(-1, (4, 2)).unbind(-2)
        across, down = second - first, third - second
        width, height = torch.linalg.vector_norm(across, dim=-1), torch.linalg.vector_norm(down, dim=-1)
        middle, angle = (first + third) / 2, torch.rad2deg(torch.atan2(-across[..., 1], across[..., 0]))
    elif in_mode in _ROTATED:
        middle, (width, height, angle) = boxes[..., :2], boxes[..., 2:].unbind(-1)
    else:
        upright = _converted_boxes(boxes, in_mode, "cxcywh", size)
        middle, (width, height), angle = upright[..., :2], upright[..., 2:].unbind(-1), torch.zeros_like(boxes[..., 0])
    cos, sin = torch.cos(torch.deg2rad(angle)), torch.sin(torch.deg2rad(angle))
    right = torch.stack([cos, -sin], -1) * width[..., None] / 2  # y points down
    down = torch.stack([sin, cos], -1) * height[..., None] / 2
    if in_mode == "xywhr":
        middle = middle + right + down
    if out_mode == "xyxyxyxy":
        return torch.cat(
            [middle - right - down, middle + right - down, middle + right + down, middle - right + down], -1
        )
    point = middle - right - down if out_mode == "xywhr" else middle
    return torch.cat([point, torch.stack([width, height, angle], -1)], -1)


def convert_keypoints(
    keypoints: Tensor, in_mode: PointFormat, out_mode: PointFormat, image_size: tuple[int, int] | None = None
) -> Tensor:
    """Convert key points between coordinates that begin at the first pixel's center and such that begin at its edge.

    The modes, x before y, where the first pixel's center is:

    - "centers": (0, 0), as everywhere in kvision, in OpenCV and in scikit-image;
    - "edges": (.5, .5), as in COLMAP, PyTorch3D and Pillow's transforms;
    - "normalized_edges": (.5 / W, .5 / H), in fractions of the image, as YOLO and MediaPipe.

    :func:`normalize_pixel_coordinates` converts to the coordinates from -1 to 1 of `grid_sample`.

    Args:
        keypoints: points (x, y) of shape (*, 2). Integers give float32.
        in_mode: the mode of `keypoints`.
        out_mode: the mode of the result.
        image_size: height and width of the image in pixels, needed where one mode alone is normalized.

    Returns:
        Points (x, y) of shape (*, 2).

    Raises:
        TypeError: `keypoints` is not a tensor of real numbers, or `image_size` is not two ints.
        ValueError: `keypoints` is not of shape (*, 2), a mode is unknown, or `image_size` is missing or below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.convert_keypoints(torch.tensor([[0.5, 0.5]]), "edges", "centers")
        tensor([[0., 0.]])
        >>> K.geometry.convert_keypoints(torch.tensor([[0.5, 0.5]]), "normalized_edges", "centers", (4, 8))
        tensor([[3.5000, 1.5000]])
    """
    op = "convert_keypoints"
    _check.trailing_shape(op, "keypoints", keypoints, 2)
    _check.choice(op, "in_mode", in_mode, _POINTS)
    _check.choice(op, "out_mode", out_mode, _POINTS)
    size = _size(op, in_mode, out_mode, image_size)
    return _converted_points(floats(keypoints), in_mode, out_mode, size)


@with_kernel_casts
def _converted_points(points: Tensor, in_mode: str, out_mode: str, size: Sequence[int] | None) -> Tensor:
    if in_mode == out_mode:
        return points.clone()
    edges = points + 0.5 if in_mode == "centers" else points
    edges = _scaled(edges, in_mode, out_mode, size)
    return edges - 0.5 if out_mode == "centers" else edges


def _size(op: str, in_mode: str, out_mode: str, image_size: Any) -> tuple[int, ...] | None:
    """Height and width, where they are given."""
    if image_size is not None:
        return _check.ints(op, "image_size", image_size, 2)
    if in_mode.startswith(_NORMALIZED) != out_mode.startswith(_NORMALIZED):
        raise ValueCheckError(f"{op}: expected image_size, (height, width), from {in_mode!r} to {out_mode!r}, got None")
    return None


def _scaled(points: Tensor, in_mode: str, out_mode: str, size: Sequence[int] | None) -> Tensor:
    """Points (*, 2) by edges, from fractions to pixels or back where the modes ask for it."""
    normalized = in_mode.startswith(_NORMALIZED)
    if size is None or normalized == out_mode.startswith(_NORMALIZED):
        return points
    width_height = filled([size[::-1]], points)[0]
    return points * width_height if normalized else points / width_height
