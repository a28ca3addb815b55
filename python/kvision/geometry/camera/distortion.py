"""Maps between the plane at depth 1 and pixels: pinhole cameras, and the fisheye model of Kannala and Brandt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, overload

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._ops import with_kernel_casts
from kvision.geometry._validity import with_validity
from kvision.geometry.conversions.series import (
    angle_per_sine,
    angle_per_tangent,
    angle_per_tangent_with_derivatives,
    cos,
    sinc,
)
from kvision.geometry.solvers.roots import first_root

__all__ = [
    "distort_points_affine",
    "distort_points_kannala_brandt",
    "dx_distort_points_affine",
    "dx_distort_points_kannala_brandt",
    "undistort_points_affine",
    "undistort_points_kannala_brandt",
]

# --- pinhole --------------------------------------------------------------------------------------------------------


@overload
def distort_points_affine(
    projected_points_in_camera_z1_plane: Tensor, params: Tensor, return_valid: Literal[False] = False
) -> Tensor: ...
@overload
def distort_points_affine(
    projected_points_in_camera_z1_plane: Tensor, params: Tensor, return_valid: bool
) -> Tensor | tuple[Tensor, Tensor]: ...
def distort_points_affine(
    projected_points_in_camera_z1_plane: Tensor, params: Tensor, return_valid: bool = False
) -> Tensor | tuple[Tensor, Tensor]:
    """Map points of the plane at depth 1 to pixels of a pinhole camera: f * p + c.

    Args:
        projected_points_in_camera_z1_plane: points (x, y) in the plane at depth 1, of shape (*, 2). Integers give float32.
        params: camera parameters (fx, fy, cx, cy) of shape (*, 4). Leading axes broadcast.
        return_valid: also return which points are finite.

    Returns:
        Points (x, y) of shape (*, 2), in pixels. With `return_valid` also a mask (*); pixels of other points have no
        gradient then.

    Raises:
        TypeError: `projected_points_in_camera_z1_plane` or `params` is not a tensor of real numbers; `return_valid` is not
            a bool.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.distort_points_affine(torch.ones(2), torch.tensor([100.0, 200, 320, 240]))
        tensor([420., 440.])
    """
    points = _points("distort_points_affine", projected_points_in_camera_z1_plane, params, 4)
    _check.flag("distort_points_affine", "return_valid", return_valid)
    if not return_valid:
        return _distort_affine(points, params)
    return with_validity(_distort_affine, points, points.isfinite().all(-1), params)


@with_kernel_casts
def _distort_affine(points: Tensor, params: Tensor) -> Tensor:
    return _to_pixels(points, params)


def _to_pixels(points: Tensor, params: Tensor) -> Tensor:
    return params[..., :2] * points + params[..., 2:4]


def undistort_points_affine(distorted_points_in_camera: Tensor, params: Tensor) -> Tensor:
    """Map pixels of a pinhole camera to the plane at depth 1: the inverse of :func:`distort_points_affine`.

    Args:
        distorted_points_in_camera: points (x, y) in pixels, of shape (*, 2). Integers give float32.
        params: camera parameters (fx, fy, cx, cy) of shape (*, 4). Leading axes broadcast.

    Returns:
        Points (x, y) of shape (*, 2), in the plane at depth 1.

    Raises:
        TypeError: `distorted_points_in_camera` or `params` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([100.0, 200, 320, 240])
        >>> K.geometry.camera.undistort_points_affine(torch.tensor([420.0, 440.0]), camera)
        tensor([1., 1.])
    """
    points = _points("undistort_points_affine", distorted_points_in_camera, params, 4)
    return with_kernel_casts(_from_pixels)(points, params)


def _from_pixels(pixels: Tensor, params: Tensor) -> Tensor:
    return (pixels - params[..., 2:4]) / params[..., :2]


def dx_distort_points_affine(projected_points_in_camera_z1_plane: Tensor, params: Tensor) -> Tensor:
    """The Jacobian of :func:`distort_points_affine` with respect to its points.

    Args:
        projected_points_in_camera_z1_plane: points (x, y) in the plane at depth 1, of shape (*, 2). Integers give float32.
        params: camera parameters (fx, fy, cx, cy) of shape (*, 4). Leading axes broadcast.

    Returns:
        Jacobians of shape (*, 2, 2), whose rows belong to the pixel's x and y.

    Raises:
        TypeError: `projected_points_in_camera_z1_plane` or `params` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.dx_distort_points_affine(torch.ones(2), torch.tensor([100.0, 200, 320, 240]))
        tensor([[100.,   0.],
                [  0., 200.]])
    """
    points = _points("dx_distort_points_affine", projected_points_in_camera_z1_plane, params, 4)
    return with_kernel_casts(lambda p, f: torch.diag_embed(f[..., :2] + 0 * p))(points, params)


# --- fisheye --------------------------------------------------------------------------------------------------------


@overload
def distort_points_kannala_brandt(
    projected_points_in_camera_z1_plane: Tensor, params: Tensor, return_valid: Literal[False] = False
) -> Tensor: ...
@overload
def distort_points_kannala_brandt(
    projected_points_in_camera_z1_plane: Tensor, params: Tensor, return_valid: bool
) -> Tensor | tuple[Tensor, Tensor]: ...
def distort_points_kannala_brandt(
    projected_points_in_camera_z1_plane: Tensor, params: Tensor, return_valid: bool = False
) -> Tensor | tuple[Tensor, Tensor]:
    """Map points of the plane at depth 1 to pixels of a fisheye camera.

    A point at an angle theta from the optical axis keeps its direction from the principal point. Its distance from there
    becomes f * theta * (1 + k0 theta^2 + k1 theta^4 + k2 theta^6 + k3 theta^8). This is the model of OpenCV's fisheye module.

    Args:
        projected_points_in_camera_z1_plane: points (x, y) in the plane at depth 1, of shape (*, 2). Integers give float32.
        params: camera parameters (fx, fy, cx, cy, k0, k1, k2, k3) of shape (*, 8). Leading axes broadcast.
        return_valid: also return which points are finite and at an angle up to which the distorted angle grows.

    Returns:
        Points (x, y) of shape (*, 2), in pixels. With `return_valid` also a mask (*); pixels of other points have no
        gradient then.

    Raises:
        TypeError: `projected_points_in_camera_z1_plane` or `params` is not a tensor of real numbers; `return_valid` is not
            a bool.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Source: J. Kannala, S. Brandt, "A generic camera model and calibration method for conventional, wide-angle, and fish-eye
    lenses" (2006).

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([100.0, 100, 320, 240, 0, 0, 0, 0])
        >>> K.geometry.camera.distort_points_kannala_brandt(torch.tensor([1.0, 0.0]), camera)
        tensor([398.5398, 240.0000])
    """
    points = _points("distort_points_kannala_brandt", projected_points_in_camera_z1_plane, params, 8)
    _check.flag("distort_points_kannala_brandt", "return_valid", return_valid)
    if not return_valid:
        return _distort_fisheye(points, params)
    return with_validity(_distort_fisheye, points, _is_projected(points.detach(), params.detach()), params)


def _is_projected(points: Tensor, params: Tensor) -> Tensor:
    params = as_dtype(params, compute_dtype(points))
    square = _squared_radius(points.to(params.dtype))
    angle = square.sqrt().atan().square()
    return points.isfinite().all(-1) & (angle <= _monotone_angle(params))


@with_kernel_casts
def _distort_fisheye(points: Tensor, params: Tensor) -> Tensor:
    square = _squared_radius(points)
    # The distorted over the undistorted radius.
    per_radius = angle_per_tangent(square)
    scale = per_radius * _polynomial(per_radius.square() * square, _coefficients(params))
    return _to_pixels(points * scale.unsqueeze(-1), params)


def distort_rays_kannala_brandt(rays: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
    """The pixels (*, 2) of rays (*, 3), to 180 degrees from the axis, and which rays the lens shows.

    Pixels of other rays are finite, without a gradient.
    """
    x, y, z = rays.detach().unbind(-1)
    square = x * x + y * y
    angle = torch.atan2(square.sqrt(), z).square()
    valid = (angle <= _monotone_angle(params.detach())) & ((z > 0) | (square > 0))
    x, y, z = torch.where(valid[..., None], rays, rays.new_tensor([0.0, 0.0, 1.0])).unbind(-1)
    square = x * x + y * y
    per_radius = angle_per_sine(square, z)
    scale = per_radius * _polynomial(per_radius.square() * square, _coefficients(params))
    return _to_pixels(torch.stack([x * scale, y * scale], -1), params), valid


def _squared_radius(points: Tensor) -> Tensor:
    """(*), one number a point: torch's loops are then as long as the points are many."""
    x, y = points.unbind(-1)
    return torch.addcmul(x * x, y, y)


