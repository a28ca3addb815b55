"""Calibration of cameras from pictures of a planar target: Zhang's start, refined by least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.geometry._intrinsics import camera_matrix_of
from kvision.geometry._normalization import normalized
from kvision.geometry.calibration._lenses import COUNTS, LensModel, projected, projected_with_jacobians, rays
from kvision.geometry.homography.dlt import find_homography_dlt
from kvision.geometry.liegroup import Se3, So3
from kvision.geometry.liegroup.so3 import skew
from kvision.geometry.optim import LeastSquaresResult, least_squares
from kvision.geometry.optim._losses import RobustLoss
from kvision.geometry.solvers.null_vector import null_vector

__all__ = ["CameraCalibration", "calibrate_camera"]


@dataclass(frozen=True)
class CameraCalibration:
    """What :func:`calibrate_camera` returns for B cameras and V views; NaN for cameras and views without a solution.

    Attributes:
        camera_matrix: (B, 3, 3), without skew.
        dist: distortion coefficients (B, n), in the order of :func:`distort_points` or :func:`distort_points_kannala_brandt`.
        pose: Se3 (B, V) from the target to the camera.
        rms: root mean square of the distances (B,) between observed and projected points, in pixels.
        view_rms: that of each view, (B, V). A view far above the others is an outlier.
        covariance: of (fx, fy, cx, cy, dist), (B, 4 + n, 4 + n), for observations whose errors have the variance that was found.
        converged: whether the refinement reached its tolerance, bool (B,). False for NaN.

    Example:
        >>> import torch, kvision as K
        >>> board = torch.cartesian_prod(torch.arange(5.0), torch.arange(4.0)).double()
        >>> board = torch.cat([board, torch.zeros(20, 1)], -1).expand(1, 3, 20, 3)
        >>> tangent = [[-2, -1, 9, 0.3, 0.2, 0], [-2, -1, 8, -0.3, 0.3, 0.2], [-2, -2, 9, 0.1, -0.4, 0.1]]
        >>> p = K.geometry.liegroup.Se3.exp(torch.tensor([tangent]).double())[:, :, None] * board
        >>> fit = K.geometry.calibrate_camera(board, 500 * p[..., :2] / p[..., 2:] + 320, (640, 640), num_coefficients=4)
        >>> fit.camera_matrix.detach().round()[0].long()
        tensor([[500,   0, 320],
                [  0, 500, 320],
                [  0,   0,   1]])
    """

    camera_matrix: Tensor
    dist: Tensor
    pose: Se3
    rms: Tensor
    view_rms: Tensor
    covariance: Tensor
    converged: Tensor


class _BoardError:
    """Where cameras see the points of targets, less where they were observed, with the Jacobian in closed form.

    Points and pixels are (B, V, N, *). A block of residuals is a point, or with weights (B, V, N) all weighted points of a view:
    then products are fewer and larger.
    """

    def __init__(self, model: str, points: Tensor, pixels: Tensor, weights: Tensor | None) -> None:
        self.model, self.points, self.pixels = model, points, pixels.flatten(1, 2)
        self.root = None if weights is None else torch.where(weights > 0, weights, 0).sqrt()[..., None]

    def _in_camera(self, variables: dict[str, Any]) -> Tensor:
        pose = variables["pose"]
        return pose * self.points.flatten(1, 2) if self.root is None else (pose[:, :, None] * self.points).flatten(1, 2)

    def _error(self, image: Tensor, camera: Tensor) -> Tensor:
        return self._blocks(camera[:, None, :2] * image + camera[:, None, 2:] - self.pixels)

    def _blocks(self, x: Tensor) -> Tensor:
        """Blocks of residuals or of their Jacobian (B, V N, 2, *)."""
        if self.root is None:
            return x
        root = self.root if x.dim() == 3 else self.root[..., None]
        # Points that do not count may be NaN, and so may be their projections.
        return torch.where(root > 0, root * x.unflatten(1, self.root.shape[1:3]), 0).flatten(2, 3)

    def __call__(self, variables: dict[str, Any]) -> Tensor:
        p = self._in_camera(variables)
        return self._error(projected(self.model, p, variables["dist"]), variables["camera"])

    def with_jacobian(self, variables: dict[str, Any]) -> tuple[Tensor, dict[str, Tensor]]:
        p, camera = self._in_camera(variables), variables["camera"]
        image, to_point, to_dist = projected_with_jacobians(self.model, p, variables["dist"])
        focal = camera[:, None, :2, None]
        to_point = focal * to_point
        one = torch.eye(2, dtype=p.dtype, device=p.device).expand(*image.shape, 2)
        jacobian = {
            "camera": torch.cat([torch.diag_embed(image), one], -1),
            "dist": focal * to_dist,
            "pose": torch.cat([to_point, to_point @ -skew(p)], -1),  # exp(d) p is p + t + w x p
        }
        return self._error(image, camera), {name: self._blocks(J) for name, J in jacobian.items()}


def calibrate_camera(
    object_points: Tensor,
    image_points: Tensor,
    image_size: Sequence[int],
    weights: Tensor | None = None,
    model: LensModel = "brown_conrady",
    num_coefficients: int | None = None,
    loss: RobustLoss = "linear",
    f_scale: float = 1.0,
    max_iterations: int = 50,
) -> CameraCalibration:
    """Estimate intrinsics, lens distortion and poses from views of a planar target, for a batch of cameras.

    The start is Zhang's, with the principal point at the center of the image; :func:`optim.least_squares` refines it. Gradients
    reach the points and the weights by the implicit function theorem. Views that are parallel to the image, or a single one, do not
    tell the focal lengths: `covariance` is then NaN or large. Brown and Conrady's lenses see nothing 90 degrees from the axis,
    those of Kannala and Brandt also what is behind that; the start takes their image to be as wide as it sees 180 degrees.

    Args:
        object_points: points of the target (B, V, N, 3) with z = 0, in any unit, floating point.
        image_points: their pixels (B, V, N, 2) as (x, y).
        image_size: (height, width) in pixels.
        weights: (B, V, N), at least 0; 0 for points that were not seen. A view needs four others.
        model: "brown_conrady", OpenCV's model of :func:`distort_points`, or "kannala_brandt", that of its fisheye module.
        num_coefficients: of Brown-Conrady: 4 (k1, k2, p1, p2), 5 (k3), 8 (rational: k4, k5, k6) or 12 (thin prism: s1 to s4).
            None for 5, and for the 4 of Kannala and Brandt.
        loss: the robust kernel of :func:`optim.least_squares`.
        f_scale: the error in pixels at which a robust kernel sets in.
        max_iterations: of the refinement.

    Returns:
        A :class:`CameraCalibration`.

    Raises:
        TypeError: points or weights are not floating-point tensors.
        ValueError: a shape, name or number is not as in Args.

    Source: Z. Zhang, "A flexible new technique for camera calibration" (2000).

    Example:
        >>> import torch, kvision as K
        >>> board = torch.cartesian_prod(torch.arange(5.0), torch.arange(4.0)).double()
        >>> board = torch.cat([board, torch.zeros(20, 1)], -1).expand(1, 3, 20, 3)
        >>> tangent = [[-2, -1, 9, 0.3, 0.2, 0], [-2, -1, 8, -0.3, 0.3, 0.2], [-2, -2, 9, 0.1, -0.4, 0.1]]
        >>> p = K.geometry.liegroup.Se3.exp(torch.tensor([tangent]).double())[:, :, None] * board
        >>> fit = K.geometry.calibrate_camera(board, 500 * p[..., :2] / p[..., 2:] + 320, (640, 640))
        >>> fit.rms.item() < 1e-6
        True
    """
    op = "calibrate_camera"
    _check.floating_trailing_shape(op, "object_points", object_points, "B", "V", "N", 3)
    _check.floating_trailing_shape(op, "image_points", image_points, "B", "V", "N", 2)
    if object_points.shape[:3] != image_points.shape[:3] or object_points.dim() != 4:
        shapes = f"{tuple(object_points.shape)} and {tuple(image_points.shape)}"
        raise ShapeError(f"{op}: expected object_points (B, V, N, 3) and image_points (B, V, N, 2), got {shapes}")
    _check.same_device(op, object_points=object_points, image_points=image_points)
    height, width = _check.ints(op, "image_size", tuple(image_size), 2)
    _check.choice(op, "model", model, tuple(COUNTS))
    n = (5 if model == "brown_conrady" else 4) if num_coefficients is None else num_coefficients
    if n not in COUNTS[model]:
        listed = ", ".join(map(str, COUNTS[model]))
        raise ValueCheckError(f"{op}: expected num_coefficients of {model} to be one of {listed}, got {n!r}")
    batch, views, count = image_points.shape[:3]
    dtype = torch.promote_types(torch.promote_types(object_points.dtype, image_points.dtype), torch.float32)
    X, pixels = object_points.to(dtype), image_points.to(dtype)
    w = torch.ones_like(pixels[..., 0]) if weights is None else weights.to(dtype)
    _check.shape(op, "weights", w, batch, views, count)
    with torch.no_grad():
        camera, rotation, translation = _start(model, X, pixels, w, height, width)
        is_seen = rotation.flatten(2).isfinite().all(-1)
        rotation = torch.where(is_seen[..., None, None], rotation, torch.eye(3, dtype=dtype, device=X.device))
        pose = Se3(So3.from_matrix(rotation), torch.where(is_seen[..., None], translation, 0)).requires_grad_(False)
    w = torch.where(is_seen[..., None], w, 0)
    view, by_view = torch.arange(views, device=X.device), loss == "linear"
    fit = least_squares(
        _BoardError(model, X, pixels, w if by_view else None),
        {"camera": camera, "dist": X.new_zeros(batch, n), "pose": pose},
        None if by_view else w.flatten(1),
        loss,
        f_scale,
        index={"pose": view if by_view else view.repeat_interleave(count)},
        eliminate="pose",
        max_iterations=max_iterations,
        ftol=1e-9,
        xtol=1e-10,
    )
    # Lenses of many coefficients are nearly undetermined by most views: their errors are small where they have no covariance.
    unknowns = 4 + n + 6 * is_seen.sum(1)
    is_fitted = fit.cost.isfinite() & (2 * (w > 0).sum((1, 2)) >= unknowns) & is_seen.any(1)
    found = fit.variables
    square = _BoardError(model, X, pixels, w)(found).square().sum(-1)  # (B, V)
    poses = poses_where(is_fitted[:, None] & is_seen, found["pose"])

    def known(x: Tensor) -> Tensor:
        return torch.where(is_fitted.reshape(-1, *(1,) * (x.dim() - 1)), x, torch.nan)

    fx, fy, cx, cy = found["camera"].unbind(-1)
    K = camera_matrix_of(fx, fy, cx, cy)
    return CameraCalibration(
        known(K),
        known(found["dist"]),
        poses,
        known((square.sum(1) / w.sum((1, 2))).sqrt()),
        known((square / w.sum(2)).sqrt()),
        known(covariance_of(fit, w, unknowns)),
        is_fitted & fit.converged,
    )


def covariance_of(fit: LeastSquaresResult, weights: Tensor, unknowns: Tensor) -> Tensor:
    """The covariance of a fit to the points of weight above 0, two residuals each, whose variance the cost tells."""
    freedom = 2 * (weights > 0).flatten(1).sum(1) - unknowns
    variance = torch.where(freedom > 0, 2 * fit.cost.detach() / freedom, torch.nan)
    return fit.covariance(sigma=1.0) * variance[:, None, None]


def poses_where(condition: Tensor, pose: Se3) -> Se3:
    """The poses where a condition is true, NaN elsewhere."""
    q, t = (torch.where(condition[..., None], x, torch.nan) for x in (pose.quaternion.data, pose.t))
    result = Se3(So3.from_wxyz(q), t)
    return result if q.requires_grad else result.requires_grad_(False)


# --- the start -------------------------------------------------------------------------------------------------------


def _start(
    model: str, X: Tensor, pixels: Tensor, weights: Tensor, height: int, width: int
) -> tuple[Tensor, Tensor, Tensor]:
    """(fx, fy, cx, cy) (B, 4), rotations (B, V, 3, 3) and translations; NaN for views without a homography."""
    center = pixels.new_tensor([(width - 1) / 2, (height - 1) / 2])
    offset = pixels - center
    if model == "kannala_brandt":
        focal = torch.full_like(pixels[:, 0, 0], max(height, width) / torch.pi)
        camera = torch.cat([focal, center.expand_as(focal)], -1)
        seen = rays(model, pixels.flatten(1, 2), camera, pixels.new_zeros(len(X), 4))
        return (camera, *poses_of_homographies(homographies_of_rays(X, seen.unflatten(1, X.shape[1:3]), weights)))
    H = homographies_of_views(X, offset, weights)
    focal = _focal_lengths(H, weights.sum(-1) > 0, float(max(height, width)))
    rotation, translation = poses_of_homographies(
        H / torch.cat([focal, torch.ones_like(focal[:, :1])], -1)[:, None, :, None]
    )
    return torch.cat([focal, center.expand_as(focal)], -1), rotation, translation


def homographies_of_views(X: Tensor, x: Tensor, weights: Tensor) -> Tensor:
    """Homographies (B, V, 3, 3) from targets to images; NaN with fewer than four points."""
    batch, views, count = weights.shape
    used = (weights > 0) & x.isfinite().all(-1)
    plane = torch.where(used[..., None], X[..., :2], 0).flatten(0, 1)
    image = torch.where(used[..., None], x, 0).flatten(0, 1)
    if count < 4:
        return x.new_full((batch, views, 3, 3), torch.nan)
    H = find_homography_dlt(plane, image, used.flatten(0, 1).to(x.dtype)).unflatten(0, (batch, views))
    H = torch.where(H[..., 2:, 2:] < 0, -H, H)  # in front of the camera
    return torch.where((used.sum(-1) >= 4)[..., None, None], H, torch.nan)


def homographies_of_rays(X: Tensor, seen: Tensor, weights: Tensor) -> Tensor:
    """Homographies (B, V, 3, 3) from targets to unit vectors (B, V, N, 3) to their points; NaN with fewer than four points."""
    used = (weights > 0) & seen.isfinite().all(-1)
    plane = torch.where(used[..., None], X[..., :2], 0).flatten(0, 1)
    ray = torch.where(used[..., None], seen, 0).flatten(0, 1)
    w = used.flatten(0, 1).to(X.dtype)
    plane, T = normalized(plane, w)
    target = torch.nn.functional.pad(plane, (0, 1), value=1.0)
    rows = (skew(ray)[..., None] * target[..., None, None, :]).flatten(-2).flatten(1, 2)  # of ray x (H target) = 0
    H = null_vector(rows, w.repeat_interleave(3, 1)).unflatten(-1, (3, 3))
    along = (w * (ray * (target @ H.mT)).sum(-1)).sum(1)[:, None, None]
    H = (torch.where(along < 0, -H, H) @ T).unflatten(0, weights.shape[:2])
    return torch.where((used.sum(-1) >= 4)[..., None, None], H, torch.nan)


def _focal_lengths(H: Tensor, is_used: Tensor, size: float) -> Tensor:
    """Focal lengths (B, 2) for which the first columns of homographies are orthogonal and equally long."""
    H = H / torch.linalg.vector_norm(H[..., :2], dim=(-2, -1), keepdim=True) * size
    H = H / torch.tensor([size, size, 1.0], dtype=H.dtype, device=H.device)[:, None]
    a, b = H[..., 0], H[..., 1]
    rows = torch.stack([a * b, (a.square() - b.square()) / 2], 2).flatten(1, 2)  # of (1 / fx^2, 1 / fy^2, 1)
    rows = torch.where(rows.isfinite() & is_used.repeat_interleave(2, 1)[..., None], rows, 0)
    A, y = rows[..., :2], -rows[..., 2:]
    inverse_square = torch.linalg.solve_ex(A.mT @ A, A.mT @ y).result[..., 0]
    is_known = inverse_square.isfinite() & (inverse_square > 0.01) & (inverse_square < 400)
    known = torch.where(is_known, inverse_square, 1).rsqrt()
    # With one number missing, pixels are square.
    other = known.flip(-1)
    return size * torch.where(is_known, known, torch.where(is_known.flip(-1), other, 1))


def poses_of_homographies(H: Tensor) -> tuple[Tensor, Tensor]:
    """Rotations and translations of targets, from homographies [r1 r2 t] up to a positive factor."""
    a, b, t = H.unbind(-1)
    scale = (2 / (torch.linalg.vector_norm(a, dim=-1) + torch.linalg.vector_norm(b, dim=-1)))[..., None]
    a, b, t = a * scale, b * scale, t * scale
    half, rest = torch.nn.functional.normalize(a + b, dim=-1), torch.nn.functional.normalize(a - b, dim=-1)
    rest = torch.nn.functional.normalize(rest - (half * rest).sum(-1, keepdim=True) * half, dim=-1)
    first, second = (half + rest) / 2**0.5, (half - rest) / 2**0.5
    return torch.stack([first, second, torch.linalg.cross(first, second)], -1), t
