"""From the plane at depth 1 to pixels and back: pinhole cameras, and fisheye cameras as Kannala and Brandt describe them."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._ops import with_kernel_casts
from kvision.geometry.conversions.series import angle_per_sine, angle_per_tangent_slope, cos, sinc, squared

__all__ = [
    "distort_points_affine",
    "distort_points_kannala_brandt",
    "dx_distort_points_affine",
    "dx_distort_points_kannala_brandt",
    "undistort_points_affine",
    "undistort_points_kannala_brandt",
]

# --- pinhole --------------------------------------------------------------------------------------------------------


def distort_points_affine(projected_points_in_camera_z1_plane: Tensor, params: Tensor) -> Tensor:
    """Points of the plane at depth 1 to pixels of a pinhole camera: f * p + c.

    Args:
        projected_points_in_camera_z1_plane: (*, 2).
        params: (*, 4) as (fx, fy, cx, cy), leading axes broadcast.

    Returns:
        (*, 2).

    Raises:
        TypeError: not two tensors of real numbers.
        ValueError: other shapes, or not on one device.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.distort_points_affine(torch.ones(2), torch.tensor([100.0, 200, 320, 240]))
        tensor([420., 440.])
    """
    points = _points("distort_points_affine", projected_points_in_camera_z1_plane, params, 4)
    return with_kernel_casts(_to_pixels)(points, params)


def _to_pixels(points: Tensor, params: Tensor) -> Tensor:
    return params[..., :2] * points + params[..., 2:4]


def undistort_points_affine(distorted_points_in_camera: Tensor, params: Tensor) -> Tensor:
    """Pixels (*, 2) of a pinhole camera to the plane at depth 1: the inverse of :func:`distort_points_affine`.

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
    """The Jacobians (*, 2, 2) of :func:`distort_points_affine`.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.dx_distort_points_affine(torch.ones(2), torch.tensor([100.0, 200, 320, 240]))
        tensor([[100.,   0.],
                [  0., 200.]])
    """
    points = _points("dx_distort_points_affine", projected_points_in_camera_z1_plane, params, 4)
    return with_kernel_casts(lambda p, f: torch.diag_embed(f[..., :2] + 0 * p))(points, params)


# --- fisheye --------------------------------------------------------------------------------------------------------


def distort_points_kannala_brandt(projected_points_in_camera_z1_plane: Tensor, params: Tensor) -> Tensor:
    """Points of the plane at depth 1 to pixels of a fisheye camera.

    A point at an angle theta from the axis is at f * theta * (1 + k0 theta^2 + k1 theta^4 + k2 theta^6 + k3 theta^8) from the
    principal point, in its direction. This is the model of OpenCV's fisheye module.

    Args:
        projected_points_in_camera_z1_plane: (*, 2).
        params: (*, 8) as (fx, fy, cx, cy, k0, k1, k2, k3), leading axes broadcast.

    Returns:
        (*, 2).

    Raises:
        TypeError: not two tensors of real numbers.
        ValueError: other shapes, or not on one device.

    Source: J. Kannala, S. Brandt, "A generic camera model and calibration method for conventional, wide-angle, and fish-eye
    lenses" (2006).

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([100.0, 100, 320, 240, 0, 0, 0, 0])
        >>> K.geometry.camera.distort_points_kannala_brandt(torch.tensor([1.0, 0.0]), camera)
        tensor([398.5398, 240.0000])
    """
    points = _points("distort_points_kannala_brandt", projected_points_in_camera_z1_plane, params, 8)
    return _fisheye(points, params)


@with_kernel_casts
def _fisheye(points: Tensor, params: Tensor) -> Tensor:
    return _to_pixels(points * _stretch(squared(points), params), params)


def _stretch(square: Tensor, params: Tensor) -> Tensor:
    """How much farther from the principal point a point is than at its distance, which is given squared."""
    per_radius = angle_per_sine(square, torch.ones_like(square))
    return per_radius * _polynomial(per_radius.square() * square, params)


