"""Lens models of calibration, with derivatives in closed form.

A lens maps points (B, M, 3) in the coordinates of the camera to points (B, M, 2) of an image of focal length 1, given
coefficients (B, n).
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import torch
from torch import Tensor

from kvision.geometry._intrinsics import camera_matrix_of
from kvision.geometry.calibration.distortion import _coefficients, _radial, _shift, _with_jacobian, undistort_points
from kvision.geometry.camera.distortion import undistort_points_kannala_brandt
from kvision.geometry.conversions.series import angle_per_sine, angle_per_tangent_with_derivatives, squared

LensModel: TypeAlias = Literal["brown_conrady", "kannala_brandt"]
COUNTS: dict[LensModel, tuple[int, ...]] = {"brown_conrady": (4, 5, 8, 12), "kannala_brandt": (4,)}


def projected(model: str, p: Tensor, k: Tensor) -> Tensor:
    """Where lenses take points (B, M, 3) in front of the camera, (B, M, 2); those of Kannala and Brandt also points behind it."""
    if model == "kannala_brandt":
        per_radius, powers = _angles(p)
        return p[..., :2] * per_radius * (1 + (powers * k[:, None]).sum(-1, keepdim=True))
    x, y = (p[..., :2] / p[..., 2:]).unbind(-1)
    c = _coefficients(k)
    r2 = x * x + y * y
    radial, (dx, dy) = _radial(r2, c), _shift(x, y, r2, c)
    return torch.stack([x * radial + dx, y * radial + dy], -1)


def _angles(p: Tensor) -> tuple[Tensor, Tensor]:
    """Angles of points (B, M, 3) from the axis, divided by their distance from it, (B, M, 1), and powers (B, M, 4) 2 to 8."""
    square = squared(p[..., :2])
    per_radius = angle_per_sine(square, p[..., 2:])
    angle2 = per_radius.square() * square
    return per_radius, angle2 ** torch.arange(1, 5, device=p.device)


def projected_with_jacobians(model: str, p: Tensor, k: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """`projected`, and its derivatives with respect to the points (B, M, 2, 3) and the coefficients (B, M, 2, n)."""
    if model == "kannala_brandt":
        return _fisheye_with_jacobians(p, k)
    z = p[..., 2:]
    x = p[..., :2] / z
    image, to_x, to_k = _distorted_with_jacobians(x, k)
    return image, torch.cat([to_x, -(to_x @ x[..., None])], -1) / z[..., None], to_k


def _fisheye_with_jacobians(p: Tensor, k: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The image is s (x, y), s = f(a) / r, of the angle a = atan2(r, z) at the distance r from the axis."""
    x, z = p[..., :2], p[..., 2:]
    per_radius, powers = _angles(p)
    k, odd = k[:, None], torch.arange(3, 10, 2, dtype=p.dtype, device=p.device)
    square, cosine = squared(x), z / squared(p)
    s, slope = per_radius * (1 + (powers * k).sum(-1, keepdim=True)), 1 + (odd * powers * k).sum(-1, keepdim=True)
    # The derivative of s by x is x ((z / (r^2 + z^2) - a / r) / r^2 + ...), of which near the axis little would be left.
    is_near = (z > 0) & (square < z.square())
    depth = torch.where(is_near, z, 1)
    series = 2 * angle_per_tangent_with_derivatives(torch.where(is_near, square, 0) / depth.square())[1] / depth**3
    far = (cosine - per_radius) / torch.where(is_near, 1, square).clamp(min=torch.finfo(p.dtype).tiny)
    first = torch.where(is_near, series, far)
    lower = torch.cat([torch.ones_like(s), powers[..., :3]], -1)
    rest = per_radius.square() * (lower * k * (odd * cosine - per_radius)).sum(-1, keepdim=True)
    to_x = torch.diag_embed(s.expand_as(x)) + (x * (first + rest))[..., None] * x[..., None, :]
    to_z = -x * slope / squared(p)
    return s * x, torch.cat([to_x, to_z[..., None]], -1), x[..., None] * (per_radius * powers)[..., None, :]


def _distorted_with_jacobians(points: Tensor, k: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Brown and Conrady's lens of points (B, M, 2) of the plane, and derivatives (B, M, 2, 2) and (B, M, 2, n)."""
    x, y = points.unbind(-1)
    r2 = x * x + y * y
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


def rays(model: str, pixels: Tensor, camera: Tensor, k: Tensor) -> Tensor:
    """Unit vectors (B, M, 3) to what cameras (fx, fy, cx, cy) (B, 4) with lenses (B, n) see at pixels (B, M, 2)."""
    if model == "kannala_brandt":
        seen: Tensor = undistort_points_kannala_brandt(pixels, torch.cat([camera, k], -1)[:, None], return_rays=True)
        return seen
    plane = undistort_points(
        pixels, camera_matrix_of(*camera.unbind(-1)), k, torch.eye(3, dtype=pixels.dtype, device=pixels.device)
    )
    return torch.nn.functional.normalize(torch.nn.functional.pad(plane, (0, 1), value=1.0), dim=-1)