def _coefficients(params: Tensor) -> list[Tensor]:
    """Those of the distorted angle over the angle, a polynomial in the squared angle: 1, k0, k1, k2, k3."""
    return [params.new_ones(()), *params[..., 4:].unbind(-1)]


def _polynomial(x: Tensor, coefficients: Sequence[Tensor]) -> Tensor:
    *others, total = coefficients
    for c in reversed(others):
        total = torch.addcmul(c, total, x)
    return total


def undistort_points_kannala_brandt(
    distorted_points_in_camera: Tensor, params: Tensor, return_rays: bool = False
) -> Tensor:
    """Map pixels of a fisheye camera to the plane at depth 1: the inverse of :func:`distort_points_kannala_brandt`.

    The inverse is computed by twelve damped Newton steps. Gradients flow through the last two. Angles count to where the
    distorted angle stops to grow with the angle.

    Args:
        distorted_points_in_camera: points (x, y) in pixels, of shape (*, 2). Integers give float32.
        params: camera parameters (fx, fy, cx, cy, k0, k1, k2, k3) of shape (*, 8). Leading axes broadcast.
        return_rays: return unit vectors (x, y, z), which reach to 180 degrees from the optical axis.

    Returns:
        Points (x, y) of shape (*, 2), in the plane at depth 1; NaN, without a gradient, for pixels whose ray is 90 degrees
        or more from the optical axis, or which have none. With `return_rays` unit vectors of shape (*, 3).

    Raises:
        TypeError: `distorted_points_in_camera` or `params` is not a tensor of real numbers; `return_rays` is not a bool.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([100.0, 100, 320, 240, 0, 0, 0, 0])
        >>> K.geometry.camera.undistort_points_kannala_brandt(torch.tensor([320 + 25 * torch.pi, 240.0]), camera)
        tensor([1.0000, 0.0000])
        >>> pixel = torch.tensor([320 + 75 * torch.pi, 240.0])
        >>> K.geometry.camera.undistort_points_kannala_brandt(pixel, camera, return_rays=True)
        tensor([ 0.7071,  0.0000, -0.7071])
    """
    op = "undistort_points_kannala_brandt"
    pixels = _points(op, distorted_points_in_camera, params, 8)
    _check.flag(op, "return_rays", return_rays)
    return _undistort_fisheye(pixels, params, return_rays)


