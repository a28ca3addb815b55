"""Lenses and projections of cameras: maps between points in the camera's frame, rays and pixels."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, Protocol

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype
from kvision.core.exceptions import TypeCheckError
from kvision.geometry._intrinsics import camera_matrix_of
from kvision.geometry._validity import NEAREST
from kvision.geometry.calibration.distortion import distort_points, undistort_points
from kvision.geometry.camera.distortion import (
    distort_points_affine,
    distort_points_kannala_brandt,
    distort_rays_kannala_brandt,
    undistort_points_affine,
    undistort_points_kannala_brandt,
)
from kvision.geometry.camera.projection import project_points_orthographic, project_points_z1
from kvision.geometry.vector import Vector2, Vector3

__all__ = [
    "AffineTransform",
    "BrownConradyTransform",
    "DoubleSphereTransform",
    "EnhancedUnifiedTransform",
    "EquirectangularTransform",
    "KannalaBrandtK3Transform",
    "OrthographicProjection",
    "Z1Projection",
]


class Distortion(Protocol):
    """A lens: a map between the plane at depth 1, or rays, and pixels."""

    size: int  # the number of parameters

    def distort(self, params: Tensor, points: Vector2) -> Vector2: ...

    def undistort(self, params: Tensor, points: Vector2) -> Vector2: ...

    def distort_rays(self, params: Tensor, rays: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels (*, 2) of rays (*, 3), finite for all, and which rays the lens shows; others have no gradient."""
        ...

    def undistort_rays(self, params: Tensor, pixels: Tensor) -> Tensor:
        """Rays (*, 3) of pixels (*, 2); NaN, without a gradient, for pixels without one."""
        ...


class Projection(Protocol):
    """A map between points in the camera's frame and points of a plane."""

    def project(self, points: Vector3) -> Vector2: ...

    def unproject(self, points: Vector2, depth: Tensor | float) -> Vector3: ...


def _for_points(params: Tensor, points: Tensor) -> Tensor:
    """Parameters (B, N) of the cameras of points (B, *, D), one camera an element of the first axis: (B, 1, ..., N)."""
    if params.dim() == 1 or points.dim() < 2:
        return params
    return params.reshape(params.shape[0], *[1] * (points.dim() - 2), params.shape[1])


# --- projections ----------------------------------------------------------------------------------------------------


class Z1Projection:
    """The perspective projection onto the plane at depth 1.

    Example:
        >>> from kvision.geometry.vector import Vector3
        >>> from kvision.sensors.camera import Z1Projection
        >>> Z1Projection().project(Vector3.from_coords(2.0, 4.0, 2.0))
        Vector2(tensor([1., 2.]))
    """

    def project(self, points: Vector3) -> Vector2:
        """The points (x / z, y / z). They are not finite where z is 0, and mirrored where it is negative."""
        return Vector2(project_points_z1(_data("Z1Projection.project", points, Vector3)))

    def unproject(self, points: Vector2, depth: Tensor | float) -> Vector3:
        """The points of depths z, a number or of shape (*), that project to `points`: (x z, y z, z)."""
        x, y, z = _with_depth("Z1Projection.unproject", points, depth)
        return Vector3.from_coords(x * z, y * z, z)


class OrthographicProjection:
    """The projection along z: (x, y), whatever the depth.

    Example:
        >>> from kvision.geometry.vector import Vector3
        >>> from kvision.sensors.camera import OrthographicProjection
        >>> OrthographicProjection().project(Vector3.from_coords(2.0, 4.0, 2.0))
        Vector2(tensor([2., 4.]))
    """

    def project(self, points: Vector3) -> Vector2:
        """The points (x, y)."""
        return Vector2(project_points_orthographic(_data("OrthographicProjection.project", points, Vector3)))

    def unproject(self, points: Vector2, depth: Tensor | float) -> Vector3:
        """The points of depths z, a number or of shape (*), that project to `points`: (x, y, z)."""
        x, y, z = _with_depth("OrthographicProjection.unproject", points, depth)
        return Vector3.from_coords(x, y, z)


def _with_depth(op: str, points: Vector2, depth: Tensor | float) -> list[Tensor]:
    xy = _data(op, points, Vector2)
    z = depth.to(xy) if isinstance(depth, Tensor) else xy.new_tensor(_check.number(op, "depth", depth))
    _check.broadcastable(op, points=xy.shape[:-1], depth=z.shape)
    return list(torch.broadcast_tensors(xy[..., 0], xy[..., 1], z))


def _rays_on_plane(rays: Tensor) -> tuple[Tensor, Tensor]:
    """The points of the plane at depth 1 on rays, and which rays meet it; the center for others."""
    is_front = rays[..., 2] > NEAREST
    return rays[..., :2] / torch.where(is_front, rays[..., 2], math.inf)[..., None], is_front


