"""Warps of volumes (B, C, D, H, W). Coordinates and matrices are (x, y, z), sizes (depth, height, width)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._choices import Linear, Padding
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._modes import INTERPOLATION, INTERPOLATION_NAMES, PADDING, PADDING_NAMES, WARP_FORMULA
from kvision._ops import on_cuda, register
from kvision.core.exceptions import ShapeError
from kvision.geometry.conversions.homogeneous import homogeneous
from kvision.geometry.conversions.pixels import by_axes
from kvision.geometry.linalg import inverse4x4
from kvision.geometry.transform import matrices, sampling
from kvision.geometry.transform.nearest import as_values, of_values
from kvision.geometry.transform.warp import transform_grid, transformed_grid

__all__ = [
    "affine3d",
    "homography_warp3d",
    "rotate3d",
    "warp_affine3d",
    "warp_grid3d",
    "warp_perspective3d",
]

_PADDINGS = get_args(Padding)

_MODES = get_args(Linear)


def warp_perspective3d(
    src: Tensor,
    M: Tensor,
    dsize: tuple[int, int, int],
    flags: Linear = "bilinear",
    border_mode: Padding = "zeros",
    align_corners: bool = False,
) -> Tensor:
    """Warp volumes by homographies from their voxels to those of the result.

    Args:
        src: volumes (B, C, D, H, W). Integers are computed in float32, but 'nearest' keeps them.
        M: (B, 4, 4), or (1, 4, 4) for all volumes, or (4, 4).
        dsize: depth, height and width of the result.
        flags: 'bilinear', in all three directions, or 'nearest'.
        border_mode: 'zeros', 'border' or 'reflection'.
        align_corners: mirror at the centers of the outermost voxels, not at their edges. Only 'reflection' uses it.

    Returns:
        (B, C, d, h, w).

    Raises:
        TypeError: `src` or `M` is not a tensor of real numbers; `dsize` is not three ints; `align_corners` is not a bool.
        ValueError: `src` is not (B, C, D, H, W); `M` is not (B, 4, 4), (1, 4, 4) or (4, 4); an entry of `dsize` is
            below 1; `flags` or `border_mode` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> volume = torch.arange(3.0).reshape(1, 1, 3, 1, 1)
        >>> deeper = torch.eye(4)
        >>> deeper[2, 3] = 1
        >>> K.geometry.warp_perspective3d(volume, deeper, (3, 1, 1)).flatten()
        tensor([0., 0., 1.])
    """
    op = "warp_perspective3d"
    _check.volumes(op, "src", src)
    _check.numbers(op, "M", M)
    M = M[None] if M.dim() == 2 else M
    _check.shape(op, "M", M, "B", 4, 4)
    return by_matrix(op, src, M, dsize, flags, border_mode, align_corners)


def warp_affine3d(
    src: Tensor,
    M: Tensor,
    dsize: tuple[int, int, int],
    flags: Linear = "bilinear",
    padding_mode: Padding = "zeros",
    align_corners: bool = True,
) -> Tensor:
    """Warp volumes by affine matrices from their voxels to those of the result.

    Args:
        src: volumes (B, C, D, H, W). Integers are computed in float32, but 'nearest' keeps them.
        M: (B, 3, 4), or (1, 3, 4) for all volumes.
        dsize: depth, height and width of the result.
        flags: 'bilinear', in all three directions, or 'nearest'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: mirror at the centers of the outermost voxels, not at their edges. Only 'reflection' uses it.

    Returns:
        (B, C, d, h, w).

    Raises:
        TypeError: `src` or `M` is not a tensor of real numbers; `dsize` is not three ints; `align_corners` is not a bool.
        ValueError: `src` is not (B, C, D, H, W); `M` is not (B, 3, 4) or (1, 3, 4); an entry of `dsize` is below 1;
            `flags` or `padding_mode` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> volume = torch.arange(3.0).reshape(1, 1, 1, 1, 3)
        >>> K.geometry.warp_affine3d(volume, torch.eye(3, 4)[None], (1, 1, 3)).flatten()
        tensor([0., 1., 2.])
    """
    _check.volumes("warp_affine3d", "src", src)
    _check.shape("warp_affine3d", "M", M, "B", 3, 4)
    return by_matrix("warp_affine3d", src, M, dsize, flags, padding_mode, align_corners)


def affine3d(
    tensor: Tensor,
    matrix: Tensor,
    mode: Linear = "bilinear",
    padding_mode: Padding = "zeros",
    align_corners: bool = False,
) -> Tensor:
    """Warp volumes by affine matrices, keeping their size.

    Args:
        tensor: volumes (B, C, D, H, W) or (C, D, H, W). Integers are computed in float32, but 'nearest' keeps them.
        matrix: (B, 3, 4), or (1, 3, 4) for all volumes: voxels (x, y, z) of the volume to those of the result.
        mode: 'bilinear', in all three directions, or 'nearest'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: mirror at the centers of the outermost voxels, not at their edges. Only 'reflection' uses it.

    Returns:
        Volumes of the shape of `tensor`.

    Raises:
        TypeError: `tensor` or `matrix` is not a tensor of real numbers; `align_corners` is not a bool.
        ValueError: `tensor` is not (B, C, D, H, W) or (C, D, H, W); `matrix` is not (B, 3, 4) or (1, 3, 4); `mode` or
            `padding_mode` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.affine3d(torch.rand(1, 2, 3, 4), torch.eye(3, 4)[None]).shape
        torch.Size([1, 2, 3, 4])
    """
    volumes = _volumes("affine3d", tensor)
    _check.shape("affine3d", "matrix", matrix, "B", 3, 4)
    size = tuple(volumes.shape[2:])
    result = by_matrix("affine3d", volumes, matrix, size, mode, padding_mode, align_corners)
    return result[0] if tensor.dim() == 4 else result


def rotate3d(
    tensor: Tensor,
    yaw: Tensor,
    pitch: Tensor,
    roll: Tensor,
    center: Tensor | None = None,
    mode: Linear = "bilinear",
    padding_mode: Padding = "zeros",
    align_corners: bool = False,
) -> Tensor:
    """Rotate volumes about an axis through a center, keeping their size.

    Args:
        tensor: volumes (B, C, D, H, W) or (C, D, H, W). Integers are computed in float32, but 'nearest' keeps them.
        yaw: x of the axis of rotation times the angle in degrees, (B,) or one number.
        pitch: y of the axis of rotation times the angle in degrees, (B,) or one number.
        roll: z of the axis of rotation times the angle in degrees, (B,) or one number.
        center: (B, 3) or (1, 3) as (x, y, z); None for the center of the volume.
        mode: 'bilinear' or 'nearest'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: mirror at the centers of the outermost voxels, not at their edges. Only 'reflection' uses it.

    Returns:
        Volumes of the shape of `tensor`.

    Raises:
        TypeError: `tensor`, an angle or `center` is not a tensor of real numbers; `align_corners` is not a bool.
        ValueError: `tensor` is not (B, C, D, H, W) or (C, D, H, W); an angle has neither B nor 1 numbers; `center` is
            not (B, 3) or (1, 3); `mode` or `padding_mode` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> zero, quarter = torch.zeros(1), torch.tensor([90.0])
        >>> K.geometry.rotate3d(torch.rand(1, 2, 3, 3), zero, zero, quarter).shape
        torch.Size([1, 2, 3, 3])
    """
    volumes = _volumes("rotate3d", tensor)
    batch, dtype = volumes.shape[0], compute_dtype(volumes)
    angles = []
    for name, angle in (("yaw", yaw), ("pitch", pitch), ("roll", roll)):
        _check.numbers("rotate3d", name, angle)
        if not _check.is_one_or(angle.numel(), batch):
            raise ShapeError(f"rotate3d: expected {name} of shape ({batch},), got {tuple(angle.shape)}")
        angle = _check.to_device_of("rotate3d", volumes, name, angle, of="tensor")
        angles.append(as_dtype(angle if angle.dim() == 1 else angle.reshape(-1), dtype))
    if center is not None:
        _check.shape("rotate3d", "center", center, "B", 3)
        center = sampling.cast_to_image("rotate3d", volumes, "center", center)
    middle = [(n - 1) / 2 for n in reversed(volumes.shape[2:])]
    if center is None and is_compiling():  # numbers of operators are constants of a program, sizes may be symbolic
        center = torch.stack([angles[0].new_full((), m) for m in middle]).expand(batch, 3)
        middle = [0.0, 0.0, 0.0]
    size = tuple(volumes.shape[2:])
    args = (*angles, None, None, center)
    result = by_formula(
        "rotate3d", volumes, size, mode, padding_mode, align_corners, True, "affine_matrix3d", [1.0, *middle], *args
    )
    return result[0] if tensor.dim() == 4 else result


def homography_warp3d(
    patch_src: Tensor,
    src_homo_dst: Tensor,
    dsize: tuple[int, int, int],
    mode: Linear = "bilinear",
    padding_mode: Padding = "zeros",
    align_corners: bool = False,
    normalized_coordinates: bool = True,
) -> Tensor:
    """Warp volumes by homographies from coordinates in the result to coordinates in the volume, from -1 to 1.

    Args:
        patch_src: volumes (B, C, D, H, W). Integers are computed in float32, but 'nearest' keeps them.
        src_homo_dst: (B, 4, 4), or (1, 4, 4) for all volumes.
        dsize: depth, height and width of the result.
        mode: 'bilinear' or 'nearest'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: -1 and 1 are the centers of the outermost voxels, not their outer edges.
        normalized_coordinates: coordinates are from -1 to 1; False: they are voxels.

    Returns:
        (B, C, d, h, w).

    Raises:
        TypeError: `patch_src` or `src_homo_dst` is not a tensor of real numbers; `dsize` is not three ints;
            `align_corners` or `normalized_coordinates` is not a bool.
        ValueError: `patch_src` is not (B, C, D, H, W); `src_homo_dst` is not (B, 4, 4) or (1, 4, 4); an entry of
            `dsize` is below 1; `mode` or `padding_mode` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> volume = torch.rand(1, 1, 2, 3, 4)
        >>> torch.allclose(K.geometry.homography_warp3d(volume, torch.eye(4)[None], (2, 3, 4)), volume, atol=1e-6)
        True
    """
    op = "homography_warp3d"
    _check.volumes(op, "patch_src", patch_src)
    _check.shape(op, "src_homo_dst", src_homo_dst, "B", 4, 4)
    _check.flag(op, "normalized_coordinates", normalized_coordinates)
    return by_matrix(
        op, patch_src, src_homo_dst, dsize, mode, padding_mode, align_corners, False, normalized_coordinates
    )


def warp_grid3d(grid: Tensor, src_homo_dst: Tensor) -> Tensor:
    """Transform the points of a grid by homographies of space.

    Args:
        grid: points (x, y, z), (1, D, H, W, 3) or (B, D, H, W, 3). Integers are computed in float32.
        src_homo_dst: (B, 4, 4), or (1, 4, 4) for all grids.

    Returns:
        (B, D, H, W, 3) as (x, y, z).

    Raises:
        TypeError: `grid` or `src_homo_dst` is not a tensor of real numbers.
        ValueError: `grid` is not (B, D, H, W, 3); `src_homo_dst` is not (B, 4, 4); the tensors are on different
            devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.warp_grid3d(torch.ones(1, 1, 1, 1, 3), torch.diag(torch.tensor([2.0, 3, 4, 1]))[None]).flatten()
        tensor([2., 3., 4.])
    """
    _check.shape("warp_grid3d", "grid", grid, "B", "D", "H", "W", 3)
    _check.shape("warp_grid3d", "src_homo_dst", src_homo_dst, "B", 4, 4)
    src_homo_dst = _check.to_device_of("warp_grid3d", grid, "src_homo_dst", src_homo_dst, of="grid")
    _check.broadcastable("warp_grid3d", grid=grid.shape[:1], src_homo_dst=src_homo_dst.shape[:1])
    return transformed_grid(floats(grid), src_homo_dst)


# --- shared by the functions ------------------------------------------------------------------------------------------


def _volumes(op: str, tensor: Tensor) -> Tensor:
    """Volumes (B, C, D, H, W) or one volume (C, D, H, W) as (B, C, D, H, W)."""
    _check.numbers(op, "tensor", tensor)
    volumes = tensor[None] if tensor.dim() == 4 else tensor
    _check.volumes(op, "tensor", volumes)
    return volumes


def by_matrix(
    op: str,
    volumes: Tensor,
    matrix: Tensor,
    dsize: tuple[int, ...],
    mode: str,
    padding_mode: str,
    align_corners: bool,
    inverse: bool = True,
    normalized: bool = False,
) -> Tensor:
    """Warp volumes by matrices (B, 3, 4) or (B, 4, 4)."""
    options = _volume_options(op, dsize, mode, padding_mode, align_corners)
    values = floats(as_values(volumes, mode))
    matrix = sampling.cast_to_image(op, values, "matrix", matrix)
    return of_values(_warp3d(values, matrix, *options, inverse, normalized), volumes, mode)


def by_formula(
    op: str,
    volumes: Tensor,
    dsize: tuple[int, ...],
    mode: str,
    padding_mode: str,
    align_corners: bool,
    inverse: bool,
    formula: str,
    numbers: list[float],
    *args: Tensor | None,
) -> Tensor:
    """Warp volumes by the matrix that a formula computes from numbers and up to six tensors in the dtype of the computation."""
    options = _volume_options(op, dsize, mode, padding_mode, align_corners)
    six = args + (None,) * (6 - len(args))
    values = floats(as_values(volumes, mode))
    warped = _warp3d_by_formula(values, *six, WARP_FORMULA[formula], numbers, *options, inverse, False)
    return of_values(warped, volumes, mode)


def _volume_options(
    op: str, dsize: tuple[int, ...], mode: str, padding_mode: str, align_corners: bool
) -> tuple[Any, ...]:
    size = _check.ints(op, "dsize", dsize, 3)
    _check.choice(op, "mode", mode, _MODES)
    _check.choice(op, "padding_mode", padding_mode, _PADDINGS)
    _check.flag(op, "align_corners", align_corners)
    padding = PADDING["fill" if padding_mode == "zeros" else padding_mode]
    return list(size), INTERPOLATION[mode], padding, align_corners


# --- the operators --------------------------------------------------------------------------------------------------


def _reference(volumes, matrix, size, interpolation, padding, align_corners, inverse, normalized):
    m = matrices.promoted(matrix)
    m = homogeneous(m) if m.shape[1] == 3 else m
    if inverse:
        m = inverse4x4(m)
    if normalized:
        source, output = volumes.shape[2:], size
        m = _from_unit(source, align_corners, m) @ m @ _to_unit(output, align_corners, m)
    axes = [torch.arange(n, dtype=matrix.dtype, device=matrix.device) for n in size]
    z, y, x = torch.meshgrid(*axes, indexing="ij")
    coords = transform_grid(torch.stack([x, y, z], -1)[None], m.to(matrix.dtype)).unbind(-1)
    coords = [p.expand(volumes.shape[0], -1, -1, -1) for p in coords]
    return sampling.sample(volumes, coords, INTERPOLATION_NAMES[interpolation], PADDING_NAMES[padding], align_corners)


def _from_unit(size: Sequence[int], align_corners: bool, like: Tensor) -> Tensor:
    """The map from [-1, 1] to voxel indices."""
    less = 1 if align_corners else 0
    return by_axes([((n - less) / 2, (n - 1) / 2) for n in reversed(size)], like.device, like.dtype)


def _to_unit(size: Sequence[int], align_corners: bool, like: Tensor) -> Tensor:
    less = 1 if align_corners else 0
    # The only voxel of an axis is at 0.
    scales = [2 / (n - less) if n > less else 0.0 for n in reversed(size)]
    lines = [(scale, -scale * (n - 1) / 2) for scale, n in zip(scales, reversed(size))]
    return by_axes(lines, like.device, like.dtype)


def _backward(needs, grad, volumes, matrix, size, *options):
    grads = [None, None]
    promoted = grad.to(matrix.dtype)
    if needs[0]:
        grads[0] = _volume_backward(promoted, matrix, list(volumes.shape[2:]), *options).to(grad.dtype)
    if needs[1]:
        grads[1] = _matrix_backward(promoted, volumes.to(matrix.dtype), matrix, *options).sum_to_size(matrix.shape)
    return grads


def _volume_backward_reference(grad, matrix, size, *options):
    def of_volumes(volumes: Tensor) -> Tensor:
        return _reference(volumes, matrix, grad.shape[2:], *options)

    _, vjp_fn = torch.func.vjp(of_volumes, grad.new_zeros(*grad.shape[:2], *size))
    return vjp_fn(grad)[0]


def _matrix_backward_reference(grad, volumes, matrix, *options):
    def of_matrix(matrix: Tensor) -> Tensor:
        return _reference(volumes, matrix, grad.shape[2:], *options)

    _, vjp_fn = torch.func.vjp(of_matrix, matrix.expand(volumes.shape[0], -1, -1))
    return vjp_fn(grad)[0]


_warp3d = register(
    "warp3d",
    _reference,
    fake=lambda volumes, matrix, size, *options: (*volumes.shape[:2], *size),
    backward=_backward,
)
_volume_backward = register(
    "warp3d_volume_backward",
    _volume_backward_reference,
    fake=lambda grad, matrix, size, *options: (*grad.shape[:2], *size),
    gradients="grad: warp3d(volumes=grad_grad, size=sizes(grad)); matrix: reference",
    nondeterministic=on_cuda,
)
_matrix_backward = register(
    "warp3d_matrix_backward",
    _matrix_backward_reference,
    fake=lambda grad, volumes, matrix, *options: matrix.new_empty(volumes.shape[0], *matrix.shape[1:]),
)
_warp3d_by_formula = sampling.register_warp_by_formula(
    _warp3d,
    {
        "affine_matrix3d": sampling.Formula(matrices.affine_matrix3d, 12, (3,)),
        "translation_matrix3d": sampling.Formula(matrices.translation_matrix3d, 1, (3,)),
        "perspective_matrix3d": sampling.Formula(matrices.perspective_matrix3d, 2),
    },
)
