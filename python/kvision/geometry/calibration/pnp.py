"""Camera poses from points in space and their projections."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import promoted
from kvision._ops import register
from kvision.core.exceptions import ShapeError
from kvision.geometry._normalization import normalized
from kvision.geometry._precision import in_full_precision, length
from kvision.geometry.solvers.null_vector import null_vector

__all__ = ["solve_pnp_dlt"]


@in_full_precision
def solve_pnp_dlt(
    world_points: Tensor,
    img_points: Tensor,
    intrinsics: Tensor,
    weights: Tensor | None = None,
    svd_eps: float = 1e-4,
) -> Tensor:
    """Estimate camera poses from points in space and their projections, by direct linear transformation.

    Args:
        world_points: (B, N, 3), floating point, at least six points that are not coplanar.
        img_points: (B, N, 2) as (x, y) in pixels.
        intrinsics: camera matrices, (B, 3, 3), upper triangular.
        weights: of the errors (not of their squares), (B, N); a point of weight 0 does not count.
        svd_eps: points count as coplanar when their smallest singular value is below this, after scaling to a mean
            distance of sqrt(3) from their mean.

    Returns:
        [R | t] from world to camera, (B, 3, 4), R being a rotation. Coplanar points give NaN, without
        waiting for the device.

    Raises:
        TypeCheckError: points or `intrinsics` are not floating-point tensors; `svd_eps` is not a number.
        ShapeError: `world_points` is not (B, N, 3) with at least six points; `img_points` is not (B, N, 2); `intrinsics` is
            not (B, 3, 3); `weights` is not (B, N).
        DeviceError: the tensors are on different devices.

    Source: R. Hartley and A. Zisserman, "Multiple View Geometry" (2003), section 7.1.

    Example:
        >>> import torch, kvision as K
        >>> points = torch.rand(1, 8, 3, dtype=torch.float64) + torch.tensor([0.0, 0.0, 2.0])
        >>> projections = points[..., :2] / points[..., 2:]
        >>> pose = K.geometry.solve_pnp_dlt(points, projections, torch.eye(3).double()[None])
        >>> (pose - torch.eye(3, 4)).abs().max() < 1e-5
        tensor(True)
    """
    check_correspondences("solve_pnp_dlt", world_points, img_points, intrinsics, weights, 6, "six")
    _check.number("solve_pnp_dlt", "svd_eps", svd_eps)
    return _pose_dlt(world_points, img_points, intrinsics, weights, float(svd_eps))


def check_correspondences(
    op: str, world_points: Tensor, img_points: Tensor, intrinsics: Tensor, weights: Tensor | None, least: int, word: str
) -> None:
    """Raise unless the arguments are at least so many points in space, their pixels, cameras and weights."""
    for name, x, sizes in (
        ("world_points", world_points, ("B", "N", 3)),
        ("img_points", img_points, ("B", "N", 2)),
        ("intrinsics", intrinsics, ("B", 3, 3)),
    ):
        _check.shape(op, name, x, *sizes)
        _check.floating(op, name, x)
    batch, count = world_points.shape[:2]
    if count < least:
        raise ShapeError(f"{op}: expected world_points of at least {word} points, got {tuple(world_points.shape)}")
    _check.shape(op, "img_points", img_points, batch, count, 2)
    _check.shape(op, "intrinsics", intrinsics, batch, 3, 3)
    _check.same_device(op, world_points=world_points, img_points=img_points, intrinsics=intrinsics)
    if weights is not None:
        _check.shape(op, "weights", weights, batch, count)
        _check.same_device(op, world_points=world_points, weights=weights)


def _reference(points: Tensor, pixels: Tensor, camera: Tensor, weights: Tensor | None, flat: float) -> Tensor:
    w = None if weights is None else promoted(weights).square()
    X, T = normalized(promoted(points), w)
    x, U = normalized(_before_camera(promoted(pixels), promoted(camera)), w)
    p = torch.cat([X, torch.ones_like(X[..., :1])], -1)
    zero = torch.zeros_like(p)
    rows = torch.cat([torch.cat([p, zero, -x[..., :1] * p], -1), torch.cat([zero, p, -x[..., 1:] * p], -1)], 1)
    P = null_vector(rows, None if w is None else w.repeat(1, 2)).unflatten(-1, (3, 4)) @ T
    scale, shift = U[:, :1, :1], U[:, :2, 2:]
    pose = _pose(torch.cat([P[:, :2] - shift * P[:, 2:], scale * P[:, 2:]], 1))
    return torch.where((_extent(X, w) < flat)[:, None, None], torch.nan, pose).to(points.dtype)


def _backward_reference(
    grad: Tensor, points: Tensor, pixels: Tensor, camera: Tensor, weights: Tensor | None, flat: float
) -> tuple[Tensor, ...]:
    w = points.new_ones(points.shape[:2]) if weights is None else weights
    return torch.func.vjp(lambda x, y, k, w: _reference(x, y, k, w, flat), points, pixels, camera, w)[1](grad)


_pose_dlt = register(
    "pose_dlt",
    _reference,
    fake=lambda points, *rest: (points.shape[0], 3, 4),
    gradients="points, pixels, camera, weights: pose_dlt_backward",
)
register(
    "pose_dlt_backward",
    _backward_reference,
    fake=lambda grad, points, pixels, camera, *rest: [points.shape, pixels.shape, camera.shape, points.shape[:2]],
)


def _before_camera(points: Tensor, K: Tensor) -> Tensor:
    """Solve K X = (x, y, 1) for an upper triangular K and scale X to z = 1."""
    z = K[:, 2, 2, None]
    y = (points[..., 1] - K[:, 1, 2, None] / z) * z / K[:, 1, 1, None]
    x = ((points[..., 0] - K[:, 0, 2, None] / z) * z - K[:, 0, 1, None] * y) / K[:, 0, 0, None]
    return torch.stack([x, y], -1)


def _pose(P: Tensor) -> Tensor:
    """Find [R | t] from P up to scale and sign. Gram-Schmidt gives R; the first column's length is the scale."""
    a, b, c, t = P.unbind(-1)
    mirrored = (torch.linalg.cross(a, b) * c).sum(-1, keepdim=True) < 0
    a, b, c, t = (torch.where(mirrored, -v, v) for v in (a, b, c, t))
    size = _nonzero(length(a, keepdim=True))
    first = a / size
    second = b - (first * b).sum(-1, keepdim=True) * first
    second = second / _nonzero(length(second, keepdim=True))
    return torch.stack([first, second, torch.linalg.cross(first, second), t / size], -1)


def _nonzero(size: Tensor) -> Tensor:
    return torch.where(size > 0, size, 1)


def _extent(X: Tensor, weights: Tensor | None) -> Tensor:
    """The smallest singular value (B,) of weighted points (B, N, 3). Weights are scaled to a mean of 1."""
    X = X.detach()
    if weights is None:
        weighted = X
    else:
        used = (weights > 0).sum(-1, keepdim=True)
        weighted = X * (weights.detach() * used / weights.detach().sum(-1, keepdim=True))[..., None]
    M = weighted.mT @ X
    v = null_vector(M)
    return (v[:, None] @ M @ v[..., None])[:, 0, 0].clamp(min=0).sqrt()
