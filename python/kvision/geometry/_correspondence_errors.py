"""Errors of correspondences under a fundamental matrix or a homography. One operator computes all kinds of error."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import promoted
from kvision._leading import broadcast_shapes
from kvision._modes import CORRESPONDENCE_ERROR, CORRESPONDENCE_ERROR_NAMES
from kvision._ops import register
from kvision.core.exceptions import ShapeError
from kvision.geometry._precision import length, quotient
from kvision.geometry.linalg import adjugate, root


def correspondence_errors(points1: Tensor, points2: Tensor, matrix: Tensor, kind: str, squared: bool) -> Tensor:
    """Errors (*, N) of points (*, N, D), or segments (*, N, 2, 2) of kind "segments", by matrices (*, 3, 3).

    "sampson", "symmetrical", "right" and "left": of fundamental matrices, in both images, or from the line in one.
    "transfer", "symmetric_transfer", "sampson_transfer" and "segments": of homographies.
    """
    if kind == "segments":
        points1, points2 = points1.flatten(-2), points2.flatten(-2)
    tensors = points1, points2, matrix
    leading = broadcast_shapes(*(x.shape[:-2] for x in tensors))
    points1, points2, matrix = (_one_batch(x, leading) for x in tensors)
    if points1.shape[1] != points2.shape[1]:
        count = max(points1.shape[1], points2.shape[1])
        points1, points2 = (x.expand(-1, count, -1) for x in (points1, points2))
    errors: Tensor = _correspondence_errors(points1, points2, matrix, CORRESPONDENCE_ERROR[kind], squared)
    return errors if len(leading) == 1 and errors.shape[0] == leading[0] else errors.reshape(*leading, errors.shape[1])


def check_correspondence_shapes(op: str, **tensors: Tensor) -> None:
    """Raise ShapeError unless points (*, N, n) of both images and matrices (*, 3, 3), named in this order, fit together."""
    _check.leading_axes(op, 2, **tensors)
    (first, points1), (second, points2), _ = tensors.items()
    counts = points1.shape[-2], points2.shape[-2]
    if counts[0] != counts[1] and 1 not in counts:
        raise ShapeError(f"{op}: expected as many {first} as {second}, or one, got {counts[0]} and {counts[1]}")


def _one_batch(x: Tensor, leading: Sequence[int]) -> Tensor:
    """Flatten the leading axes of x to (B, ., .) of the common leading shape; B is 1 where one sample broadcasts."""
    if x.dim() == 3 and len(leading) == 1:
        return x
    if math.prod(x.shape[:-2]) != 1:
        x = x.expand(*leading, *x.shape[-2:])
    return x.reshape(-1, *x.shape[-2:])


def _reference(points1: Tensor, points2: Tensor, matrix: Tensor, number: int, squared: bool) -> Tensor:
    kind = CORRESPONDENCE_ERROR_NAMES[number]
    x, y, m = promoted(points1), promoted(points2), promoted(matrix)
    if kind in ("sampson", "symmetrical", "right", "left"):
        error = _epipolar(x, y, m, kind)
        errors = error if squared or kind in ("right", "left") else root(error)
    elif kind == "segments":
        error = _segment_errors(x, y, m)
        errors = error.square() if squared else error
    else:
        first, second = (p if p.shape[-1] == 2 else quotient(p[..., :2], p[..., 2:], torch.inf) for p in (x, y))
        if kind == "transfer":
            errors = _transfer(first, second, m)
            errors = errors if squared else root(errors)
        elif kind == "sampson_transfer":
            errors = _sampson_transfer(first, second, m)
            errors = errors if squared else root(errors)
        else:
            errors = _symmetric_transfer(first, second, m, squared, matrix.dtype)
    return errors.to(points1.dtype)


def _multiply(F: Tensor, points: Tensor) -> tuple[Tensor, ...]:
    """The coordinates of F x for points x (*, N, 2 or 3)."""
    if points.shape[-1] == 3:
        return (F @ points.mT).unbind(-2)
    return (F[..., :2] @ points.mT + F[..., 2:]).unbind(-2)


def _epipolar(x: Tensor, y: Tensor, F: Tensor, kind: str) -> Tensor:
    """The error from a^2 + b^2 of the epipolar lines in the second and the first image and the residual y^T F x."""
    right, left = _multiply(F, x), _multiply(F.mT, y)
    residual = right[0] * y[..., 0] + right[1] * y[..., 1] + (right[2] if y.shape[-1] == 2 else right[2] * y[..., 2])
    second, first = right[0].square() + right[1].square(), left[0].square() + left[1].square()
    square = residual.square()
    if kind == "sampson":
        return quotient(square, second + first, torch.inf)
    if kind == "symmetrical":
        return quotient(square, second, torch.inf) + quotient(square, first, torch.inf)
    return quotient(residual.abs(), root(second if kind == "right" else first), torch.inf)


def _transfer(first: Tensor, second: Tensor, H: Tensor) -> Tensor:
    u, v, w = _multiply(H, first)
    finite = torch.where(w == 0, 1, w)
    x, y = second.unbind(-1)
    return torch.where(w == 0, torch.inf, (u / finite - x).square() + (v / finite - y).square())


def _sampson_transfer(first: Tensor, second: Tensor, H: Tensor) -> Tensor:
    """The Sampson error r^T (J J^T)^-1 r of r = (v w - q, p - u w), (p, q, w) = H (x, y, 1), J = dr / d(x, y, u, v)."""
    largest = H.detach().abs().amax((-2, -1), keepdim=True)
    h = H / torch.where(largest > 0, largest, 1)
    p, q, w = _multiply(h, first)
    u, v = second.unbind(-1)
    r, s = v * w - q, p - u * w
    # The derivatives of r and s by (x, y). Those by (u, v) are (0, w) and (-w, 0).
    rows = h[..., :, None, :2]
    r_xy = v[..., None] * rows[..., 2, :, :] - rows[..., 1, :, :]
    s_xy = rows[..., 0, :, :] - u[..., None] * rows[..., 2, :, :]
    a, c, b = r_xy.square().sum(-1) + w * w, s_xy.square().sum(-1) + w * w, (r_xy * s_xy).sum(-1)
    volume = (a * c - b * b).clamp(min=0)
    return quotient(c * r * r - 2 * b * r * s + a * s * s, volume, torch.inf).clamp(min=0)


def _symmetric_transfer(first: Tensor, second: Tensor, H: Tensor, squared: bool, dtype: torch.dtype) -> Tensor:
    inverse = adjugate(H)  # up to a factor, which does not change the error
    volume = (H[..., 0, :] * inverse[..., :, 0]).sum(-1).detach()  # the determinant
    sides = torch.linalg.vector_norm(H.detach(), dim=-1).prod(-1)
    singular = ~(volume.abs() > torch.finfo(dtype).eps * sides)[..., None, None]
    eye = torch.eye(3, device=H.device, dtype=H.dtype)
    forward = _transfer(first, second, torch.where(singular, eye, H))
    backward = _transfer(second, first, torch.where(singular, eye, inverse))
    error = forward + backward if squared else root(forward + backward)
    return torch.where(singular[..., 0], torch.finfo(dtype).max, error)


def _segment_errors(x: Tensor, y: Tensor, H: Tensor) -> Tensor:
    """The mean distance of the mapped endpoints of segments x (B, N, 4) from the lines through segments y."""
    start, end = y[..., :2], y[..., 2:]
    along = end - start
    has_length = length(along.detach(), keepdim=True) > 0
    normal = torch.stack([-along[..., 1], along[..., 0]], -1)
    normal = torch.where(has_length, normal / torch.where(has_length, length(along, keepdim=True), 1), 0)
    error = torch.zeros_like(x[..., 0] + H[..., :1, 0])
    for p in (x[..., :2], x[..., 2:]):
        u, v, w = _multiply(H, p)
        is_finite = w != 0
        divisor = torch.where(is_finite, w, 1)
        offset = normal[..., 0] * (u / divisor - start[..., 0]) + normal[..., 1] * (v / divisor - start[..., 1])
        error = error + torch.where(is_finite, offset.abs(), torch.inf) / 2
    return torch.where(has_length[..., 0], error, 0)


def _backward_reference(
    grad: Tensor, points1: Tensor, points2: Tensor, matrix: Tensor, kind: int, squared: bool
) -> tuple[Tensor, ...]:
    each = [x.expand(grad.shape[0], -1, -1) for x in (points1, points2, matrix)]
    return torch.func.vjp(lambda x, y, m: _reference(x, y, m, kind, squared), *each)[1](grad)


# Takes points (B, N, 2 or 3) or segments (B, N, 4), and matrices (B, 3, 3). A batch of 1 broadcasts.
_correspondence_errors = register(
    "correspondence_errors",
    _reference,
    fake=lambda *tensors: (next((x.shape[0] for x in tensors[:3] if x.shape[0] != 1), 1), tensors[0].shape[1]),
    gradients="points1, points2, matrix: correspondence_errors_backward",
)
register(
    "correspondence_errors_backward",
    _backward_reference,
    fake=lambda grad, *tensors: [(grad.shape[0], *x.shape[1:]) for x in tensors[:3]],
)
