"""Lens models of calibration on the plane z = 1, with derivatives in closed form.

A lens maps points (*, M, 2) of the plane to points of the distorted plane, given coefficients (B, n).
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import torch
from torch import Tensor

from kvision.geometry._intrinsics import camera_matrix_of
from kvision.geometry.calibration.distortion import _coefficients, _radial, _shift, _with_jacobian, undistort_points
from kvision.geometry.camera.distortion import (
    distort_points_kannala_brandt,
    dx_distort_points_kannala_brandt,
    undistort_points_kannala_brandt,
)
from kvision.geometry.conversions.series import angle_per_tangent

LensModel: TypeAlias = Literal["brown_conrady", "kannala_brandt"]
COUNTS: dict[LensModel, tuple[int, ...]] = {"brown_conrady": (4, 5, 8, 12), "kannala_brandt": (4,)}


def distorted(model: str, points: Tensor, k: Tensor) -> Tensor:
    """Points (B, M, 2) behind the lens."""
    if model == "kannala_brandt":
        return distort_points_kannala_brandt(points, _with_unit_camera(k))
    x, y = points.unbind(-1)
    c = _coefficients(k)
    r2 = x * x + y * y
    radial, (dx, dy) = _radial(r2, c), _shift(x, y, r2, c)
    return torch.stack([x * radial + dx, y * radial + dy], -1)


def distorted_with_jacobians(model: str, points: Tensor, k: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """`distorted`, and its derivatives with respect to the points (B, M, 2, 2) and the coefficients (B, M, 2, n)."""
    x, y = points.unbind(-1)
    r2 = x * x + y * y
    if model == "kannala_brandt":
        camera = _with_unit_camera(k)
        per_radius = angle_per_tangent(r2)
        square = per_radius.square() * r2
        powers = torch.stack([square ** (i + 1) for i in range(4)], -1)
        to_k = points[..., None] * (per_radius[..., None] * powers)[..., None, :]
        image: Tensor = distort_points_kannala_brandt(points, camera)
        return image, dx_distort_points_kannala_brandt(points, camera), to_k
    c = _coefficients(k)
    u, v, jacobian, _ = _with_jacobian(x, y, c)
    denominator = 1 + r2 * (c[5] + r2 * (c[6] + r2 * c[7]))
    growth = [r2 / denominator, r2.square() / denominator, r2**3 / denominator]
    rows = [(x * g, y * g) for g in growth]
    rows[2:2] = [(2 * x * y, r2 + 2 * y * y), (r2 + 2 * x * x, 2 * x * y)]
    if k.shape[-1] > 5:
        radial = _radial(r2, c)
        rows += [(-x * radial * g, -y * radial * g) for g in growth]
    if k.shape[-1] > 8:
        zero = torch.zeros_like(r2)
        rows += [(r2, zero), (r2.square(), zero), (zero, r2), (zero, r2.square())]
    to_k = torch.stack([torch.stack(row, -1) for row in rows[: k.shape[-1]]], -1)
    return torch.stack([u, v], -1), torch.stack(jacobian, -1).unflatten(-1, (2, 2)), to_k


def undistorted(model: str, pixels: Tensor, camera: Tensor, k: Tensor) -> Tensor:
    """Points (B, M, 2) of the plane that cameras (fx, fy, cx, cy) (B, 4) with lenses (B, n) see at pixels."""
    if model == "kannala_brandt":
        plane: Tensor = undistort_points_kannala_brandt(pixels, torch.cat([camera, k], -1)[:, None])
        return plane
    K = camera_matrix_of(*camera.unbind(-1))
    return undistort_points(pixels, K, k, torch.eye(3, dtype=pixels.dtype, device=pixels.device))


def undistorted_equidistant(points: Tensor) -> Tensor:
    """Points of the plane whose angles are the radii of `points`; NaN from 90 degrees on."""
    return undistort_points_kannala_brandt(points, points.new_tensor([1.0, 1, 0, 0, 0, 0, 0, 0]))


def _with_unit_camera(k: Tensor) -> Tensor:
    one, zero = torch.ones_like(k[..., :2]), torch.zeros_like(k[..., :2])
    return torch.cat([one, zero, k], -1)[..., None, :]
