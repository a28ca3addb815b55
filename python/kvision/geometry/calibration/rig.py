"""Calibration of cameras that are fixed to each other: stereo pairs and rigs, from pictures of a planar target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError
from kvision.geometry._intrinsics import camera_matrix_of
from kvision.geometry.calibration._lenses import LensModel, projected, projected_with_jacobians, rays
from kvision.geometry.calibration.camera import (
    calibrate_camera,
    covariance_of,
    homographies_of_rays,
    poses_of_homographies,
    poses_where,
)
from kvision.geometry.conversions.poses import Rt_to_matrix4x4
from kvision.geometry.liegroup import Se3, So3
from kvision.geometry.liegroup.so3 import skew
from kvision.geometry.optim import least_squares

__all__ = ["RigCalibration", "calibrate_rig"]


@dataclass(frozen=True)
class RigCalibration:
    """What :func:`calibrate_rig` returns for B rigs of C cameras and V views; NaN for rigs without a solution.

    Attributes:
        camera_matrix: (B, C, 3, 3), without skew.
        dist: distortion coefficients (B, C, n).
        rig: Se3 (B, C) from the first camera to each; that to itself is the identity. R and t of a pair are those of `rig[:, 1]`.
        pose: Se3 (B, V) from the target to the first camera.
        rms: root mean square of the distances (B,) between observed and projected points, in pixels.
        view_rms: that of each camera's picture, (B, C, V). A picture far above the others is an outlier.
        covariance: of (fx, fy, cx, cy) of all cameras, then `dist` of all cameras, then the tangents of `rig` without the first,
            (B, D, D), for observations whose errors have the variance that was found. Without what was given.
        converged: whether the refinement reached its tolerance, bool (B,). False for NaN.

    Example:
        >>> import torch, kvision as K
        >>> from kvision.geometry.liegroup import Se3
        >>> board = torch.cartesian_prod(torch.arange(5.0), torch.arange(4.0)).double()
        >>> board = torch.cat([board, torch.zeros(20, 1)], -1).expand(1, 3, 20, 3)
        >>> tangent = [[-2, -1, 9, 0.3, 0.2, 0], [-2, -1, 8, -0.3, 0.3, 0.2], [-2, -2, 9, 0.1, -0.4, 0.1]]
        >>> left = Se3.exp(torch.tensor([tangent]).double())[:, :, None] * board
        >>> p = torch.stack([left, left + torch.tensor([-1.0, 0.0, 0.0])], 1)
        >>> fit = K.geometry.calibrate_rig(board, 500 * p[..., :2] / p[..., 2:] + 320, (640, 640), num_coefficients=4)
        >>> fit.rig.t.detach()[0, 1].round(decimals=3) + 0
        tensor([-1.,  0.,  0.], dtype=torch.float64)
    """

    camera_matrix: Tensor
    dist: Tensor
    rig: Se3
    pose: Se3
    rms: Tensor
    view_rms: Tensor
    covariance: Tensor
    converged: Tensor


class _RigError:
    """Where the cameras of a rig see targets, less where they were observed: a block of all points for each picture.

    A picture sees a camera, the motion to that camera unless it is the first one, and a view. `given` has intrinsics that are no
    variables.
    """

    def __init__(
        self,
        model: LensModel,
        points: Tensor,
        pixels: Tensor,
        weights: Tensor,
        is_first: Tensor,
        given: dict[str, Tensor],
    ) -> None:
        self.model, self.points, self.pixels, self.given = model, points, pixels, given
        self.root = torch.where(weights > 0, weights, 0).sqrt()[..., None]  # (B, M, N, 1)
        self.is_first = is_first[:, None]  # (M, 1)

    def _in_cameras(self, variables: dict[str, Any]) -> tuple[Tensor, Tensor, Tensor]:
        p = variables["pose"][:, :, None] * self.points
        R = variables["rig"].r.matrix()
        eye = torch.eye(3, dtype=R.dtype, device=R.device)
        R = torch.where(self.is_first[..., None], eye, R)
        t = torch.where(self.is_first, 0, variables["rig"].t)
        return p, p @ R.mT + t[:, :, None], R

    def _error(self, image: Tensor, camera: Tensor) -> Tensor:
        """Weighted errors (B, M, 2 N) of points of the distorted plane."""
        error = camera[..., None, :2] * image + camera[..., None, 2:] - self.pixels
        return torch.where(self.root > 0, self.root * error, 0).flatten(2)

    def _intrinsics(self, variables: dict[str, Any]) -> tuple[Tensor, Tensor]:
        values = {**self.given, **variables}
        return values["camera"], values["dist"]

    def __call__(self, variables: dict[str, Any]) -> Tensor:
        _, p, _ = self._in_cameras(variables)
        camera, dist = self._intrinsics(variables)
        image = projected(self.model, p.flatten(0, 1), dist.flatten(0, 1))
        return self._error(image.unflatten(0, p.shape[:2]), camera)

    def with_jacobian(self, variables: dict[str, Any]) -> tuple[Tensor, dict[str, Tensor]]:
        first, p, R = self._in_cameras(variables)
        camera, dist = self._intrinsics(variables)
        parts = projected_with_jacobians(self.model, p.flatten(0, 1), dist.flatten(0, 1))
        image, to_point, to_dist = (part.unflatten(0, p.shape[:2]) for part in parts)
        focal = camera[..., None, :2, None]
        to_point = focal * to_point
        to_first = to_point @ R[:, :, None]
        one = torch.eye(2, dtype=p.dtype, device=p.device).expand(*image.shape, 2)
        jacobian = {
            "camera": torch.cat([torch.diag_embed(image), one], -1),
            "dist": focal * to_dist,
            "rig": torch.where(
                self.is_first[..., None, None], 0, torch.cat([to_point, to_point @ -skew(p)], -1)
            ),  # exp(d) p is p + t + w x p
            "pose": torch.cat([to_first, to_first @ -skew(first)], -1),
        }
        weighted = {
            name: torch.where(self.root[..., None] > 0, self.root[..., None] * J, 0).flatten(2, 3)
            for name, J in jacobian.items()
            if name in variables
        }
        return self._error(image, camera), weighted


def calibrate_rig(
    object_points: Tensor,
    image_points: Tensor,
    image_size: Sequence[int],
    weights: Tensor | None = None,
    model: LensModel = "brown_conrady",
    num_coefficients: int | None = None,
    camera_matrix: Tensor | None = None,
    dist: Tensor | None = None,
    max_iterations: int = 50,
) -> RigCalibration:
    """Estimate the motions between cameras that are fixed to each other, their intrinsics and lens distortion, for a batch of rigs.

    Each camera starts from :func:`calibrate_camera` and the rig from views that two cameras share; least squares refines all
    of it with one pose for each view. Two cameras are what OpenCV's `stereoCalibrate` calibrates. Gradients reach the points, the
    weights and given intrinsics by the implicit function theorem.

    Args:
        object_points: points of the target (B, V, N, 3) with z = 0, in any unit, floating point.
        image_points: their pixels (B, C, V, N, 2) as (x, y) in each of C > 1 cameras.
        image_size: (height, width) in pixels, of all cameras.
        weights: (B, C, V, N), at least 0; 0 for points that a camera did not see.
        model: of all cameras, as in :func:`calibrate_camera`.
        num_coefficients: as there.
        camera_matrix: known camera matrices (B, C, 3, 3) without skew, which stay as they are. None to estimate them.
        dist: known distortion coefficients (B, C, n) with n as in :func:`calibrate_camera`, given with camera matrices.
        max_iterations: of the refinement.

    Returns:
        A :class:`RigCalibration`. A rig has no solution if a camera shares no view with the others, even by way of others.

    Raises:
        TypeError: points or weights are not floating-point tensors.
        ValueError: a shape, name or number is not as in Args; `camera_matrix` or `dist` is given alone.

    Example:
        >>> import torch, kvision as K
        >>> board = torch.cartesian_prod(torch.arange(5.0), torch.arange(4.0)).double()
        >>> board = torch.cat([board, torch.zeros(20, 1)], -1).expand(1, 3, 20, 3)
        >>> tangent = [[-2, -1, 9, 0.3, 0.2, 0], [-2, -1, 8, -0.3, 0.3, 0.2], [-2, -2, 9, 0.1, -0.4, 0.1]]
        >>> left = K.geometry.liegroup.Se3.exp(torch.tensor([tangent]).double())[:, :, None] * board
        >>> pixels = torch.stack([500 * p[..., :2] / p[..., 2:] + 320 for p in (left, left - 1)], 1)
        >>> K.geometry.calibrate_rig(board, pixels, (640, 640)).rms.item() < 1e-6
        True
    """
    op = "calibrate_rig"
    _check.floating_trailing_shape(op, "object_points", object_points, "B", "V", "N", 3)
    _check.floating_trailing_shape(op, "image_points", image_points, "B", "C", "V", "N", 2)
    batch, cameras, views, count = image_points.shape[:4] if image_points.dim() == 5 else (0, 0, 0, 0)
    if image_points.dim() != 5 or object_points.shape != (batch, views, count, 3) or cameras < 2:
        shapes = f"{tuple(object_points.shape)} and {tuple(image_points.shape)}"
        raise ShapeError(
            f"{op}: expected object_points (B, V, N, 3) and image_points (B, C, V, N, 2) of C > 1, got {shapes}"
        )
    _check.same_device(op, object_points=object_points, image_points=image_points)
    dtype = torch.promote_types(torch.promote_types(object_points.dtype, image_points.dtype), torch.float32)
    X, pixels = object_points.to(dtype), image_points.to(dtype)
    w = torch.ones_like(pixels[..., 0]) if weights is None else weights.to(dtype)
    _check.shape(op, "weights", w, batch, cameras, views, count)
    given: dict[str, Tensor] = {}
    if camera_matrix is not None or dist is not None:
        _check.shape(op, "camera_matrix", camera_matrix, batch, cameras, 3, 3)
        _check.shape(op, "dist", dist, batch, cameras, "n")
        assert camera_matrix is not None and dist is not None
        num_coefficients = dist.shape[-1]
        K = camera_matrix.to(dtype)
        given = {"camera": K[..., [0, 1, 0, 1], [0, 1, 2, 2]], "dist": dist.to(dtype)}

    start, is_linked, is_seen = _start(model, X, pixels, w, image_size, num_coefficients, given)
    w = torch.where(is_seen[:, None, :, None], w, 0)
    camera = torch.arange(cameras, device=X.device).repeat_interleave(views)
    view = torch.arange(views, device=X.device).repeat(cameras)
    index = {"camera": camera, "dist": camera, "rig": (camera - 1).clamp(min=0), "pose": view}
    constant = {name: x[:, camera] for name, x in given.items()}
    error = _RigError(model, X[:, view], pixels.flatten(1, 2), w.flatten(1, 2), camera == 0, constant)
    fit = least_squares(
        error,
        start,
        index={name: i for name, i in index.items() if name in start},
        eliminate="pose",
        max_iterations=max_iterations,
        ftol=1e-9,
        xtol=1e-10,
    )
    found = {**fit.variables, **given}
    seen = {name: x[:, index[name]] for name, x in fit.variables.items()}
    square = error(seen).square().unflatten(1, (cameras, views)).sum(-1)  # (B, C, V)
    unknowns = sum(s.stop - s.start for s in fit.columns.values()) + 6 * is_seen.sum(1)
    is_fitted = fit.cost.isfinite() & (2 * (w > 0).sum((1, 2, 3)) >= unknowns) & is_linked & is_seen.any(1)
    q, t = found["rig"].quaternion.data, found["rig"].t
    q = torch.cat([q.new_tensor([1.0, 0, 0, 0]).expand(batch, 1, 4), q], 1)
    rig = Se3(So3.from_wxyz(q), torch.cat([t.new_zeros(batch, 1, 3), t], 1))

    def known(x: Tensor) -> Tensor:
        return torch.where(is_fitted.reshape(-1, *(1,) * (x.dim() - 1)), x, torch.nan)

    return RigCalibration(
        known(camera_matrix_of(*found["camera"].unbind(-1))),
        known(found["dist"]),
        poses_where(is_fitted[:, None].expand(-1, cameras), rig),
        poses_where(is_fitted[:, None] & is_seen, found["pose"]),
        known((square.sum((1, 2)) / w.sum((1, 2, 3))).sqrt()),
        known((square / w.sum(3)).sqrt()),
        known(covariance_of(fit, w, unknowns)),
        is_fitted & fit.converged,
    )


def _start(
    model: LensModel,
    X: Tensor,
    pixels: Tensor,
    weights: Tensor,
    image_size: Sequence[int],
    num_coefficients: int | None,
    given: dict[str, Tensor],
) -> tuple[dict[str, Any], Tensor, Tensor]:
    """Variables that are not given, from each camera alone; which rigs are linked (B,) and which views are seen (B, V)."""
    batch, cameras = pixels.shape[:2]
    every, x, w = X[:, None].expand(-1, cameras, -1, -1, -1).flatten(0, 1), pixels.flatten(0, 1), weights.flatten(0, 1)
    start: dict[str, Any] = {}
    with torch.no_grad():
        if given:
            seen = rays(model, x.flatten(1, 2), *(given[name].flatten(0, 1) for name in ("camera", "dist")))
            R, t = poses_of_homographies(homographies_of_rays(every, seen.unflatten(1, x.shape[1:3]), w))
            poses = Rt_to_matrix4x4(R, t[..., None])
        else:
            alone = calibrate_camera(every, x, image_size, w, model, num_coefficients)
            start["camera"] = alone.camera_matrix[:, [0, 1, 0, 1], [0, 1, 2, 2]].unflatten(0, (batch, cameras))
            start["dist"] = alone.dist.unflatten(0, (batch, cameras))
            poses = alone.pose.matrix()
        rig, pose = _linked(poses.unflatten(0, (batch, cameras)))
        is_linked = rig.isfinite().flatten(1).all(1)
        return (
            {**start, "rig": _se3(rig[:, 1:]), "pose": _se3(pose)},
            is_linked,
            pose.isfinite().flatten(2).all(-1) & is_linked[:, None],
        )


def _se3(matrix: Tensor) -> Se3:
    """Motions of matrices (*, 4, 4), the identity for NaN."""
    eye = torch.eye(4, dtype=matrix.dtype, device=matrix.device)
    matrix = torch.where(matrix.isfinite().flatten(-2).all(-1)[..., None, None], matrix, eye)
    return Se3(So3.from_matrix(matrix[..., :3, :3]), matrix[..., :3, 3]).requires_grad_(False)


def _linked(poses: Tensor) -> tuple[Tensor, Tensor]:
    """Motions from the first camera (B, C, 4, 4) and poses in its frame (B, V, 4, 4) of poses in each camera (B, C, V, 4, 4).

    NaN for cameras that views do not link to the first one, and for views that no linked camera sees.
    """
    is_posed = poses.isfinite().flatten(3).all(-1)  # (B, C, V)
    rig = torch.full_like(poses[:, :, 0], torch.nan)
    rig[:, 0] = torch.eye(4, device="cpu").to(poses)
    pose = poses[:, 0]
    for _ in range(poses.shape[1]):
        # A view's pose by the first of the cameras that are linked already.
        is_linked = rig.isfinite().flatten(2).all(-1)
        to_first = torch.linalg.inv_ex(
            torch.where(is_linked[..., None, None], rig, torch.eye(4, device="cpu").to(rig))
        ).inverse
        usable = is_linked[..., None] & is_posed
        best = usable.long().argmax(1)[:, None, :, None, None].expand(-1, 1, -1, 4, 4)
        pose = (to_first[:, :, None] @ poses).gather(1, best)[:, 0]
        pose = torch.where(usable.any(1)[..., None, None], pose, torch.nan)
        # The motion to a camera by that of its views which is nearest to the others.
        motions = poses @ torch.linalg.inv_ex(pose.nan_to_num()).inverse[:, None]
        both = is_posed & usable.any(1)[:, None]
        motions = torch.where(both[..., None, None], motions, torch.nan)
        apart = (motions[:, :, :, None] - motions[:, :, None]).square().sum((-1, -2)).sqrt().nansum(-1)
        middle = torch.where(both, apart, torch.inf).argmin(2)
        nearest = motions.gather(2, middle[:, :, None, None, None].expand(-1, -1, 1, 4, 4))[:, :, 0]
        rig = torch.where(is_linked[..., None, None], rig, nearest)
    return rig, pose
