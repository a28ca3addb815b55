"""Pixel coordinates, normalized coordinates in [-1, 1], and coordinates in a camera's image plane at depth 1.

The center of the first pixel is (0, 0). -1 and 1 are the centers of the outermost pixels of an axis. On an axis of one pixel,
that pixel is the origin and the scale is 1, so that all these maps are invertible.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import floats
from kvision._ops import with_kernel_casts

__all__ = [
    "denormalize_homography",
    "denormalize_homography3d",
    "denormalize_pixel_coordinates",
    "denormalize_pixel_coordinates3d",
    "denormalize_points_with_intrinsics",
    "normal_transform_pixel",
    "normal_transform_pixel3d",
    "normalize_homography",
    "normalize_homography3d",
    "normalize_pixel_coordinates",
    "normalize_pixel_coordinates3d",
    "normalize_points_with_intrinsics",
]

Line = tuple[float, float]  # scale and offset


def to_unit(size: int, align_corners: bool = True) -> Line:
    """Map the pixels of an axis to [-1, 1]: the centers of its outermost pixels, or their outer edges."""
    length = max(size - 1, 0) if align_corners else size
    scale = 2 / length if length > 0 else 1.0
    return scale, -scale * (size - 1) / 2


def inverted(line: Line) -> Line:
    scale, offset = line
    return 1 / scale, -offset / scale


# --- points ---------------------------------------------------------------------------------------------------------


def normalize_pixel_coordinates(pixel_coordinates: Tensor, height: int, width: int, eps: float = 1e-8) -> Tensor:
    """Map pixel coordinates to [-1, 1], the centers of the outermost pixels.

    The only pixel of an axis of length 1 maps to 0.

    Args:
        pixel_coordinates: points (x, y) of shape (*, 2). Integers give float32.
        height: height of the image, in pixels.
        width: width of the image, in pixels.
        eps: not used; accepted for compatibility.

    Returns:
        Normalized points (x, y) of shape (*, 2).

    Raises:
        TypeError: `pixel_coordinates` is not a tensor of real numbers, or a size is not an int.
        ValueError: `pixel_coordinates` is not of shape (*, 2), or a size is below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.normalize_pixel_coordinates(torch.tensor([[0.0, 0.0], [3.0, 1.0]]), 3, 4)
        tensor([[-1., -1.],
                [ 1.,  0.]])
    """
    return _moved("normalize_pixel_coordinates", pixel_coordinates, False, width=width, height=height)


def denormalize_pixel_coordinates(pixel_coordinates: Tensor, height: int, width: int, eps: float = 1e-8) -> Tensor:
    """Map [-1, 1] to pixel coordinates: the inverse of :func:`normalize_pixel_coordinates`.

    Args:
        pixel_coordinates: normalized points (x, y) of shape (*, 2). Integers give float32.
        height: height of the image, in pixels.
        width: width of the image, in pixels.
        eps: not used; accepted for compatibility.

    Returns:
        Points (x, y) of shape (*, 2), in pixels.

    Raises:
        TypeError: `pixel_coordinates` is not a tensor of real numbers, or a size is not an int.
        ValueError: `pixel_coordinates` is not of shape (*, 2), or a size is below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.denormalize_pixel_coordinates(torch.tensor([[-1.0, -1.0], [1.0, 0.0]]), 3, 4)
        tensor([[0., 0.],
                [3., 1.]])
    """
    return _moved("denormalize_pixel_coordinates", pixel_coordinates, True, width=width, height=height)


def normalize_pixel_coordinates3d(
    pixel_coordinates: Tensor, depth: int, height: int, width: int, eps: float = 1e-8
) -> Tensor:
    """Map voxel coordinates to [-1, 1], the centers of the outermost voxels.

    The only voxel of an axis of length 1 maps to 0.

    Args:
        pixel_coordinates: points (z, x, y) of shape (*, 3). Integers give float32.
        depth: depth of the volume, in voxels.
        height: height of the volume, in voxels.
        width: width of the volume, in voxels.
        eps: not used; accepted for compatibility.

    Returns:
        Normalized points (z, x, y) of shape (*, 3).

    Raises:
        TypeError: `pixel_coordinates` is not a tensor of real numbers, or a size is not an int.
        ValueError: `pixel_coordinates` is not of shape (*, 3), or a size is below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.normalize_pixel_coordinates3d(torch.tensor([[0.0, 3.0, 1.0]]), 2, 3, 4)
        tensor([[-1.,  1.,  0.]])
    """
    op = "normalize_pixel_coordinates3d"
    return _moved(op, pixel_coordinates, False, depth=depth, width=width, height=height)


def denormalize_pixel_coordinates3d(
    pixel_coordinates: Tensor, depth: int, height: int, width: int, eps: float = 1e-8
) -> Tensor:
    """Map [-1, 1] to voxel coordinates: the inverse of :func:`normalize_pixel_coordinates3d`.

    Args:
        pixel_coordinates: normalized points (z, x, y) of shape (*, 3). Integers give float32.
        depth: depth of the volume, in voxels.
        height: height of the volume, in voxels.
        width: width of the volume, in voxels.
        eps: not used; accepted for compatibility.

    Returns:
        Points (z, x, y) of shape (*, 3), in voxels.

    Raises:
        TypeError: `pixel_coordinates` is not a tensor of real numbers, or a size is not an int.
        ValueError: `pixel_coordinates` is not of shape (*, 3), or a size is below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.denormalize_pixel_coordinates3d(torch.tensor([[-1.0, 1.0, 0.0]]), 2, 3, 4)
        tensor([[0., 3., 1.]])
    """
    op = "denormalize_pixel_coordinates3d"
    return _moved(op, pixel_coordinates, True, depth=depth, width=width, height=height)


def _moved(op: str, points: Tensor, back: bool, **sizes: int) -> Tensor:
    _check.trailing_shape(op, "pixel_coordinates", points, len(sizes))
    lines = [to_unit(_check.ints(op, name, n, 1)[0]) for name, n in sizes.items()]
    return _along_axes(floats(points), [inverted(line) for line in lines] if back else lines)


@with_kernel_casts
def _along_axes(points: Tensor, lines: Sequence[Line]) -> Tensor:
    if points.dim() == 1:
        return _along_axes(points[None], lines)[0]
    # Rows of points are rows of numbers that take the scales and offsets in turn: long loops, where an axis has 2 or 3.
    scale, offset = filled(zip(*lines), points).repeat(1, points.shape[-2])
    return torch.addcmul(offset, points.flatten(-2), scale).unflatten(-1, points.shape[-2:])


def filled(rows: Iterable[Sequence[float]], like: Tensor) -> Tensor:
    """A matrix of numbers, filled on the device of `like`, without a copy from the host."""
    values = [list(row) for row in rows]
    if like.device.type == "cpu" and not is_compiling():
        return torch.tensor(values, dtype=like.dtype, device="cpu")
    matrix = torch.empty(len(values), len(values[0]), dtype=like.dtype, device=like.device)
    for i, row in enumerate(values):
        for j, value in enumerate(row):
            matrix[i, j].fill_(value)
    return matrix


# --- matrices -------------------------------------------------------------------------------------------------------


def normal_transform_pixel(
    height: int,
    width: int,
    eps: float = 1e-14,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
    align_corners: bool = True,
) -> Tensor:
    """The matrix that maps pixel coordinates to [-1, 1].

    Args:
        height: height of the image, in pixels.
        width: width of the image, in pixels.
        eps: not used; accepted for compatibility.
        device: device of the result.
        dtype: type of the result.
        align_corners: -1 and 1 are the centers of the outermost pixels, not their outer edges.

    Returns:
        A matrix of shape (1, 3, 3), applied to columns (x, y, 1).

    Raises:
        TypeError: a size is not an int, or `align_corners` is not a bool.
        ValueError: a size is below 1.

    Example:
        >>> import kvision as K
        >>> K.geometry.normal_transform_pixel(3, 5)
        tensor([[[ 0.5000,  0.0000, -1.0000],
                 [ 0.0000,  1.0000, -1.0000],
                 [ 0.0000,  0.0000,  1.0000]]])
    """
    op = "normal_transform_pixel"
    _check.flag(op, "align_corners", align_corners)
    return by_axes(_lines(op, align_corners, height=height, width=width), _check.device(op, device), dtype)[None]


def normal_transform_pixel3d(
    depth: int,
    height: int,
    width: int,
    eps: float = 1e-14,
    device: torch.device | str | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """The matrix that maps voxel coordinates to [-1, 1], the centers of the outermost voxels.

    Args:
        depth: depth of the volume, in voxels.
        height: height of the volume, in voxels.
        width: width of the volume, in voxels.
        eps: not used; accepted for compatibility.
        device: device of the result.
        dtype: type of the result.

    Returns:
        A matrix of shape (1, 4, 4), applied to columns (x, y, z, 1).

    Raises:
        TypeError: a size is not an int.
        ValueError: a size is below 1.

    Example:
        >>> import kvision as K
        >>> K.geometry.normal_transform_pixel3d(2, 3, 5)[0, :3, 3]
        tensor([-1., -1., -1.])
    """
    lines = _lines("normal_transform_pixel3d", True, depth=depth, height=height, width=width)
    return by_axes(lines, _check.device("normal_transform_pixel3d", device), dtype)[None]


def _lines(op: str, align_corners: bool, **sizes: int) -> list[Line]:
    """Scale and offset from pixels to [-1, 1] for each axis, x first; sizes begin with that of the last axis."""
    return [to_unit(_check.ints(op, name, n, 1)[0], align_corners) for name, n in reversed(sizes.items())]


def by_axes(lines: Sequence[Line], device: torch.device | str | None, dtype: torch.dtype | None) -> Tensor:
    """The matrix (n + 1, n + 1) that scales and shifts each of n axes, filled on its device, without a copy from the host."""
    n = len(lines)
    matrix = torch.eye(n + 1, device=device, dtype=dtype)
    for axis, (scale, offset) in enumerate(lines):
        matrix[axis, axis].fill_(scale)
        matrix[axis, n].fill_(offset)
    return matrix


def normalize_homography(
    dst_pix_trans_src_pix: Tensor,
    dsize_src: tuple[int, int],
    dsize_dst: tuple[int, int],
    align_corners: bool = True,
) -> Tensor:
    """Convert homographies between pixel coordinates to homographies between coordinates in [-1, 1].

    Args:
        dst_pix_trans_src_pix: matrices of shape (*, 3, 3) that map source pixels (x, y, 1) to destination pixels.
        dsize_src: height and width of the source image.
        dsize_dst: height and width of the destination image.
        align_corners: -1 and 1 are the centers of the outermost pixels, not their outer edges.

    Returns:
        Matrices of shape (*, 3, 3) that map normalized source coordinates to normalized destination coordinates.

    Raises:
        TypeError: `dst_pix_trans_src_pix` is not a floating-point tensor, a size is not an int, or `align_corners` is not a bool.
        ValueError: `dst_pix_trans_src_pix` is not of shape (*, 3, 3), or a size is below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.normalize_homography(torch.eye(3)[None], (3, 3), (3, 5))
        tensor([[[ 0.5000,  0.0000, -0.5000],
                 [ 0.0000,  1.0000,  0.0000],
                 [ 0.0000,  0.0000,  1.0000]]])
    """
    return _converted("normalize_homography", dst_pix_trans_src_pix, dsize_src, dsize_dst, 2, align_corners, False)


def denormalize_homography(
    dst_pix_trans_src_pix: Tensor,
    dsize_src: tuple[int, int],
    dsize_dst: tuple[int, int],
    align_corners: bool = True,
) -> Tensor:
    """Convert homographies between coordinates in [-1, 1] to homographies between pixel coordinates.

    This is the inverse of :func:`normalize_homography`.

    Args:
        dst_pix_trans_src_pix: matrices of shape (*, 3, 3) that map normalized source coordinates (x, y, 1) to normalized
            destination coordinates.
        dsize_src: height and width of the source image.
        dsize_dst: height and width of the destination image.
        align_corners: -1 and 1 are the centers of the outermost pixels, not their outer edges.

    Returns:
        Matrices of shape (*, 3, 3) that map source pixels to destination pixels.

    Raises:
        TypeError: `dst_pix_trans_src_pix` is not a floating-point tensor, a size is not an int, or `align_corners` is not a bool.
        ValueError: `dst_pix_trans_src_pix` is not of shape (*, 3, 3), or a size is below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.denormalize_homography(torch.eye(3)[None], (3, 3), (3, 5))[0, 0]
        tensor([2., 0., 0.])
    """
    return _converted("denormalize_homography", dst_pix_trans_src_pix, dsize_src, dsize_dst, 2, align_corners, True)


def normalize_homography3d(
    dst_pix_trans_src_pix: Tensor, dsize_src: tuple[int, int, int], dsize_dst: tuple[int, int, int]
) -> Tensor:
    """Convert homographies between voxel coordinates to homographies between coordinates in [-1, 1].

    Args:
        dst_pix_trans_src_pix: matrices of shape (*, 4, 4) that map source voxels (x, y, z, 1) to destination voxels.
        dsize_src: depth, height and width of the source volume.
        dsize_dst: depth, height and width of the destination volume.

    Returns:
        Matrices of shape (*, 4, 4) that map normalized source coordinates to normalized destination coordinates.

    Raises:
        TypeError: `dst_pix_trans_src_pix` is not a floating-point tensor, or a size is not an int.
        ValueError: `dst_pix_trans_src_pix` is not of shape (*, 4, 4), or a size is below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.normalize_homography3d(torch.eye(4)[None], (2, 3, 3), (2, 3, 5))[0, 0]
        tensor([ 0.5000,  0.0000,  0.0000, -0.5000])
    """
    return _converted("normalize_homography3d", dst_pix_trans_src_pix, dsize_src, dsize_dst, 3, True, False)


def denormalize_homography3d(
    dst_pix_trans_src_pix: Tensor, dsize_src: tuple[int, int, int], dsize_dst: tuple[int, int, int]
) -> Tensor:
    """Convert homographies between coordinates in [-1, 1] to homographies between voxel coordinates.

    This is the inverse of :func:`normalize_homography3d`.

    Args:
        dst_pix_trans_src_pix: matrices of shape (*, 4, 4) that map normalized source coordinates (x, y, z, 1) to normalized
            destination coordinates.
        dsize_src: depth, height and width of the source volume.
        dsize_dst: depth, height and width of the destination volume.

    Returns:
        Matrices of shape (*, 4, 4) that map source voxels to destination voxels.

    Raises:
        TypeError: `dst_pix_trans_src_pix` is not a floating-point tensor, or a size is not an int.
        ValueError: `dst_pix_trans_src_pix` is not of shape (*, 4, 4), or a size is below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.denormalize_homography3d(torch.eye(4)[None], (2, 3, 3), (2, 3, 5))[0, 0]
        tensor([2., 0., 0., 0.])
    """
    return _converted("denormalize_homography3d", dst_pix_trans_src_pix, dsize_src, dsize_dst, 3, True, True)


def _converted(op, matrix, dsize_src, dsize_dst, axes, align_corners, back):
    _check.trailing_shape(op, "dst_pix_trans_src_pix", matrix, axes + 1, axes + 1)
    _check.floating(op, "dst_pix_trans_src_pix", matrix)
    _check.flag(op, "align_corners", align_corners)
    source, result = (
        [to_unit(n, align_corners) for n in reversed(_check.ints(op, name, size, axes))]
        for name, size in (("dsize_src", dsize_src), ("dsize_dst", dsize_dst))
    )
    if back:
        return _between(matrix, source, [inverted(line) for line in result])
    return _between(matrix, [inverted(line) for line in source], result)


@with_kernel_casts
def _between(matrix: Tensor, before: Sequence[Line], after: Sequence[Line]) -> Tensor:
    return by_axes(after, matrix.device, matrix.dtype) @ matrix @ by_axes(before, matrix.device, matrix.dtype)


# --- cameras --------------------------------------------------------------------------------------------------------


def normalize_points_with_intrinsics(point_2d: Tensor, camera_matrix: Tensor) -> Tensor:
    """Map pixel coordinates to a camera's image plane at depth 1: (p - c) / f. Skew is ignored.

    Args:
        point_2d: points (x, y) of shape (*, 2), in pixels. Integers give float32.
        camera_matrix: camera matrices of shape (*, 3, 3). Leading axes broadcast. With fewer leading axes than `point_2d`,
            each matrix applies to all points of the axis before the coordinates: (B, 3, 3) goes with (B, N, 2).

    Returns:
        Points (x, y) of shape (*, 2), in the image plane at depth 1.

    Raises:
        TypeError: `point_2d` or `camera_matrix` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([[100.0, 0, 320], [0, 200, 240], [0, 0, 1]])
        >>> K.geometry.normalize_points_with_intrinsics(torch.tensor([[420.0, 440.0]]), camera)
        tensor([[1., 1.]])
    """
    _check.trailing_shape("normalize_points_with_intrinsics", "point_2d", point_2d, 2)
    check_camera("normalize_points_with_intrinsics", "point_2d", point_2d, camera_matrix)
    return _normalized(floats(point_2d), camera_matrix)


def denormalize_points_with_intrinsics(point_2d_norm: Tensor, camera_matrix: Tensor) -> Tensor:
    """Map points in a camera's image plane at depth 1 to pixel coordinates: f * p + c. Skew is ignored.

    Args:
        point_2d_norm: points (x, y) of shape (*, 2). Integers give float32.
        camera_matrix: camera matrices of shape (*, 3, 3), which broadcast as in :func:`normalize_points_with_intrinsics`.

    Returns:
        Points (x, y) of shape (*, 2), in pixels.

    Raises:
        TypeError: `point_2d_norm` or `camera_matrix` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([[100.0, 0, 320], [0, 200, 240], [0, 0, 1]])
        >>> K.geometry.denormalize_points_with_intrinsics(torch.ones(1, 2), camera)
        tensor([[420., 440.]])
    """
    _check.trailing_shape("denormalize_points_with_intrinsics", "point_2d_norm", point_2d_norm, 2)
    check_camera("denormalize_points_with_intrinsics", "point_2d_norm", point_2d_norm, camera_matrix)
    return _denormalized(floats(point_2d_norm), camera_matrix)


def check_camera(op: str, name: str, points: Tensor, camera_matrix: Tensor) -> None:
    """Raise unless `camera_matrix` (*, 3, 3) fits points (*, D)."""
    _check.trailing_shape(op, "camera_matrix", camera_matrix, 3, 3)
    _check.subtractable(op, camera_matrix=camera_matrix)
    if camera_matrix.device != points.device:
        _check.same_device(op, **{name: points, "camera_matrix": camera_matrix})
    leading, of_points = camera_matrix.shape[:-2], points.shape[:-1]
    if leading in (of_points, of_points[:-1]):  # a camera for each point, or one for all points of a sample
        return
    padded = (*leading, 1) if len(leading) < points.dim() - 1 else leading
    _check.broadcastable(op, **{name: of_points, "camera_matrix": padded})


@with_kernel_casts
def _normalized(points: Tensor, camera_matrix: Tensor) -> Tensor:
    focal, center = focal_and_center(points, camera_matrix)
    return (points - center) / focal


@with_kernel_casts
def _denormalized(points: Tensor, camera_matrix: Tensor) -> Tensor:
    focal, center = focal_and_center(points, camera_matrix)
    return points * focal + center


def focal_and_center(points: Tensor, camera_matrix: Tensor) -> tuple[Tensor, Tensor]:
    """Focal lengths and principal points, (*, 2), for points (*, D)."""
    diagonal, last = camera_matrix.diagonal(dim1=-2, dim2=-1), camera_matrix.select(-1, 2)
    if last.dim() < points.dim():
        return diagonal[..., None, :2], last[..., None, :2]
    return diagonal[..., :2], last[..., :2]
