"""Corners of boards and saddle points, between pixels."""

from __future__ import annotations

from typing import Literal, overload

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype
from kvision._modes import INTERPOLATION, PADDING
from kvision._ops import wants_derivative
from kvision.geometry._precision import in_full_precision
from kvision.geometry.transform import sampling

__all__ = ["refine_corners"]


@overload
def refine_corners(
    image: Tensor,
    corners: Tensor,
    radius: int = 5,
    max_iterations: int = 30,
    eps: float = 1e-3,
    return_valid: Literal[False] = False,
) -> Tensor: ...
@overload
def refine_corners(
    image: Tensor,
    corners: Tensor,
    radius: int = 5,
    max_iterations: int = 30,
    eps: float = 1e-3,
    return_valid: bool = False,
) -> Tensor | tuple[Tensor, Tensor]: ...
@in_full_precision
def refine_corners(
    image: Tensor,
    corners: Tensor,
    radius: int = 5,
    max_iterations: int = 30,
    eps: float = 1e-3,
    return_valid: bool = False,
) -> Tensor | tuple[Tensor, Tensor]:
    """Move corners of chessboards, and other saddle points, to where the gradients around them are orthogonal to the way there.

    These are the steps of OpenCV's `cornerSubPix` without a dead zone, for batches. Gradients reach the image by the implicit
    function theorem; the result does not depend on where the corners start.

    Args:
        image: gray images (B, 1, H, W), floating point or bytes.
        corners: (B, N, 2) as (x, y) in pixels, floating point, within a few pixels of where they belong.
        radius: of the window, whose side has 2 radius + 1 pixels; those near its center weigh more.
        max_iterations: of steps; on the CPU they end when all corners have converged.
        eps: the length of a step, in pixels, at which a corner has converged.
        return_valid: also return which corners were found.

    Returns:
        (B, N, 2). Corners that leave the image or their window, or whose window has no corner, stay where they start, without a
        gradient. With `return_valid` also a mask (B, N).

    Raises:
        TypeError: a tensor is of another type, or a number is not as in Args.
        ValueError: a shape is not as in Args, a number is out of range, or the tensors are on different devices.

    Source: W. Foerstner, E. Guelch, "A fast operator for detection and precise location of distinct points, corners and centres
    of circular features" (1987).

    Example:
        >>> import torch, kvision as K
        >>> image = torch.zeros(1, 1, 16, 16)
        >>> image[..., :8, :8] = image[..., 8:, 8:] = 1
        >>> K.geometry.refine_corners(image, torch.tensor([[[6.0, 9.0]]]), radius=4).round(decimals=2)
        tensor([[[7.5000, 7.5000]]])
    """
    op = "refine_corners"
    _check.images(op, "image", image)
    _check.channels(op, "image", image, 1)
    _check.floating_trailing_shape(op, "corners", corners, "B", "N", 2)
    _check.shape(op, "corners", corners, image.shape[0], "N", 2)
    _check.same_device(op, image=image, corners=corners)
    _check.ints(op, "radius", radius, 1)
    _check.ints(op, "max_iterations", max_iterations, 1, minimum=0)
    eps = _check.number(op, "eps", eps, 0)
    _check.flag(op, "return_valid", return_valid)
    values = as_dtype(image, compute_dtype(image))
    start = as_dtype(corners.detach(), values.dtype)
    height, width = image.shape[-2:]
    with torch.no_grad():
        x, valid = start, torch.ones_like(start[..., 0], dtype=torch.bool)
        done = torch.zeros_like(valid)
        for _ in range(max_iterations):
            step = _step(values, x, radius)
            moved = x + step
            is_good = ((moved >= 0) & torch.stack([moved[..., 0] < width, moved[..., 1] < height], -1)).all(-1)
            valid = valid & (is_good | done)
            x = torch.where((is_good & ~done)[..., None], moved, x)
            done = done | ~is_good | (step.square().sum(-1) <= eps * eps)
            if _check.values_are_readable(done) and bool(done.all()):
                break
        valid = valid & ((x - start).abs() <= radius).all(-1) & start.isfinite().all(-1)
        found = torch.where(valid[..., None], x, start)
    result = found
    if wants_derivative(values):
        at = torch.where(valid[..., None], found, 0)
        # x + step(x) is nearly constant around the corner: `change` is how it still depends on x.
        with torch.no_grad():
            along = [torch.zeros_like(at) + axis for axis in torch.eye(2, dtype=at.dtype, device=at.device)]
            slopes = [torch.func.jvp(lambda x: _step(values.detach(), x, radius), (at,), (d,))[1] for d in along]
            change = -torch.stack(slopes, -1)
            valid_change = valid & (torch.linalg.det(change).abs() > 1e-6)
        change = torch.where(valid_change[..., None, None], change, torch.eye(2, dtype=at.dtype, device=at.device))
        step = torch.linalg.solve_ex(change, _step(values, at, radius)[..., None]).result[..., 0]
        result = found + torch.where(valid_change[..., None], step - step.detach(), 0)
    result = as_dtype(result, corners.dtype)
    return (result, valid) if return_valid else result


def _step(image: Tensor, corners: Tensor, radius: int) -> Tensor:
    """The way (B, N, 2) from corners to the points to which the gradients around them are orthogonal; not finite without one."""
    batch, count = corners.shape[:2]
    side = 2 * radius + 3
    offset = torch.arange(-radius - 1, radius + 2, dtype=corners.dtype, device=corners.device)
    x, y = corners[..., 0, None, None] + offset, corners[..., 1, None, None] + offset[:, None]
    maps = (c.expand(batch, count, side, side).reshape(batch, count * side, side) for c in (x, y))
    options = (INTERPOLATION["bilinear"], PADDING["border"], False, False, False)
    patch = sampling.remap(image, *maps, None, None, *options).reshape(batch, count, side, side)
    gx = patch[..., 1:-1, 2:] - patch[..., 1:-1, :-2]
    gy = patch[..., 2:, 1:-1] - patch[..., :-2, 1:-1]
    inner = offset[1:-1]
    weight = (-(inner / radius).square()).exp()
    weight = weight * weight[:, None]
    xx, xy, yy = gx * gx * weight, gx * gy * weight, gy * gy * weight
    to_x, to_y = xx * inner + xy * inner[:, None], xy * inner + yy * inner[:, None]
    a, b, c, u, v = (m.sum((-1, -2)) for m in (xx, xy, yy, to_x, to_y))
    determinant = a * c - b * b
    # An edge or nothing at all, up to rounding.
    is_corner = determinant > 16 * torch.finfo(a.dtype).eps * (a + c).square()
    step = torch.stack([c * u - b * v, a * v - b * u], -1) / torch.where(is_corner, determinant, 1)[..., None]
    return torch.where(is_corner[..., None], step, torch.nan)