def _rays_of_plane(points: Tensor) -> Tensor:
    return torch.cat([points, torch.ones_like(points[..., :1])], -1)


def _data(op: str, points: Any, kind: type[Vector2] | type[Vector3]) -> Tensor:
    if not isinstance(points, kind):
        raise TypeCheckError(
            f"{op}: expected points to be a {kind.__name__}, got {_check.described(points)}", actual_type=type(points)
        )
    return points.data


# --- lenses ---------------------------------------------------------------------------------------------------------


class AffineTransform:
    """No distortion: f p + c. Parameters are (fx, fy, cx, cy).

    Example:
        >>> import torch
        >>> from kvision.geometry.vector import Vector2
        >>> from kvision.sensors.camera import AffineTransform
        >>> AffineTransform().distort(torch.tensor([1.0, 2, 3, 4]), Vector2.from_coords(1.0, 2.0))
        Vector2(tensor([4., 8.]))
    """

    size = 4

    def distort(self, params: Tensor, points: Vector2) -> Vector2:
        """Points of the plane at depth 1 in pixels."""
        xy = _data("AffineTransform.distort", points, Vector2)
        return Vector2(distort_points_affine(xy, _for_points(params, xy)))

    def undistort(self, params: Tensor, points: Vector2) -> Vector2:
        """Pixels on the plane at depth 1."""
        uv = _data("AffineTransform.undistort", points, Vector2)
        return Vector2(undistort_points_affine(uv, _for_points(params, uv)))

    def distort_rays(self, params: Tensor, rays: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels of rays, and which rays go forwards."""
        points, is_front = _rays_on_plane(rays)
        return distort_points_affine(points, _for_points(params, points)), is_front

    def undistort_rays(self, params: Tensor, pixels: Tensor) -> Tensor:
        """Rays of pixels."""
        return _rays_of_plane(undistort_points_affine(pixels, _for_points(params, pixels)))


class BrownConradyTransform:
    """The distortion of :func:`kvision.geometry.distort_points`. Parameters are (fx, fy, cx, cy, k1, k2, p1, p2, k3, ..., k6).

    Fewer or more coefficients may be given, as there: 4 + n parameters with n one of 4, 5, 8, 12 and 14.

    Example:
        >>> import torch
        >>> from kvision.geometry.vector import Vector2
        >>> from kvision.sensors.camera import BrownConradyTransform
        >>> params = torch.tensor([10.0, 10, 5, 5, 0.1, 0, 0, 0, 0, 0, 0, 0])
        >>> BrownConradyTransform().distort(params, Vector2.from_coords(1.0, 0.0))
        Vector2(tensor([16.,  5.]))
    """

    size = 12
    sizes = (8, 9, 12, 16, 18)

    def distort(self, params: Tensor, points: Vector2) -> Vector2:
        """Points of the plane at depth 1 in pixels."""
        xy = _data("BrownConradyTransform.distort", points, Vector2)
        return Vector2(self._through(distort_points, xy, params))

    def undistort(self, params: Tensor, points: Vector2) -> Vector2:
        """Pixels on the plane at depth 1; NaN where the lens shows no point."""
        uv = _data("BrownConradyTransform.undistort", points, Vector2)
        return Vector2(self._through(undistort_points, uv, params))

    def distort_rays(self, params: Tensor, rays: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels of rays, and which rays are within the radius to which the radial distortion grows."""
        points, is_front = _rays_on_plane(rays)
        pixels, valid = self._through(functools.partial(distort_points, return_valid=True), points, params)
        return pixels, valid & is_front

    def undistort_rays(self, params: Tensor, pixels: Tensor) -> Tensor:
        """Rays of pixels; NaN where the lens shows none."""
        return _rays_of_plane(self._through(undistort_points, pixels, params))

    @staticmethod
    def _through(function: Callable[..., Any], points: Tensor, params: Tensor) -> Any:
        of_points = points.dim() == 1 or params.dim() == points.dim() == 2
        given = points[..., None, :] if of_points else points
        params = params if params.dim() == 1 else _for_points(params, given[..., 0, :])
        matrix, dist = camera_matrix_of(*params[..., :4].unbind(-1)), params[..., 4:]
        moved = function(given, matrix, dist, torch.eye(3, dtype=params.dtype, device=params.device))
        if not of_points:
            return moved
        return moved.squeeze(-2) if isinstance(moved, Tensor) else (moved[0].squeeze(-2), moved[1].squeeze(-1))


class KannalaBrandtK3Transform:
    """The lens of :func:`kvision.geometry.camera.distort_points_kannala_brandt`. Parameters are (fx, fy, cx, cy, k1, k2, k3, k4).

    Example:
        >>> import torch
        >>> from kvision.geometry.vector import Vector2
        >>> from kvision.sensors.camera import KannalaBrandtK3Transform
        >>> params = torch.tensor([100.0, 100, 0, 0, 0, 0, 0, 0])
        >>> KannalaBrandtK3Transform().distort(params, Vector2.from_coords(1.0, 0.0))
        Vector2(tensor([78.5398,  0.0000]))
    """

    size = 8

    def distort(self, params: Tensor, points: Vector2) -> Vector2:
        """Points of the plane at depth 1 in pixels."""
        xy = _data("KannalaBrandtK3Transform.distort", points, Vector2)
        return Vector2(distort_points_kannala_brandt(xy, _for_points(params, xy)))

    def undistort(self, params: Tensor, points: Vector2) -> Vector2:
        """Pixels on the plane at depth 1; NaN where it has no point for them."""
        uv = _data("KannalaBrandtK3Transform.undistort", points, Vector2)
        return Vector2(undistort_points_kannala_brandt(uv, _for_points(params, uv)))

    def distort_rays(self, params: Tensor, rays: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels of rays, and which rays are within the angle to which the distorted angle grows."""
        return distort_rays_kannala_brandt(rays, as_dtype(_for_points(params, rays), rays.dtype))

    def undistort_rays(self, params: Tensor, pixels: Tensor) -> Tensor:
        """Rays of pixels, to 180 degrees from the axis; NaN where the lens shows none."""
        rays: Tensor = undistort_points_kannala_brandt(pixels, _for_points(params, pixels), return_rays=True)
        return rays


class _RayTransform:
    """A lens by its formulas for rays. Those of the plane at depth 1 follow."""

    def distort(self, params: Tensor, points: Vector2) -> Vector2:
        """Points of the plane at depth 1 in pixels."""
        xy = _data(f"{type(self).__name__}.distort", points, Vector2)
        return Vector2(self.distort_rays(params, _rays_of_plane(xy))[0])

    def undistort(self, params: Tensor, points: Vector2) -> Vector2:
        """Pixels on the plane at depth 1; NaN for pixels whose rays do not meet it."""
        rays = self.undistort_rays(params, _data(f"{type(self).__name__}.undistort", points, Vector2))
        plane, is_front = _rays_on_plane(rays)
        return Vector2(torch.where(is_front[..., None], plane, torch.nan))

    def distort_rays(self, params: Tensor, rays: Tensor) -> tuple[Tensor, Tensor]:
        raise NotImplementedError

    def undistort_rays(self, params: Tensor, pixels: Tensor) -> Tensor:
        raise NotImplementedError


def _forwards(rays: Tensor, valid: Tensor) -> Tensor:
    """Rays where they are valid, the optical axis elsewhere."""
    return torch.where(valid[..., None], rays, rays.new_tensor([0.0, 0.0, 1.0]))


def _columns(params: Tensor, points: Tensor) -> tuple[Tensor, ...]:
    return as_dtype(_for_points(params, points), points.dtype).unbind(-1)


class EquirectangularTransform(_RayTransform):
    """A panorama: columns are longitudes about y, rows are latitudes. Parameters are (fx, fy, cx, cy), in pixels per radian.

    Example:
        >>> import torch
        >>> from kvision.sensors.camera import EquirectangularTransform
        >>> EquirectangularTransform().distort_rays(torch.tensor([100.0, 100, 320, 160]), torch.tensor([0.0, 0.0, 1.0]))
        (tensor([320., 160.]), tensor(True))
    """

    size = 4

    def distort_rays(self, params: Tensor, rays: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels of rays, with longitudes from -180 to 180 degrees, and which are not 0."""
        fx, fy, cx, cy = _columns(params, rays)
        x, y, z = rays.unbind(-1)
        is_pole = (x == 0) & (z == 0)  # where any longitude is right
        x, z = x, torch.where(is_pole, 1, z)
        latitude = torch.atan2(y, torch.where(is_pole, 0, (x * x + z * z).sqrt()))
        pixels = torch.stack([fx * torch.atan2(x, z) + cx, fy * latitude + cy], -1)
        return pixels, (y != 0) | ~is_pole

    def undistort_rays(self, params: Tensor, pixels: Tensor) -> Tensor:
        """Unit rays of pixels; NaN beyond the poles."""
        fx, fy, cx, cy = _columns(params, pixels)
        u, v = pixels.unbind(-1)
        longitude, latitude = (u - cx) / fx, (v - cy) / fy
        y, level = latitude.sin(), latitude.cos()
        rays = torch.stack([level * longitude.sin(), y, level * longitude.cos()], -1)
        return torch.where((latitude.abs() <= math.pi / 2)[..., None], rays, torch.nan)


def _largest_sine(alpha: Tensor) -> Tensor:
    """Of the unified models: minus the least z over the distance that a ray has."""
    return torch.where(alpha <= 0.5, alpha / (1 - alpha), (1 - alpha) / alpha)


class DoubleSphereTransform(_RayTransform):
    """The double sphere model of fisheye lenses. Parameters are (fx, fy, cx, cy, xi, alpha).

    Source: V. Usenko, N. Demmel, D. Cremers, "The Double Sphere Camera Model" (2018).

    Example:
        >>> import torch
        >>> from kvision.sensors.camera import DoubleSphereTransform
        >>> params = torch.tensor([100.0, 100, 320, 240, 0.0, 0.5])
        >>> DoubleSphereTransform().distort_rays(params, torch.tensor([0.6, 0.0, 0.8]))
        (tensor([386.6667, 240.0000]), tensor(True))
    """

    size = 6

    def distort_rays(self, params: Tensor, rays: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels of rays, and which rays the model shows."""
        fx, fy, cx, cy, xi, alpha = _columns(params, rays)
        w = _largest_sine(alpha)
        w = (w + xi) / (2 * w * xi + xi * xi + 1).sqrt()
        valid = (rays[..., 2] > -w * torch.linalg.vector_norm(rays, dim=-1)).detach()
        x, y, z = _forwards(rays, valid).unbind(-1)
        plane = x * x + y * y
        shifted = xi * (plane + z * z).sqrt() + z
        depth = alpha * (plane + shifted * shifted).sqrt() + (1 - alpha) * shifted
        return torch.stack([fx * x / depth + cx, fy * y / depth + cy], -1), valid

    def undistort_rays(self, params: Tensor, pixels: Tensor) -> Tensor:
        """Unit rays of pixels; NaN beyond those of the model."""
        fx, fy, cx, cy, xi, alpha = _columns(params, pixels)
        u, v = pixels.unbind(-1)
        x, y = (u - cx) / fx, (v - cy) / fy
        square = x * x + y * y
        inner = 1 - (2 * alpha - 1) * square
        valid = inner > 0
        x, y, square, inner = (torch.where(valid, a, b) for a, b in ((x, 0), (y, 0), (square, 0), (inner, 1)))
        z = (1 - alpha * alpha * square) / (alpha * inner.sqrt() + 1 - alpha)
        root = z * z + (1 - xi * xi) * square
        valid, root = valid & (root > 0), torch.where(root > 0, root, 1)
        scale = (z * xi + root.sqrt()) / (z * z + square)
        return torch.where(valid[..., None], torch.stack([scale * x, scale * y, scale * z - xi], -1), torch.nan)


class EnhancedUnifiedTransform(_RayTransform):
    """The enhanced unified camera model (EUCM) of fisheye lenses. Parameters are (fx, fy, cx, cy, alpha, beta).

    Source: B. Khomutenko, G. Garcia, P. Martinet, "An Enhanced Unified Camera Model" (2016).

    Example:
        >>> import torch
        >>> from kvision.sensors.camera import EnhancedUnifiedTransform
        >>> params = torch.tensor([100.0, 100, 320, 240, 0.5, 1.0])
        >>> EnhancedUnifiedTransform().distort_rays(params, torch.tensor([0.6, 0.0, 0.8]))
        (tensor([386.6667, 240.0000]), tensor(True))
    """

    size = 6

    def distort_rays(self, params: Tensor, rays: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels of rays, and which rays the model shows."""
        fx, fy, cx, cy, alpha, beta = _columns(params, rays)
        x, y, z = rays.detach().unbind(-1)
        valid = z > -_largest_sine(alpha) * (beta * (x * x + y * y) + z * z).sqrt()
        x, y, z = _forwards(rays, valid).unbind(-1)
        depth = alpha * (beta * (x * x + y * y) + z * z).sqrt() + (1 - alpha) * z
        return torch.stack([fx * x / depth + cx, fy * y / depth + cy], -1), valid

    def undistort_rays(self, params: Tensor, pixels: Tensor) -> Tensor:
        """Unit rays of pixels; NaN beyond those of the model."""
        fx, fy, cx, cy, alpha, beta = _columns(params, pixels)
        u, v = pixels.unbind(-1)
        x, y = (u - cx) / fx, (v - cy) / fy
        square = beta * (x * x + y * y)
        inner = 1 - (2 * alpha - 1) * square
        valid = inner > 0
        x, y, square, inner = (torch.where(valid, a, b) for a, b in ((x, 0), (y, 0), (square, 0), (inner, 1)))
        z = (1 - alpha * alpha * square) / (alpha * inner.sqrt() + 1 - alpha)
        rays = torch.nn.functional.normalize(torch.stack([x, y, z], -1), dim=-1)
        return torch.where(valid[..., None], rays, torch.nan)