@with_kernel_casts
def _undistort_fisheye(pixels: Tensor, params: Tensor, return_rays: bool) -> Tensor:
    params = as_dtype(params, pixels.dtype)
    points = _from_pixels(pixels, params)
    square = _squared_radius(points)
    k = _coefficients(params)
    derivative = [c * n for c, n in zip(k, (1, 3, 5, 7, 9))]  # of the distorted angle by the angle
    fixed = square.detach(), [c.detach() for c in k], [c.detach() for c in derivative]
    # The angle is `ratio` times the distorted radius: ratio * polynomial(angle^2) = 1. Newton's method starts from the radius
    # or, above 1, its cube root: from far above, a polynomial of degree 9 lets a step shrink the angle by a ninth only.
    largest = (_monotone_angle(params.detach()).clamp(max=math.pi**2) / fixed[0]).sqrt()
    ratio = torch.minimum(fixed[0].clamp(min=1).pow(-1 / 3), 0.9 * largest)
    for _ in range(10):
        ratio = torch.minimum(torch.maximum(_newton(ratio, *fixed), ratio / 4), (ratio + largest) / 2)
    residual = torch.addcmul(-k[0].detach(), ratio, _polynomial(ratio * ratio * fixed[0], fixed[1]))
    # A millionth of the focal length, or what rounding allows.
    rounding = 32 * torch.finfo(ratio.dtype).eps
    valid = (residual.abs() <= rounding) | (residual.square() * fixed[0] <= 1e-12)
    valid = valid & (ratio > 0) & (ratio <= largest)
    if not return_rays:
        valid = valid & (ratio * ratio * fixed[0] < (math.pi / 2) ** 2)
    square, ratio = torch.where(valid, square, 0), torch.where(valid, ratio, 1)
    for _ in range(2):
        ratio = _newton(ratio, square, k, derivative)
    angle = ratio * ratio * square
    scale = ratio * sinc(angle)
    where = valid.unsqueeze(-1)
    points = torch.where(where, points, 0)
    if not return_rays:
        return torch.where(where, points * (scale / cos(angle)).unsqueeze(-1), torch.nan)
    return torch.where(where, torch.cat([points * scale.unsqueeze(-1), cos(angle).unsqueeze(-1)], -1), torch.nan)


