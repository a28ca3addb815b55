"""Boxes as tensors of their corners (x, y) or (x, y, z).

Corners are inclusive: a box from pixel 0 to pixel 9 is 10 wide. The corners of a rectangle go clockwise from the top left.
The corners of a 3D box are those of its front face, then those of its back face, in the same order.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from typing import Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype, floats
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.geometry._transform_points import transformed
from kvision.geometry.detection.suppression import nms

__all__ = [
    "bbox_generator",
    "bbox_generator3d",
    "bbox_to_mask",
    "bbox_to_mask3d",
    "infer_bbox_shape",
    "infer_bbox_shape3d",
    "nms",
    "transform_bbox",
    "validate_bbox",
    "validate_bbox3d",
]

BoxMode: TypeAlias = Literal["xyxy", "xywh"]
_MODES = get_args(BoxMode)
# --- corners --------------------------------------------------------------------------------------------------------


def corners(near: Tensor, far: Tensor) -> Tensor:
    """The 4 or 8 corners (*, V, D) of boxes from their first and their last corner, (*, D) each."""
    return _corners(near.unbind(-1), far.unbind(-1))


def _corners(near: Sequence[Tensor], far: Sequence[Tensor]) -> Tensor:
    """`corners` of points given axis by axis."""
    x, y, *z = zip(near, far)
    around = [(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])]
    vertices = [(*corner, *depth) for depth in itertools.product(*z) for corner in around]
    return torch.stack([c for vertex in vertices for c in vertex], -1).unflatten(-1, (len(vertices), -1))


def bbox_generator(x_start: Tensor, y_start: Tensor, width: Tensor, height: Tensor) -> Tensor:
    """The corners of rectangles from their top left corners and sizes.

    Args:
        x_start: left edges, of shape () or (B,).
        y_start: top edges, of the shape and type of `x_start`.
        width: widths in pixels, of shape () or (B,) and the type of `x_start`.
        height: heights in pixels, of shape () or (B,) and the type of `x_start`.

    Returns:
        Corners of shape (B, 4, 2). The last pixel of a box is at start + size - 1.

    Raises:
        TypeError: an argument is not a tensor of real numbers, or the types differ.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.bbox_generator(*torch.tensor([0, 1, 5, 2]))
        tensor([[[0, 1],
                 [4, 1],
                 [4, 2],
                 [0, 2]]])
    """
    return _generated("bbox_generator", x_start=x_start, y_start=y_start, width=width, height=height)


def bbox_generator3d(
    x_start: Tensor, y_start: Tensor, z_start: Tensor, width: Tensor, height: Tensor, depth: Tensor
) -> Tensor:
    """The corners of 3D boxes from their first corners and sizes.

    Args:
        x_start: left edges, of shape () or (B,).
        y_start: top edges, of the shape and type of `x_start`.
        z_start: front edges, of the shape and type of `x_start`.
        width: widths in voxels, of shape () or (B,) and the type of `x_start`.
        height: heights in voxels, of shape () or (B,) and the type of `x_start`.
        depth: depths in voxels, of shape () or (B,) and the type of `x_start`.

    Returns:
        Corners of shape (B, 8, 3). The last voxel of a box is at start + size - 1.

    Raises:
        TypeError: an argument is not a tensor of real numbers, or the types differ.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.bbox_generator3d(*torch.tensor([0, 1, 2, 5, 2, 3]))[0, 6]
        tensor([4, 2, 4])
    """
    starts = {"x_start": x_start, "y_start": y_start, "z_start": z_start}
    return _generated("bbox_generator3d", **starts, width=width, height=height, depth=depth)


def _generated(op: str, **tensors: Tensor) -> Tensor:
    for name, x in tensors.items():
        _check.numbers(op, name, x)
        if x.dim() > 1:
            raise ShapeError(f"{op}: expected {name} of shape () or (B,), got {tuple(x.shape)}")
    if len({x.dtype for x in tensors.values()}) > 1:
        dtypes = {name: x.dtype for name, x in tensors.items()}
        raise TypeCheckError(f"{op}: expected tensors of one type, got {dtypes}")
    _check.same_device(op, **tensors)
    _check.broadcastable(op, **{name: x.shape for name, x in tensors.items()})
    values = [x if x.dim() == 1 else x.reshape(1) for x in tensors.values()]
    if any(x.shape != values[0].shape for x in values):
        values = torch.broadcast_tensors(*values)
    axes = len(values) // 2
    near, far = values[:axes], [start + (size - 1) for start, size in zip(values[:axes], values[axes:])]
    return _corners(near, far)


# --- shapes and masks -----------------------------------------------------------------------------------------------


def infer_bbox_shape(boxes: Tensor) -> tuple[Tensor, Tensor]:
    """The heights and widths of rectangles with inclusive corners.

    Args:
        boxes: corners of shape (B, 4, 2).

    Returns:
        Heights and widths, each of shape (B,).

    Raises:
        TypeError: `boxes` is not a tensor of real numbers.
        ValueError: `boxes` is not of shape (B, 4, 2).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.infer_bbox_shape(torch.tensor([[[1, 1], [3, 1], [3, 2], [1, 2]]]))
        (tensor([2]), tensor([3]))
    """
    _check.shape("infer_bbox_shape", "boxes", boxes, "B", 4, 2)
    _check.subtractable("infer_bbox_shape", boxes=boxes)
    width, height = (boxes[:, 2] - boxes[:, 0] + 1).unbind(-1)
    return height, width


def infer_bbox_shape3d(boxes: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The depths, heights and widths of 3D boxes with inclusive corners.

    Args:
        boxes: corners of shape (B, 8, 3).

    Returns:
        Depths, heights and widths, each of shape (B,).

    Raises:
        TypeError: `boxes` is not a tensor of real numbers.
        ValueError: `boxes` is not of shape (B, 8, 3).

    Example:
        >>> import torch, kvision as K
        >>> box = K.geometry.bbox_generator3d(*torch.tensor([0, 1, 2, 5, 2, 3]))
        >>> K.geometry.infer_bbox_shape3d(box)
        (tensor([3]), tensor([2]), tensor([5]))
    """
    _check.shape("infer_bbox_shape3d", "boxes", boxes, "B", 8, 3)
    _check.subtractable("infer_bbox_shape3d", boxes=boxes)
    width, height, depth = (boxes[:, 6] - boxes[:, 0] + 1).unbind(-1)
    return depth, height, width


