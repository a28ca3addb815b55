"""Rectification of calibrated pairs of cameras: rotations after which corresponding points are in the same row or column."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from kvision import _check
from kvision.geometry.calibration.distortion import undistort_points
from kvision.geometry.conversions.rotations import axis_angle_to_rotation_matrix, rotation_matrix_to_axis_angle
from kvision.geometry.liegroup.so3 import skew

__all__ = ["StereoRectification", "stereo_rectify"]

_GRID = 9  # points along a side of an image, of which the visible region is measured


@dataclass(frozen=True)
class StereoRectification:
    """What :func:`stereo_rectify` returns for pairs of cameras of shape (*).

    Attributes:
        R1: rotations (*, 3, 3) from the first cameras to the rectified ones.
        R2: those of the second cameras.
        P1: camera matrices (*, 3, 4) of the first rectified cameras.
        P2: those of the second ones. Their last column is f b in x for pairs side by side, in y for one above the other.
        Q: matrices (*, 4, 4) from (x, y, disparity, 1) to homogeneous points in the frame of the first rectified cameras.

    Example:
        >>> import torch, kvision as K
        >>> camera, R, t = torch.tensor([[100.0, 0, 32], [0, 100, 24], [0, 0, 1]]), torch.eye(3), torch.tensor([[-0.5], [0], [0]])
        >>> K.geometry.stereo_rectify(camera, None, camera, None, (48, 64), R, t).P2[0]
        tensor([100.,   0.,  32., -50.])
    """

    R1: Tensor
    R2: Tensor
    P1: Tensor
    P2: Tensor
    Q: Tensor


def stereo_rectify(
    camera_matrix1: Tensor,
    dist1: Tensor | None,
    camera_matrix2: Tensor,
    dist2: Tensor | None,
    image_size: tuple[int, int],
    R: Tensor,
    t: Tensor,
    alpha: float | None = None,
    zero_disparity: bool = True,
    new_image_size: tuple[int, int] | None = None,
) -> StereoRectification:
    """Find rotations and camera matrices with which two cameras see corresponding points in the same row, or column.

    Both cameras are turned by half of the rotation between them, then the baseline onto the axis that it is nearer to: x for pairs
    side by side, y for one above the other. Results are those of OpenCV's `stereoRectify` for lenses that it inverts in five steps.

    Args:
        camera_matrix1: camera matrices (*, 3, 3) of the first cameras, floating point.
        dist1: their distortion (*, n), as in :func:`distort_points`. None for none.
        camera_matrix2: camera matrices (*, 3, 3) of the second cameras.
        dist2: their distortion (*, n). None for none.
        image_size: height and width of the images, in pixels.
        R: rotations (*, 3, 3) from the first cameras to the second ones.
        t: translations (*, 3, 1): a point X of a first camera is R X + t of the second one.
        alpha: the scale of the results. 0 shows nothing but pixels of the images, 1 all of their pixels, others lie between.
            None keeps the mean focal length.
        zero_disparity: whether principal points are the same in both images, so that points at infinity have disparity 0.
        new_image_size: height and width of the rectified images; default: `image_size`.

    Returns:
        Rotations, camera matrices and the matrix of disparities.

    Raises:
        TypeError: a tensor is not a floating-point tensor, or a size is no pair of ints.
        ValueError: a shape is not as in Args, or `alpha` is not in [0, 1].

    Source: OpenCV's documentation of `stereoRectify`.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([[100.0, 0, 32], [0, 100, 24], [0, 0, 1]])
        >>> R = K.geometry.axis_angle_to_rotation_matrix(torch.tensor([[0.0, 0.1, 0.0]]))[0]
        >>> t, X = torch.tensor([[-0.5], [0.0], [0.1]]), torch.tensor([[0.3], [0.2], [4.0]])
        >>> pair = K.geometry.stereo_rectify(camera, None, camera, None, (48, 64), R, t)
        >>> left, right = pair.P1[:, :3] @ pair.R1 @ X, pair.P2[:, :3] @ pair.R2 @ (R @ X + t)
        >>> bool(torch.isclose(left[1] / left[2], right[1] / right[2]))
        True
    """
    op = "stereo_rectify"
    for name, matrix, sizes in (
        ("camera_matrix1", camera_matrix1, (3, 3)),
        ("camera_matrix2", camera_matrix2, (3, 3)),
        ("R", R, (3, 3)),
        ("t", t, (3, 1)),
    ):
        _check.floating_trailing_shape(op, name, matrix, *sizes)
    height, width = _check.pair(op, "image_size", image_size)
    new_height, new_width = (
        (height, width) if new_image_size is None else _check.pair(op, "new_image_size", new_image_size)
    )
    _check.flag(op, "zero_disparity", zero_disparity)
    if alpha is not None:
        alpha = _check.fraction(op, "alpha", alpha)
    cameras = camera_matrix1, camera_matrix2
    dists = tuple(K.new_zeros(4) if dist is None else dist for K, dist in zip(cameras, (dist1, dist2)))

    half = axis_angle_to_rotation_matrix(-0.5 * rotation_matrix_to_axis_angle(R))
    halfway = half @ t
    level, is_row = _onto_axis(halfway[..., 0])
    rotations = level @ half.mT, level @ half
    baseline = (level @ halfway)[..., 0]  # on the axis

    extent = torch.tensor([width, height], dtype=R.dtype, device=R.device)
    ratio = torch.tensor([new_width / width, new_height / height], dtype=R.dtype, device=R.device)
    # The focal length of the axis across the baseline, and the ratio of the other one, as OpenCV takes them.
    focal = torch.where(
        is_row,
        0.5 * (camera_matrix1[..., 1, 1] + camera_matrix2[..., 1, 1]) * ratio[1],
        0.5 * (camera_matrix1[..., 0, 0] + camera_matrix2[..., 0, 0]) * ratio[0],
    )
    corners = _grid(2, extent)
    seen = [_seen(corners, *view) for view in zip(cameras, dists, rotations)]
    centers = [0.5 * (extent - 1) - focal[..., None] * points.mean(-2) for points in seen]
    mean = 0.5 * (centers[0] + centers[1])
    if zero_disparity:
        centers = [mean, mean]
    else:  # the same across the baseline alone
        is_along = torch.stack([is_row, ~is_row], -1)
        centers = [torch.where(is_along, center, mean) for center in centers]
    news = [ratio * center for center in centers]
    if alpha is not None:
        last = torch.tensor([new_width - 1, new_height - 1], dtype=R.dtype, device=R.device)
        grid, scales = _grid(_GRID, extent), []
        for camera, dist, rotation, center in zip(cameras, dists, rotations, news):
            points = focal[..., None, None] * _seen(grid, camera, dist, rotation)
            scales.append(_scales(points.unflatten(-2, (_GRID, _GRID)), center, last - center))
        inner, outer = (torch.stack(pair) for pair in zip(*scales))
        focal = focal * (inner.amax(0) * (1 - alpha) + outer.amin(0) * alpha)

    b = torch.where(is_row, baseline[..., 0], baseline[..., 1])
    zero, one = torch.zeros_like(b), torch.ones_like(b)
    bx, by = torch.where(is_row, b, zero), torch.where(is_row, zero, b)
    (cx, cy), (cx2, cy2) = (center.unbind(-1) for center in news)
    apart = torch.where(is_row, cx - cx2, cy - cy2)
    P1 = [focal, zero, cx, zero, zero, focal, cy, zero, zero, zero, one, zero]
    P2 = [focal, zero, cx2, focal * bx, zero, focal, cy2, focal * by, zero, zero, one, zero]
    Q = [one, zero, zero, -cx, zero, one, zero, -cy, zero, zero, zero, focal, zero, zero, -1 / b, apart / b]
    return StereoRectification(
        *rotations, *(torch.stack(torch.broadcast_tensors(*x), -1).unflatten(-1, (-1, 4)) for x in (P1, P2, Q))
    )


def _onto_axis(t: Tensor) -> tuple[Tensor, Tensor]:
    """The smallest rotations (*, 3, 3) of vectors (*, 3) onto x or y, whichever is nearer up to its sign, and whether it is x."""
    is_row = t[..., 0].abs() > t[..., 1].abs()
    entry = torch.where(is_row, t[..., 0], t[..., 1])
    sign = torch.where(entry > 0, torch.ones_like(entry), -torch.ones_like(entry))
    zero = torch.zeros_like(sign)
    axis = torch.stack([torch.where(is_row, sign, zero), torch.where(is_row, zero, sign), zero], -1)
    unit = t / torch.linalg.vector_norm(t, dim=-1, keepdim=True)
    turn = skew(torch.linalg.cross(unit, axis))
    cosine = (unit * axis).sum(-1)[..., None, None]  # at least 0
    return torch.eye(3, dtype=t.dtype, device=t.device) + turn + turn @ turn / (1 + cosine), is_row


def _grid(n: int, sizes: Tensor) -> Tensor:
    """Points (n * n, 2) of images of sizes (width, height), from the first pixel's center to the last one's, row by row."""
    steps = torch.linspace(0, 1, n, dtype=sizes.dtype, device=sizes.device)
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    return torch.stack([x, y], -1).flatten(0, 1) * (sizes - 1)


def _seen(points: Tensor, camera_matrix: Tensor, dist: Tensor, rotation: Tensor) -> Tensor:
    """Where the plane at depth 1 of turned cameras has the points (N, 2) of images: (*, N, 2)."""
    plane = undistort_points(points, camera_matrix, dist, torch.eye(3, dtype=points.dtype, device=points.device), 20)
    x, y, z = (torch.nn.functional.pad(plane, (0, 1), value=1.0) @ rotation.mT).unbind(-1)
    return torch.stack([x / z, y / z], -1)


def _scales(points: Tensor, before: Tensor, behind: Tensor) -> tuple[Tensor, Tensor]:
    """Scales of a grid of points (*, n, n, 2) about the principal point, which has `before` and `behind` as (x, y) on its sides.

    With the first one the image that the grid covers has no pixel outside of it, with the second one it has all of the grid.
    """
    low = torch.stack([points[..., :, 0, 0].amax(-1), points[..., 0, :, 1].amax(-1)], -1)
    high = torch.stack([points[..., :, -1, 0].amin(-1), points[..., -1, :, 1].amin(-1)], -1)
    inner = torch.cat([before / -low, behind / high], -1).amax(-1)
    outer = torch.cat([before / -points.amin((-3, -2)), behind / points.amax((-3, -2))], -1).amin(-1)
    return inner, outer
