"""Camera poses from points in space and their projections, with the least reprojection error."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision.geometry._normalization import is_on_line
from kvision.geometry.calibration.camera import poses_of_homographies, poses_where
from kvision.geometry.calibration.p3p import poses_of_triangles
from kvision.geometry.calibration.pnp import _before_camera, check_correspondences, solve_pnp_dlt
from kvision.geometry.homography.dlt import find_homography_dlt
from kvision.geometry.liegroup import Se3, So3
from kvision.geometry.optim import ReprojectionError, least_squares
from kvision.geometry.optim._losses import RobustLoss
from kvision.geometry.solvers.null_vector import null_vector

__all__ = ["solve_pnp"]

_TRIANGLES = 4  # whose poses are starts


def solve_pnp(
    world_points: Tensor,
    img_points: Tensor,
    intrinsics: Tensor,
    weights: Tensor | None = None,
    loss: RobustLoss = "linear",
    f_scale: float = 1.0,
    max_iterations: int = 30,
) -> tuple[Se3, Tensor]:
    """Estimate camera poses with the least reprojection error from points in space and their projections.

    Starts are the direct linear transformation of six or more points, the best pose of three of them, and both poses of the plane
    that fits the points best; :func:`optim.least_squares` refines all at once, and the best one counts. Gradients reach points,
    pixels, intrinsics and weights by the implicit function theorem.

    Args:
        world_points: (B, N, 3), float32 or float64, at least four.
        img_points: (B, N, 2) as (x, y) in pixels, without distortion.
        intrinsics: camera matrices, (B, 3, 3), upper triangular.
        weights: of the squared errors, at least 0, (B, N). Points of weight 0 do not count.
        loss: the robust kernel of :func:`optim.least_squares`.
        f_scale: the error in pixels at which a robust kernel sets in.
        max_iterations: of the refinement.

    Returns:
        The poses from world to camera (B,), and a mask (B,) of those that were found; others are NaN, as are those of points on
        one line.

    Raises:
        TypeError: points, intrinsics or weights are not floating-point tensors.
        ValueError: a shape, name or number is not as in Args.

    Source: R. Hartley and A. Zisserman, "Multiple View Geometry" (2003), sections 7.1 to 7.3.

    Example:
        >>> import torch, kvision as K
        >>> points = torch.rand(1, 8, 3, dtype=torch.float64) + torch.tensor([0.0, 0.0, 2.0])
        >>> projections = points[..., :2] / points[..., 2:]
        >>> pose, valid = K.geometry.solve_pnp(points, projections, torch.eye(3).double()[None])
        >>> pose.log().abs().max() < 1e-5, valid
        (tensor(True), tensor([True]))
    """
    check_correspondences("solve_pnp", world_points, img_points, intrinsics, weights, 4, "four")
    batch, count = world_points.shape[:2]
    error = ReprojectionError(img_points, intrinsics, world_points)
    options = {"weights": weights, "loss": loss, "f_scale": f_scale}
    with torch.no_grad():
        used = torch.ones_like(img_points[..., 0]) if weights is None else (weights > 0).to(img_points.dtype)
        X, x = (torch.where(used[..., None] > 0, p, 0) for p in (world_points, img_points))
        rays = _before_camera(x, intrinsics)
        starts = [*_planar_starts(X, rays, used), _start_of_triangles(X, rays, used)]
        if count >= 6:
            starts.append(solve_pnp_dlt(X, x, intrinsics, used))
        every = len(starts)  # of all problems at once
        repeated = {**options, "weights": used.repeat(every, 1) if weights is None else weights.repeat(every, 1)}
        fit = least_squares(
            ReprojectionError(
                img_points.repeat(every, 1, 1), intrinsics.repeat(every, 1, 1), world_points.repeat(every, 1, 1)
            ),
            {"pose": _as_se3(torch.cat(starts))},
            max_iterations=max_iterations,
            gradient="none",
            **repeated,  # type: ignore[arg-type]
        )
        poses = fit.variables["pose"]
        is_before = ((poses[:, None] * X.repeat(every, 1, 1))[..., 2] > 0) | (used == 0).repeat(every, 1)
        costs = torch.where(is_before.all(-1) & ~fit.cost.isnan(), fit.cost, torch.inf).unflatten(0, (every, batch))
        best = costs.argmin(0)
        is_valid = (costs.amin(0) < torch.inf) & (used.sum(-1) >= 4) & ~is_on_line(X, used > 0)
        start = poses.matrix().unflatten(0, (every, batch))[best, torch.arange(batch, device=best.device)]
    pose = least_squares(error, {"pose": _as_se3(start)}, max_iterations=1, **options).variables["pose"]  # type: ignore[arg-type]
    return poses_where(is_valid, pose), is_valid


def _as_se3(P: Tensor) -> Se3:
    return Se3(So3.from_matrix(P[:, :3, :3]), P[:, :3, 3]).requires_grad_(False)


def _planar_starts(X: Tensor, x: Tensor, used: Tensor) -> tuple[Tensor, Tensor]:
    """[R | t] (B, 3, 4) of the plane that fits points best, from the homography to the plane z = 1 of the camera, and the other
    pose that sees a small plane alike: mirrored in depth, and in itself."""
    center = (used[..., None] * X).sum(1, keepdim=True) / used.sum(1)[:, None, None]
    offset = (X - center) * used[..., None]
    normal = null_vector(offset.mT @ offset)
    other = torch.eye(3, dtype=X.dtype, device=X.device)[normal.abs().argmin(-1)]
    first = torch.nn.functional.normalize(torch.linalg.cross(normal, other), dim=-1)
    basis = torch.stack([first, torch.linalg.cross(normal, first), normal], 1)  # rows: from world to plane
    H = find_homography_dlt((offset @ basis.mT)[..., :2], x, used)
    rotation, t = poses_of_homographies(torch.where(H[..., 2:, 2:] < 0, -H, H))  # in front of the camera
    R = rotation @ basis
    sight = torch.nn.functional.normalize(t, dim=-1)
    mirrored = _mirror(sight) @ R @ _mirror(normal)
    return torch.cat([R, t[..., None] - R @ center.mT], -1), torch.cat(
        [mirrored, t[..., None] - mirrored @ center.mT], -1
    )


def _mirror(normal: Tensor) -> Tensor:
    """Reflections (B, 3, 3) in planes of unit normals (B, 3)."""
    eye = torch.eye(3, dtype=normal.dtype, device=normal.device)
    return eye - 2 * normal[..., :, None] * normal[..., None, :]


def _start_of_triangles(X: Tensor, x: Tensor, used: Tensor) -> Tensor:
    """Of the poses (B, 3, 4) that see three points, for a few triangles, the one that sees all points best."""
    order = used.argsort(dim=1, descending=True, stable=True)  # used points first
    count = used.sum(1).long().clamp(min=3)[:, None, None]
    corner = torch.arange(3, device=X.device) * (count // 3) + torch.arange(_TRIANGLES, device=X.device)[:, None]
    chosen = order.gather(1, (corner % count).flatten(1))
    rays = torch.nn.functional.pad(x, (0, 1), value=1.0)
    triangles, seen = (
        p.gather(1, chosen[..., None].expand(-1, -1, 3)).unflatten(1, (-1, 3)).flatten(0, 1).double() for p in (X, rays)
    )
    poses = (
        poses_of_triangles(triangles, seen).unflatten(0, (len(X), _TRIANGLES)).flatten(1, 2).to(X.dtype)
    )  # (B, 4 n, 3, 4)
    p = X[:, None] @ poses[..., :3].mT + poses[..., None, :, 3]
    error = ((p[..., :2] - p[..., 2:] * x[:, None]).square().sum(-1) / p[..., 2].square() * used[:, None]).sum(-1)
    error = torch.where((p[..., 2] > 0).all(-1) & error.isfinite(), error, torch.inf)
    return poses[torch.arange(len(X), device=X.device), error.argmin(1)]