def validate_bbox(boxes: Tensor) -> bool:
    """Whether opposite sides of quadrangles are equal within 1e-4. This waits for the device.

    Args:
        boxes: corners of shape (B, 4, 2) or (B, N, 4, 2).

    Returns:
        True if all quadrangles are parallelograms. False otherwise, for tensors of other shapes and for values that are not
        finite.

    Raises:
        TypeError: `boxes` is not a tensor of real numbers.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.validate_bbox(torch.tensor([[[1, 1], [3, 1], [3, 2], [1, 2]]]))
        True
    """
    _check.numbers("validate_bbox", "boxes", boxes)
    if boxes.dim() not in (3, 4) or boxes.shape[-2:] != (4, 2):
        return False
    return bool((_edge_differences(boxes, [(0, 1, 3, 2)]) <= 1e-4).all())


def validate_bbox3d(boxes: Tensor) -> bool:
    """Raise an error unless parallel edges of 3D boxes are equal within 1e-4. This waits for the device.

    Args:
        boxes: corners of shape (B, 8, 3) or (B, N, 8, 3).

    Returns:
        True.

    Raises:
        TypeError: `boxes` is not a tensor of real numbers.
        ValueError: `boxes` is not of a shape of Args, parallel edges differ, or a value is not finite.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.validate_bbox3d(K.geometry.bbox_generator3d(*torch.tensor([0, 1, 2, 5, 2, 3])))
        True
    """
    _check.trailing_shape("validate_bbox3d", "boxes", boxes, 8, 3)
    if boxes.dim() not in (3, 4):
        raise ShapeError(
            f"validate_bbox3d: expected boxes of shape (B, 8, 3) or (B, N, 8, 3), got {tuple(boxes.shape)}"
        )
    # The edges of the front face, of the back face, and between the two.
    if not bool((_edge_differences(boxes, [(0, 1, 3, 2), (4, 5, 7, 6), (0, 4, 1, 5), (0, 4, 3, 7)]) <= 1e-4).all()):
        raise ValueCheckError("validate_bbox3d: expected boxes with parallel edges of one length")
    return True


def _edge_differences(boxes: Tensor, edges: list[tuple[int, int, int, int]]) -> Tensor:
    """The difference of the edges a b and c d; NaN where one is not finite."""
    v = floats(boxes).unbind(-2)
    return torch.stack([(v[b] - v[a] - v[d] + v[c]).abs() for a, b, c, d in edges])


def bbox_to_mask(boxes: Tensor, width: int, height: int) -> Tensor:
    """Masks of rectangles with inclusive corners: 1 inside, 0 outside.

    Args:
        boxes: corners of shape (B, 4, 2).
        width: width of the masks, in pixels.
        height: height of the masks, in pixels.

    Returns:
        Masks of shape (B, H, W), of the type of `boxes`. They carry no gradient.

    Raises:
        TypeError: `boxes` is not a tensor of real numbers, or a size is not an int.
        ValueError: `boxes` is not of shape (B, 4, 2), or a size is below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.bbox_to_mask(torch.tensor([[[1, 0], [2, 0], [2, 1], [1, 1]]]), 4, 2)
        tensor([[[0, 1, 1, 0],
                 [0, 1, 1, 0]]])
    """
    _check.shape("bbox_to_mask", "boxes", boxes, "B", 4, 2)
    for name, size in (("width", width), ("height", height)):
        _check.ints("bbox_to_mask", name, size, 1)
    return mask_between(boxes[:, 0], boxes[:, 2], (height, width)).to(boxes.dtype)