def _monotone_angle(params: Tensor) -> Tensor:
    """The squared angles (*) up to which the distorted angle grows, inf where it always does."""
    derivative = torch.stack([c * n for c, n in zip(params[..., 4:].unbind(-1), (3, 5, 7, 9))], -1)
    coefficients = torch.nn.functional.pad(derivative, (1, 0), value=1)
    limit: Tensor = first_root(coefficients.reshape(-1, 5))
    return limit.reshape(params.shape[:-1])


def _newton(ratio: Tensor, square: Tensor, k: Sequence[Tensor], derivative: Sequence[Tensor]) -> Tensor:
    angle = ratio * ratio * square
    residual = torch.addcmul(-k[0], ratio, _polynomial(angle, k))  # ratio * polynomial - 1
    return torch.addcdiv(ratio, residual, _polynomial(angle, derivative), value=-1)


def dx_distort_points_kannala_brandt(projected_points_in_camera_z1_plane: Tensor, params: Tensor) -> Tensor:
    """The Jacobian of :func:`distort_points_kannala_brandt` with respect to its points.

    Args:
        projected_points_in_camera_z1_plane: points (x, y) in the plane at depth 1, of shape (*, 2). Integers give float32.
        params: camera parameters (fx, fy, cx, cy, k0, k1, k2, k3) of shape (*, 8). Leading axes broadcast.

    Returns:
        Jacobians of shape (*, 2, 2), whose rows belong to the pixel's x and y.

    Raises:
        TypeError: `projected_points_in_camera_z1_plane` or `params` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([100.0, 100, 320, 240, 0, 0, 0, 0])
        >>> K.geometry.camera.dx_distort_points_kannala_brandt(torch.tensor([1.0, 0.5]), camera)
        tensor([[ 50.6011, -12.3132],
                [-12.3132,  69.0709]])
    """
    points = _points("dx_distort_points_kannala_brandt", projected_points_in_camera_z1_plane, params, 8)
    return _fisheye_jacobian(points, params)


@with_kernel_casts
def _fisheye_jacobian(points: Tensor, params: Tensor) -> Tensor:
    x, y = points.unbind(-1)
    fx, fy, _, _, *k = params.unbind(-1)
    square = torch.addcmul(x * x, y, y)
    # As in _distort_fisheye. The derivatives are with respect to the squared distance.
    per_radius, grad_per_radius, grad_angle = angle_per_tangent_with_derivatives(square)
    angle = per_radius * per_radius * square
    polynomial = 1 + angle * _polynomial(angle, k)
    grad_polynomial = torch.addcmul(k[0], angle, 2 * k[1] + angle * torch.addcmul(3 * k[2], angle, k[3], value=4))
    scale = per_radius * polynomial
    twice = 2 * torch.addcmul(grad_per_radius * polynomial, per_radius * per_radius * grad_angle, grad_polynomial)
    right, down = twice * x, twice * y
    mixed = right * y
    entries = torch.broadcast_tensors(
        fx * torch.addcmul(scale, right, x), fx * mixed, fy * mixed, fy * torch.addcmul(scale, down, y)
    )
    return torch.stack(entries, -1).unflatten(-1, (2, 2))


def _points(op: str, points: Tensor, params: Tensor, count: int) -> Tensor:
    name = "distorted_points_in_camera" if op.startswith("un") else "projected_points_in_camera_z1_plane"
    _check.trailing_shape(op, name, points, 2)
    _check.trailing_shape(op, "params", params, count)
    _check.subtractable(op, params=params)
    _check.same_device(op, **{name: points, "params": params})
    _check.broadcastable(op, **{name: points.shape[:-1], "params": params.shape[:-1]})
    return floats(points)