def _polynomial(square: Tensor, params: Tensor, weights: tuple[int, ...] = (1, 1, 1, 1)) -> Tensor:
    """1 + k0 s + k1 s^2 + k2 s^3 + k3 s^4, each coefficient times its weight."""
    k = params[..., 4:].split(1, -1)
    total = k[3] * weights[3]
    for i in (2, 1, 0):
        total = total * square + k[i] * weights[i]
    return 1 + total * square


def undistort_points_kannala_brandt(distorted_points_in_camera: Tensor, params: Tensor) -> Tensor:
    """Pixels (*, 2) of a fisheye camera to the plane at depth 1: the inverse of :func:`distort_points_kannala_brandt`.

    Twelve Newton steps, of which the last two carry the gradients.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([100.0, 100, 320, 240, 0, 0, 0, 0])
        >>> K.geometry.camera.undistort_points_kannala_brandt(torch.tensor([320 + 25 * torch.pi, 240.0]), camera)
        tensor([1.0000, 0.0000])
    """
    pixels = _points("undistort_points_kannala_brandt", distorted_points_in_camera, params, 8)
    return _unfisheye(pixels, params)


@with_kernel_casts
def _unfisheye(pixels: Tensor, params: Tensor) -> Tensor:
    points = _from_pixels(pixels, params)
    square = squared(points)
    # The angle is `ratio` times the distance in the image: ratio * polynomial(angle^2) = 1.
    ratio = torch.ones_like(square)
    fixed = square.detach(), params.detach()
    for _ in range(10):
        ratio = _newton(ratio, *fixed)
    for _ in range(2):
        ratio = _newton(ratio, square, params)
    angle = ratio.square() * square
    return points * ratio * sinc(angle) / cos(angle)


def _newton(ratio: Tensor, square: Tensor, params: Tensor) -> Tensor:
    angle = ratio.square() * square
    return ratio - (ratio * _polynomial(angle, params) - 1) / _polynomial(angle, params, (3, 5, 7, 9))


def dx_distort_points_kannala_brandt(projected_points_in_camera_z1_plane: Tensor, params: Tensor) -> Tensor:
    """The Jacobians (*, 2, 2) of :func:`distort_points_kannala_brandt`.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([100.0, 100, 320, 240, 0, 0, 0, 0])
        >>> K.geometry.camera.dx_distort_points_kannala_brandt(torch.tensor([1.0, 0.0]), camera)
        tensor([[50.0000,  0.0000],
                [ 0.0000, 78.5398]])
    """
    points = _points("dx_distort_points_kannala_brandt", projected_points_in_camera_z1_plane, params, 8)
    return _fisheye_jacobian(points, params)


@with_kernel_casts
def _fisheye_jacobian(points: Tensor, params: Tensor) -> Tensor:
    square = squared(points)
    # As in _stretch, and the derivatives by the distance squared: of the angle per distance, of the angle squared, of all.
    per_radius, per_radius_slope = angle_per_sine(square, torch.ones_like(square)), angle_per_tangent_slope(square)
    angle = per_radius.square() * square
    angle_slope = per_radius.square() + 2 * per_radius * per_radius_slope * square
    polynomial = _polynomial(angle, params)
    stretch = per_radius * polynomial
    k = params[..., 4:].split(1, -1)
    by_angle = k[0] + angle * (2 * k[1] + angle * (3 * k[2] + angle * 4 * k[3]))
    slope = per_radius_slope * polynomial + per_radius * by_angle * angle_slope
    straight = torch.diag_embed(stretch.expand(*stretch.shape[:-1], 2))
    bent = 2 * slope[..., None] * points[..., :, None] * points[..., None, :]
    return params[..., :2, None] * (straight + bent)


def _points(op: str, points: Tensor, params: Tensor, count: int) -> Tensor:
    name = "distorted_points_in_camera" if op.startswith("un") else "projected_points_in_camera_z1_plane"
    _check.trailing_shape(op, name, points, 2)
    _check.trailing_shape(op, "params", params, count)
    _check.same_device(op, **{name: points, "params": params})
    _check.broadcastable(op, **{name: points.shape[:-1], "params": params.shape[:-1]})
    return floats(points)