def bbox_to_mask3d(boxes: Tensor, size: tuple[int, int, int]) -> Tensor:
    """Masks of 3D boxes with inclusive corners: 1 inside, 0 outside.

    Args:
        boxes: corners of shape (B, 8, 3).
        size: depth, height and width of the masks, in voxels.

    Returns:
        Masks of shape (B, 1, D, H, W), of the type of `boxes`. They carry no gradient.

    Raises:
        TypeError: `boxes` is not a tensor of real numbers, or a size is not an int.
        ValueError: `boxes` is not of shape (B, 8, 3), or a size is below 1.

    Example:
        >>> import torch, kvision as K
        >>> box = K.geometry.bbox_generator3d(*torch.tensor([0, 1, 2, 5, 2, 3]))
        >>> K.geometry.bbox_to_mask3d(box, (9, 9, 9)).sum()
        tensor(30)
    """
    _check.shape("bbox_to_mask3d", "boxes", boxes, "B", 8, 3)
    size = _check.ints("bbox_to_mask3d", "size", size, 3)  # type: ignore[assignment]  # three entries by construction
    return mask_between(boxes[:, 0], boxes[:, 6], size)[:, None].to(boxes.dtype)


def mask_between(near: Tensor, far: Tensor, size: tuple[int, ...]) -> Tensor:
    """Masks (*, *size) of the pixels between `near` and `far`, inclusive, (*, D) each as (x, y) or (x, y, z)."""
    near, far = near.detach().to(compute_dtype(near)), far.detach().to(compute_dtype(far))
    masks = []
    for axis, n in enumerate(reversed(size)):
        i = torch.arange(n, device=near.device, dtype=near.dtype)  # torch compares numbers of one type faster
        others = [1] * len(size)
        others[-1 - axis] = n
        inside = (i >= near[..., axis, None]) & (i <= far[..., axis, None])
        masks.append(inside.unflatten(-1, others))
    return functools.reduce(torch.logical_and, masks)


# --- transformations -------------------------------------------------------------------------------------------------


def transform_bbox(
    trans_mat: Tensor, boxes: Tensor, mode: BoxMode = "xyxy", restore_coordinates: bool | None = None
) -> Tensor:
    """Transform boxes by homographies.

    Args:
        trans_mat: homographies of shape (B, 3, 3), or (1, 3, 3) for all boxes.
        boxes: boxes in the form `mode`, of shape (B, N, 4), or (N, 4) with B equal to N or 1; or corners of shape
            (B, N, 4, 2).
        mode: 'xyxy' for the first and the last corner, 'xywh' for the first corner and the size, which is the difference of
            both corners.
        restore_coordinates: None and True return the bounding box of the transformed corners. False transforms the first and
            the last corner only, and keeps their order. Corners (B, N, 4, 2) are transformed in every case.

    Returns:
        Boxes of the shape and form of `boxes`.

    Raises:
        TypeError: `trans_mat` or `boxes` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, `mode` is unknown, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> mirror = torch.tensor([[[-1.0, 0, 10], [0, 1, 0], [0, 0, 1]]])
        >>> K.geometry.transform_bbox(mirror, torch.tensor([[[1.0, 2, 4, 5]]]))
        tensor([[[6., 2., 9., 5.]]])
    """
    op = "transform_bbox"
    _check.shape(op, "trans_mat", trans_mat, "B", 3, 3)
    _check.numbers(op, "boxes", boxes)
    _check.choice(op, "mode", mode, _MODES)
    polygons = boxes.dim() == 4
    if boxes.shape[2:] != (4, 2) if polygons else boxes.dim() not in (2, 3) or boxes.shape[-1] != 4:
        raise ShapeError(
            f"{op}: expected boxes of shape (N, 4), (B, N, 4) or (B, N, 4, 2), got {tuple(boxes.shape)}",
            actual_shape=boxes.shape,
        )
    _check.same_device(op, trans_mat=trans_mat, boxes=boxes)
    if not _check.is_one_or(trans_mat.shape[0], boxes.shape[0]):
        raise ShapeError(
            f"{op}: expected trans_mat with 1 or {boxes.shape[0]} matrices, got {tuple(trans_mat.shape)}",
            actual_shape=trans_mat.shape,
        )
    boxes = floats(boxes)
    if polygons:
        return transformed(boxes, trans_mat)
    first, last = boxes.split(2, -1)
    if mode == "xywh":
        last = first + last
    if restore_coordinates is False:
        first, last = transformed(torch.stack([first, last], -2), trans_mat).unbind(-2)
    else:
        moved = transformed(corners(first, last), trans_mat)
        first, last = moved.amin(-2), moved.amax(-2)
    return torch.cat([first, last - first if mode == "xywh" else last], -1)
