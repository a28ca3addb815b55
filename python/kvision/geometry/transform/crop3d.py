"""Crops of volumes. Boxes are (B, 8, 3): front four corners (x, y, z) from the top left, clockwise, then the back four."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Linear, Padding
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.geometry.bbox import corners
from kvision.geometry.transform import sampling
from kvision.geometry.transform.crop import rows
from kvision.geometry.transform.warp3d import by_formula, warp_affine3d, warp_perspective3d

__all__ = ["center_crop3d", "crop_and_resize3d", "crop_by_boxes3d", "crop_by_transform_mat3d"]


def crop_and_resize3d(
    tensor: Tensor,
    boxes: Tensor,
    size: tuple[int, int, int],
    interpolation: Linear = "bilinear",
    align_corners: bool = False,
) -> Tensor:
    """Resample a box of each volume to a size; its corners go to the corner voxels of the result.

    Args:
        tensor: volumes (B, C, D, H, W). Integers are computed in float32, but 'nearest' keeps them.
        boxes: (B, 8, 3), or (1, 8, 3) for all volumes, larger than 0 along every axis.
        size: depth, height and width of the result.
        interpolation: 'bilinear', in all three directions, or 'nearest'.
        align_corners: no effect on the result: corners of boxes are centers of voxels, and the padding is zeros.

    Returns:
        (B, C, d, h, w).

    Raises:
        TypeError: `tensor` or `boxes` is not a tensor of real numbers; `size` is not three ints; `align_corners` is not
            a bool.
        ValueError: `tensor` is not (B, C, D, H, W); `boxes` is not (B, 8, 3) or (1, 8, 3); an entry of `size` is below
            1; `interpolation` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> volume = torch.arange(8.0).reshape(1, 1, 2, 2, 2)
        >>> x, y, z = [0.0, 1, 1, 0] * 2, [0.0, 0, 1, 1] * 2, [0.0] * 4 + [1.0] * 4
        >>> box = torch.tensor([x, y, z]).T[None]
        >>> K.geometry.crop_and_resize3d(volume, box, (1, 1, 2)).flatten().round(decimals=3)
        tensor([0., 1.])
    """
    op = "crop_and_resize3d"
    _check.volumes(op, "tensor", tensor)
    d, h, w = _check.ints(op, "size", size, 3)
    return _crop(op, tensor, boxes, None, (d, h, w), interpolation, align_corners)


def crop_by_boxes3d(
    tensor: Tensor, src_box: Tensor, dst_box: Tensor, interpolation: Linear = "bilinear", align_corners: bool = False
) -> Tensor:
    """Resample one box of each volume into another box of the result, which has the size of that box.

    The size of the result is read from `dst_box`, which waits for the device.

    Args:
        tensor: volumes (B, C, D, H, W). Integers are computed in float32, but 'nearest' keeps them.
        src_box: (B, 8, 3), or (1, 8, 3) for all volumes.
        dst_box: (B, 8, 3), or (1, 8, 3), boxes that all have the same size.
        interpolation: 'bilinear', in all three directions, or 'nearest'.
        align_corners: no effect on the result: corners of boxes are centers of voxels, and the padding is zeros.

    Returns:
        (B, C, d, h, w).

    Raises:
        TypeError: `tensor` or a box is not a tensor of real numbers; `align_corners` is not a bool.
        ValueError: `tensor` is not (B, C, D, H, W); a box is not (B, 8, 3) or (1, 8, 3); the boxes of `dst_box` have
            different sizes; `interpolation` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> x, y, z = [1.0, 2, 2, 1] * 2, [1.0, 1, 2, 2] * 2, [0.0] * 4 + [1.0] * 4
        >>> box = torch.tensor([x, y, z]).T[None]
        >>> K.geometry.crop_by_boxes3d(torch.rand(1, 1, 3, 4, 5), box, box).shape
        torch.Size([1, 1, 2, 2, 2])
    """
    op = "crop_by_boxes3d"
    _check.volumes(op, "tensor", tensor)
    _check.shape(op, "dst_box", dst_box, "B", 8, 3)
    _check.subtractable(op, dst_box=dst_box)
    extents = {tuple(extent) for extent in rows(dst_box[:, 6] - dst_box[:, 0])}
    if len(extents) != 1:
        raise ValueCheckError(f"{op}: expected dst_box of one size, got extents of {sorted(extents)}")
    w, h, d = (int(side) + 1 for side in extents.pop())
    return _crop(op, tensor, src_box, dst_box, (d, h, w), interpolation, align_corners)


def crop_by_transform_mat3d(
    tensor: Tensor,
    transform: Tensor,
    out_size: tuple[int, int, int],
    mode: Linear = "bilinear",
    padding_mode: Padding = "zeros",
    align_corners: bool = True,
) -> Tensor:
    """Warp volumes and keep the first voxels of the result.

    This is :func:`warp_perspective3d` for matrices (B, 4, 4) and :func:`warp_affine3d` for (B, 3, 4).

    Args:
        tensor: volumes (B, C, D, H, W). Integers are computed in float32, but 'nearest' keeps them.
        transform: (B, 4, 4) or (B, 3, 4), from voxels (x, y, z) of the volume to those of the result; one matrix serves
            all volumes.
        out_size: depth, height and width of the result.
        mode: 'bilinear', in all three directions, or 'nearest'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: mirror at the centers of the outermost voxels, not at their edges. Only 'reflection' uses it.

    Returns:
        (B, C, d, h, w).

    Raises:
        TypeError: `tensor` or `transform` is not a tensor of real numbers; `out_size` is not three ints; `align_corners`
            is not a bool.
        ValueError: `tensor` is not (B, C, D, H, W); `transform` is not (B, 4, 4) or (B, 3, 4); an entry of `out_size`
            is below 1; `mode` or `padding_mode` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.crop_by_transform_mat3d(torch.rand(1, 1, 3, 4, 5), torch.eye(4)[None], (1, 2, 2)).shape
        torch.Size([1, 1, 1, 2, 2])
    """
    _check.numbers("crop_by_transform_mat3d", "tensor", tensor)
    _check.numbers("crop_by_transform_mat3d", "transform", transform)
    if transform.dim() != 3 or transform.shape[1:] not in ((3, 4), (4, 4)):
        raise ShapeError(
            f"crop_by_transform_mat3d: expected transform of shape (B, 4, 4) or (B, 3, 4), got {tuple(transform.shape)}"
        )
    warp = warp_affine3d if transform.shape[1] == 3 else warp_perspective3d
    return warp(tensor, transform, out_size, mode, padding_mode, align_corners)


def center_crop3d(
    tensor: Tensor, size: tuple[int, int, int], interpolation: Linear = "bilinear", align_corners: bool = True
) -> Tensor:
    """Crop volumes around their center.

    The crop lies between voxels, and is interpolated, where the sizes differ by an odd number.

    Args:
        tensor: volumes (B, C, D, H, W). Integers are computed in float32, but 'nearest' keeps them.
        size: depth, height and width of the result.
        interpolation: 'bilinear', in all three directions, or 'nearest'.
        align_corners: no effect on the result: the padding is zeros.

    Returns:
        (B, C, d, h, w).

    Raises:
        TypeError: `tensor` is not a tensor of real numbers; `size` is not three ints; `align_corners` is not a bool.
        ValueError: `tensor` is not (B, C, D, H, W); an entry of `size` is below 1; `interpolation` is unknown.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.center_crop3d(torch.arange(5.0).reshape(1, 1, 1, 1, 5), (1, 1, 3)).flatten()
        tensor([1., 2., 3.])
    """
    op = "center_crop3d"
    _check.volumes(op, "tensor", tensor)
    size = _check.ints(op, "size", size, 3)  # type: ignore[assignment]  # three entries by construction
    first = [(n - k) / 2 for n, k in zip(reversed(tensor.shape[2:]), reversed(size))]
    shift = []
    if _check.is_symbolic(*tensor.shape[2:], *size):
        shift, first = [sampling.symbolic_point(tensor, *first)], [0.0, 0.0, 0.0]
    options = (interpolation, "zeros", align_corners, False, "translation_matrix3d", first)
    return by_formula(op, tensor, size, *options, *shift)


def _crop(op, tensor, src_box, dst_box, size, interpolation, align_corners):
    """Resample the boxes `src_box` into the boxes `dst_box`; None stands for the whole result."""
    _check.shape(op, "src_box", src_box, "B", 8, 3)
    volumes = tensor
    boxes = [sampling.cast_to_image(op, volumes, "src_box", src_box)]
    if dst_box is not None:
        boxes.append(sampling.cast_to_image(op, volumes, "dst_box", dst_box))
    extent = [max(n - 1, 1) for n in reversed(size)]
    if dst_box is None and _check.is_symbolic(*size):
        last = sampling.symbolic_point(volumes, *extent)
        boxes.append(corners(torch.zeros_like(last), last))
    extent = [0.0] * 3 if len(boxes) > 1 else [float(n) for n in extent]
    return by_formula(
        op, volumes, size, interpolation, "zeros", align_corners, True, "perspective_matrix3d", extent, *boxes
    )
