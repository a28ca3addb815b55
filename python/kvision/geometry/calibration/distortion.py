"""Lens distortion in OpenCV's model: radial, tangential, thin-prism and tilt distortion.

A point (x, y) of the plane z = 1 in front of the camera is mapped to

    (x, y) (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
    + (2 p1 x y + p2 (r^2 + 2 x^2) + s1 r^2 + s2 r^4,  p1 (r^2 + 2 y^2) + 2 p2 x y + s3 r^2 + s4 r^4),  r^2 = x^2 + y^2

and then projected to a sensor that is tilted by tx and ty. The order of the coefficients is k1, k2, p1, p2, k3, k4, k5,
k6, s1, s2, s3, s4, tx, ty; the first 4, 5, 8, 12 or all 14 of them may be given.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, overload

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype, pixels
from kvision._leading import broadcast_shapes
from kvision._modes import INTERPOLATION, PADDING
from kvision._ops import Operator, no_derivative, register
from kvision.core.exceptions import ShapeError
from kvision.geometry._formula import batch_of
from kvision.geometry._precision import in_full_precision
from kvision.geometry._validity import with_validity
from kvision.geometry.solvers.roots import first_root
from kvision.geometry.transform import sampling

__all__ = ["distort_points", "tilt_projection", "undistort_image", "undistort_points"]

_COUNTS = (4, 5, 8, 12, 14)


@in_full_precision
def tilt_projection(taux: Tensor, tauy: Tensor, return_inverse: bool = False) -> Tensor:
    """Compute the projections from a sensor's plane to that of a sensor tilted about x, then about y.

    Args:
        taux: angles about x in radians, (*) or (*, 1), floating point.
        tauy: angles about y, in the same shape.
        return_inverse: return the inverse projections.

    Returns:
        (*, 3, 3).

    Raises:
        TypeCheckError: `taux` or `tauy` is not a floating-point tensor; `return_inverse` is not a bool.
        ShapeError: `taux` and `tauy` have different shapes.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.tilt_projection(torch.zeros(1), torch.zeros(1))
        tensor([[1., 0., 0.],
                [0., 1., 0.],
                [0., 0., 1.]])
    """
    for name, x in (("taux", taux), ("tauy", tauy)):
        _check.floating_trailing_shape("tilt_projection", name, x)
    _check.same_shape("tilt_projection", taux=taux, tauy=tauy)
    _check.same_device("tilt_projection", taux=taux, tauy=tauy)
    _check.flag("tilt_projection", "return_inverse", return_inverse)
    if taux.dim() > 0 and taux.shape[-1] == 1:
        taux, tauy = taux[..., 0], tauy[..., 0]
    cx, sx, cy, sy = taux.cos(), taux.sin(), tauy.cos(), tauy.sin()
    zero, one = torch.zeros_like(cx), torch.ones_like(cx)
    R = [cy, sy * sx, -sy * cx, zero, cx, sx, sy, -cy * sx, cy * cx]
    rotation = torch.stack(R, -1).unflatten(-1, (3, 3))
    x, y, z = R[2], R[5], R[8]
    if return_inverse:
        return rotation.mT @ torch.stack([1 / z, zero, x / z, zero, 1 / z, y / z, zero, zero, one], -1).unflatten(
            -1, (3, 3)
        )
    return torch.stack([z, zero, -x, zero, z, -y, zero, zero, one], -1).unflatten(-1, (3, 3)) @ rotation


@overload
def distort_points(
    points: Tensor, K: Tensor, dist: Tensor, new_K: Tensor | None = None, return_valid: Literal[False] = False
) -> Tensor: ...
@overload
def distort_points(
    points: Tensor, K: Tensor, dist: Tensor, new_K: Tensor | None = None, return_valid: bool = False
) -> Tensor | tuple[Tensor, Tensor]: ...
@in_full_precision
def distort_points(
    points: Tensor, K: Tensor, dist: Tensor, new_K: Tensor | None = None, return_valid: bool = False
) -> Tensor | tuple[Tensor, Tensor]:
    """Apply lens distortion to the coordinates of points.

    Args:
        points: (*, N, 2) as (x, y) in pixels, floating point.
        K: camera matrices, (*, 3, 3).
        dist: k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tx, ty, of which 4, 5, 8, 12 or 14 are given, (*, n).
        new_K: camera matrices of `points`, (*, 3, 3); None for `K`, the camera matrices of the result.
        return_valid: also return which points are finite and within the radius to which the radial distortion grows. Beyond it
            a lens model shows the plane again.

    Returns:
        (*, N, 2) in pixels. With `return_valid` also a mask (*, N); pixels of other points have no gradient then.

    Raises:
        TypeCheckError: a tensor is not a floating-point tensor; `return_valid` is not a bool.
        ShapeError: `points` is not (*, N, 2); `K` or `new_K` is not (*, 3, 3); `dist` has a number of coefficients
            other than 4, 5, 8, 12 and 14.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([[10.0, 0, 5], [0, 10, 5], [0, 0, 1]])
        >>> K.geometry.distort_points(torch.tensor([[15.0, 5.0]]), camera, torch.tensor([0.1, 0, 0, 0]))
        tensor([[16.,  5.]])
    """
    _check_lens("distort_points", points, K, dist, new_K)
    _check.flag("distort_points", "return_valid", return_valid)
    new_K = K if new_K is None else new_K

    def through(points: Tensor, new_K: Tensor, K: Tensor, dist: Tensor) -> Tensor:
        tilt = tilt_projection(dist[..., 12:13], dist[..., 13:]) if dist.shape[-1] == 14 else None
        return _through_lens(_distort, points, new_K, K, dist, tilt)

    if not return_valid:
        return through(points, new_K, K, dist)
    x, y = _on_plane(points.detach(), new_K.detach())
    valid = x * x + y * y <= _limit(_coefficients(dist.detach()), first_root)
    return with_validity(through, points, valid, new_K, K, dist)


def _distorted(points: Tensor, new_K: Tensor, K: Tensor, dist: Tensor, tilt: Tensor | None) -> Tensor:
    c = _coefficients(dist)
    x, y = _on_plane(points, new_K)
    r2 = x * x + y * y
    dx, dy = _shift(x, y, r2, c)
    radial = _radial(r2, c)
    x, y = x * radial + dx, y * radial + dy
    if tilt is not None:
        x, y = _projected(x, y, tilt)
    return _in_pixels(x, y, K)


def _coefficients(dist: Tensor) -> tuple[Tensor, ...]:
    """The 14 coefficients, each (*, 1). Coefficients missing in `dist` are 0."""
    return torch.nn.functional.pad(dist, (0, 14 - dist.shape[-1])).split(1, -1)


def _radial(r2: Tensor, c: tuple[Tensor, ...]) -> Tensor:
    k1, k2, _, _, k3, k4, k5, k6 = c[:8]
    return (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))


def _shift(x: Tensor, y: Tensor, r2: Tensor, c: tuple[Tensor, ...]) -> tuple[Tensor, Tensor]:
    p1, p2, (s1, s2, s3, s4) = c[2], c[3], c[8:12]
    dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2)
    dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4)
    return dx, dy


def _on_plane(points: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
    x, y = points.unbind(-1)
    return (x - K[..., :1, 2]) / K[..., :1, 0], (y - K[..., 1:2, 2]) / K[..., 1:2, 1]


def _in_pixels(x: Tensor, y: Tensor, K: Tensor) -> Tensor:
    return torch.stack([K[..., :1, 0] * x + K[..., :1, 2], K[..., 1:2, 1] * y + K[..., 1:2, 2]], -1)


def _projected(x: Tensor, y: Tensor, matrix: Tensor) -> tuple[Tensor, Tensor]:
    """Project x and y (*, N) by matrices (*, 3, 3)."""
    m = [[matrix[..., i, k, None] for k in range(3)] for i in range(3)]
    u, v, w = (row[0] * x + row[1] * y + row[2] for row in m)
    return u / w, v / w


@in_full_precision
def undistort_points(
    points: Tensor, K: Tensor, dist: Tensor, new_K: Tensor | None = None, num_iters: int = 5
) -> Tensor:
    """Remove lens distortion from the coordinates of points.

    This inverts :func:`distort_points` by `num_iters` steps of a fixed-point iteration. Points that these leave more than a
    thousandth of a pixel off are solved by Newton's method, damped, within the radius to which the radial distortion grows.

    Args:
        points: (*, N, 2) as (x, y) in pixels, floating point.
        K: camera matrices, (*, 3, 3).
        dist: k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tx, ty, of which 4, 5, 8, 12 or 14 are given, (*, n).
        new_K: camera matrices of the result, (*, 3, 3); None for `K`, the camera matrices of `points`.
        num_iters: number of steps, at least 0; Newton's method tries as many, but at least 20.

    Returns:
        (*, N, 2) in pixels. NaN, without a gradient, where the lens shows no point at the pixel. Other gradients are those
        of the inverse, whatever the number of steps.

    Raises:
        TypeCheckError: a tensor is not a floating-point tensor; `num_iters` is not an int.
        ShapeError: `points` is not (*, N, 2); `K` or `new_K` is not (*, 3, 3); `dist` has a number of coefficients
            other than 4, 5, 8, 12 and 14.
        ValueCheckError: `num_iters` is below 0.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([[10.0, 0, 5], [0, 10, 5], [0, 0, 1]])
        >>> K.geometry.undistort_points(torch.tensor([[16.0, 5.0]]), camera, torch.tensor([0.1, 0, 0, 0]), num_iters=20)
        tensor([[15.,  5.]])
    """
    _check_lens("undistort_points", points, K, dist, new_K)
    _check.ints("undistort_points", "num_iters", num_iters, 1, minimum=0)
    new_K = K if new_K is None else new_K
    tilt = None
    if dist.shape[-1] == 14:
        tilt = tilt_projection(dist[..., 12:13], dist[..., 13:], True)
    return _through_lens(_undistort, points, K, new_K, dist, tilt, num_iters)


def _through_lens(
    operator: Operator,
    points: Tensor,
    camera: Tensor,
    new_camera: Tensor,
    dist: Tensor,
    tilt: Tensor | None,
    *options: int,
) -> Tensor:
    """Call an operator on points (B, N, 2) and lenses (B or 1, ...) with inputs of any leading axes."""
    leading: Sequence[int] = points.shape[:-2]
    if not camera.dim() == new_camera.dim() == dist.dim() + 1 == 2:
        leading = broadcast_shapes(leading, camera.shape[:-2], new_camera.shape[:-2], dist.shape[:-1])

    def of_problems(x: Tensor, axes: int) -> Tensor:
        x = as_dtype(x, points.dtype)
        if x.dim() == axes:
            return x[None]
        return x if x.shape[:-axes] == leading and len(leading) == 1 else _of_all(x, leading, axes)

    if len(leading) == 1 and points.shape[:-2] == leading:
        flat = points
    else:
        flat = points[None] if not leading else _of_all(points, leading, 2)
    tilts = None if tilt is None else of_problems(tilt, 2)
    cameras = of_problems(camera, 2), of_problems(new_camera, 2)
    result: Tensor = operator(flat, *cameras, of_problems(dist, 1), tilts, *options)
    if len(leading) == 1:
        return result
    return result[0] if not leading else result.reshape(*leading, *points.shape[-2:])


def _of_all(x: Tensor, leading: Sequence[int], axes: int) -> Tensor:
    """Broadcast all axes before the last `axes` to `leading` and flatten them: (B, ...)."""
    trailing = x.shape[-axes:]
    return x.expand(*leading, *trailing).reshape(math.prod(leading), *trailing)


# --- the inverse -----------------------------------------------------------------------------------------------------

_TRIALS = 20  # of Newton's method, unless more steps are asked for


def _undistorted(points: Tensor, K: Tensor, new_K: Tensor, dist: Tensor, tilt: Tensor | None, num_iters: int) -> Tensor:
    args = points.detach(), K.detach(), dist.detach(), None if tilt is None else tilt.detach()
    x, y = _solved(*args, num_iters)
    result = _in_pixels(x, y, new_K.detach())
    derivative = _implicit(result, points, K, new_K, dist, tilt)
    return result + (derivative - derivative.detach())


def _solved(points: Tensor, K: Tensor, dist: Tensor, tilt: Tensor | None, num_iters: int) -> tuple[Tensor, Tensor]:
    """Points of the plane; NaN where the lens shows none at the pixel. As Lens::undistort of csrc computes them."""
    c = _coefficients(dist)
    x0, y0 = _untilted(points, K, tilt)
    path, radial = [(x0, y0)] * 3, torch.ones_like(x0)
    for _ in range(num_iters):
        x, y = path[-1]
        r2 = x * x + y * y
        dx, dy = _shift(x, y, r2, c)
        radial = _radial(r2, c)
        path = [*path[-2:], ((x0 - dx) / radial, (y0 - dy) / radial)]
    x, y = path[-1]
    before, step = ((p[0] - q[0]).square() + (p[1] - q[1]).square() for p, q in zip(path[-3:], path[-2:]))
    eps = torch.finfo(x0.dtype).eps
    focal = torch.maximum(K[..., :1, 0].abs(), K[..., 1:2, 1].abs())
    size = x0 * x0 + y0 * y0
    tolerance = (1e-3 / focal).clamp(max=1e-6)
    enough = torch.maximum(tolerance.square(), 4 * eps * eps * size)
    limit = _limit(c)
    # The last step is the residual before it. What is left is estimated by how much shorter it was than the one before,
    # or at most eight times as much.
    scale = radial.square()
    settled = step * scale <= torch.maximum(tolerance.square() / 64, 4 * eps * eps * (4 * size).clamp(min=1))
    settled = settled | ((step <= before) & (4 * step.square() * scale <= before * enough))
    settled = settled & (x * x + y * y <= limit)
    if num_iters < 2:
        settled = torch.zeros_like(settled)
    solved, error = _newton(x, y, x0, y0, c, enough, limit, max(num_iters, _TRIALS))
    is_solved = ((error <= enough) | (error <= 1024 * eps * eps * size)) & size.isfinite()
    x, y = (torch.where(settled, a, torch.where(is_solved, b, torch.nan)) for a, b in zip((x, y), solved))
    return x, y


def _newton(
    x: Tensor, y: Tensor, x0: Tensor, y0: Tensor, c: tuple[Tensor, ...], enough: Tensor, limit: Tensor, trials: int
) -> tuple[tuple[Tensor, Tensor], Tensor]:
    """Newton's method from (x, y) or the center for the point that is distorted to (x0, y0), and its squared residual."""
    step, error = (x, y), x0 * x0 + y0 * y0
    x, y = torch.zeros_like(x), torch.zeros_like(y)
    for trial in range(trials):
        at_x, at_y = x + step[0], y + step[1]
        u, v, jacobian, is_regular = _with_jacobian(at_x, at_y, c)
        u, v = u - x0, v - y0
        residual = u * u + v * v
        better = (error > enough) & (residual < error) & (at_x * at_x + at_y * at_y <= limit) & is_regular
        halved = (x0, y0) if trial == 0 else (step[0] / 2, step[1] / 2)
        x, y, error = (torch.where(better, a, b) for a, b in ((at_x, x), (at_y, y), (residual, error)))
        next_x, next_y = _solve2x2(jacobian, u, v)
        step = torch.where(better, -next_x, halved[0]), torch.where(better, -next_y, halved[1])
    return (x, y), error


def _with_jacobian(
    x: Tensor, y: Tensor, c: tuple[Tensor, ...]
) -> tuple[Tensor, Tensor, tuple[Tensor, Tensor, Tensor, Tensor], Tensor]:
    """The distorted point, its derivatives (x by x, x by y, y by x, y by y), and whether they keep the orientation."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = c[:12]
    r2 = x * x + y * y
    numerator = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    denominator = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = numerator / denominator
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * k3 * r2) - radial * (k4 + r2 * (2 * k5 + 3 * k6 * r2))) / denominator
    dx, dy = _shift(x, y, r2, c)
    u, v = 2 * (s1 + 2 * s2 * r2), 2 * (s3 + 2 * s4 * r2)
    mixed = slope * x * y + 2 * (p1 * x + p2 * y)
    jacobian = (
        radial + slope * x * x + 2 * p1 * y + 6 * p2 * x + u * x,
        mixed + u * y,
        mixed + v * x,
        radial + slope * y * y + 6 * p1 * y + 2 * p2 * x + v * y,
    )
    determinant = jacobian[0] * jacobian[3] - jacobian[1] * jacobian[2]
    return x * radial + dx, y * radial + dy, jacobian, (numerator > 0) & (denominator > 0) & (determinant > 0)


def _solve2x2(m: tuple[Tensor, Tensor, Tensor, Tensor], u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    determinant = m[0] * m[3] - m[1] * m[2]
    return (m[3] * u - m[1] * v) / determinant, (m[0] * v - m[2] * u) / determinant


def _limit(c: tuple[Tensor, ...], first_root: Callable[[Tensor], Tensor] = first_root.reference) -> Tensor:
    """The squared radius (*, 1) to which the radial distortion grows and its denominator is positive: Domain of csrc."""
    one = torch.ones_like(c[0])
    numerator, denominator = (one, c[0], c[1], c[4]), (one, c[5], c[6], c[7])
    growth = [torch.zeros_like(one) for _ in range(7)]
    for i, a in enumerate(numerator):
        for k, b in enumerate(denominator):
            growth[i + k] = growth[i + k] + (1 + 2 * i - 2 * k) * a * b
    roots = (first_root(torch.cat(p, -1).reshape(-1, len(p))) for p in (growth, denominator))
    return torch.minimum(*roots).reshape(one.shape)


def _untilted(points: Tensor, K: Tensor, tilt: Tensor | None) -> tuple[Tensor, Tensor]:
    x, y = _on_plane(points, K)
    return (x, y) if tilt is None else _projected(x, y, tilt)


def _implicit(result: Tensor, points: Tensor, K: Tensor, new_K: Tensor, dist: Tensor, tilt: Tensor | None) -> Tensor:
    """`result` as a function of the rest, with its first and second derivatives: two Newton steps, which change little.

    0 where it is NaN.
    """
    valid = result.detach().isfinite().all(-1)
    x, y = (torch.where(valid, p, 0) for p in _on_plane(result.detach(), new_K.detach()))
    points = torch.where(valid[..., None], points, 0)
    x0, y0 = (torch.where(valid, p, 0) for p in _untilted(points, K, tilt))
    for _ in range(2):
        u, v, jacobian, _ = _with_jacobian(x, y, _coefficients(dist))
        dx, dy = _solve2x2(jacobian, u - x0, v - y0)
        x, y = x - dx, y - dy
    return torch.where(valid[..., None], _in_pixels(x, y, new_K), 0)


def _undistort_backward(needs: Sequence[bool], grad: Tensor, result: Tensor, *args: Any) -> list[Tensor | None]:
    lens = args[:5]
    where = [i for i, need in enumerate(needs) if need]

    def of_tensors(*tensors: Tensor) -> Tensor:
        values = dict(zip(where, tensors))
        return _implicit(result, *(values.get(i, x) for i, x in enumerate(lens)))

    grads = iter(torch.func.vjp(of_tensors, *(lens[i] for i in where))[1](grad))
    return [next(grads) if need else None for need in needs]


def _map_reference(camera: Tensor, coefficients: Tensor, tilt: Tensor | None, size: list[int]) -> Tensor:
    h, w = size
    y, x = (torch.arange(n, device=camera.device, dtype=camera.dtype) for n in size)
    pixels = torch.stack([x.repeat(h), y.repeat_interleave(w)], -1)
    distorted = _distorted(pixels, camera, camera, coefficients, tilt)
    limit = _limit(_coefficients(coefficients.detach()))
    x, y = _on_plane(pixels, camera.detach())
    return torch.where((x * x + y * y <= limit)[..., None], distorted, torch.nan).mT.unflatten(-1, (h, w))


def _map_gradient_reference(grad: Tensor, *lens: Tensor | None) -> tuple[Tensor, ...]:
    args = [x.expand(grad.shape[0], *x.shape[1:]) for x in lens if x is not None]

    def of_lens(camera: Tensor, coefficients: Tensor, tilt: Tensor | None = None) -> Tensor:
        return _map_reference(camera, coefficients, tilt, list(grad.shape[2:]))

    grads = torch.func.vjp(of_lens, *args)[1](grad)
    return grads if len(grads) == 3 else (*grads, grad.new_empty(grad.shape[0], 0, 3))


_undistort = register("undistort_points", _undistorted, backward=_undistort_backward, saves_results=True)
_distort = register("distort_points", _distorted, supports=no_derivative)
# The distorted coordinates x and y of all pixels of an image: (B, 2, H, W).
_map = register(
    "undistort_map",
    _map_reference,
    fake=lambda camera, coefficients, tilt, size: (batch_of(camera, coefficients, tilt), 2, *size),
    gradients="camera, coefficients, tilt: undistort_map_backward",
)
_map_gradient = register(
    "undistort_map_backward",
    _map_gradient_reference,
    fake=lambda grad, camera, coefficients, tilt: [
        (grad.shape[0], 3, 3),
        (grad.shape[0], coefficients.shape[1]),
        (grad.shape[0], 0 if tilt is None else 3, 3),
    ],
)


def undistort_image(image: Tensor, K: Tensor, dist: Tensor) -> Tensor:
    """Remove lens distortion from images.

    Args:
        image: (*, C, H, W), floating point or uint8, which gives uint8. Other integers are computed in float32.
        K: camera matrices, (*, 3, 3).
        dist: coefficients in the order of :func:`distort_points`, (*, n) with n one of 4, 5, 8, 12 and 14. One image
            (1, C, H, W) may come with (3, 3) and (n,).

    Returns:
        (*, C, H, W), interpolated bilinearly; 0 where the sampling coordinates are out of the image, and beyond the radius
        to which the radial distortion grows, where a lens model would repeat the image.

    Raises:
        TypeCheckError: `image` is not a real tensor, `K` or `dist` not a floating-point tensor.
        ShapeError: `image` is not (*, C, H, W); `K` is not (*, 3, 3); the leading axes differ; `dist` has a number of
            coefficients other than 4, 5, 8, 12 and 14.
        DeviceError: a tensor on another device; K and dist in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([[[10.0, 0, 2], [0, 10, 2], [0, 0, 1]]])
        >>> K.geometry.undistort_image(torch.ones(1, 3, 5, 5), camera, torch.zeros(1, 4)).mean()
        tensor(1.)
    """
    op = "undistort_image"
    _check.trailing_shape(op, "image", image, "C", "H", "W")
    if 0 in image.shape[-2:]:
        raise ShapeError(f"{op}: expected image with H, W of at least 1, got {tuple(image.shape)}")
    _check.floating_trailing_shape(op, "K", K, 3, 3)
    _check_coefficients(op, dist)
    image = pixels(image)
    K, dist = (_check.to_device_of(op, image, name, x, of="image") for name, x in (("K", K), ("dist", dist)))
    leading, (h, w) = image.shape[:-3], image.shape[-2:]
    one_for_all = leading == (1,) and K.dim() == 2 and dist.dim() == 1
    if not one_for_all and not leading == K.shape[:-2] == dist.shape[:-1]:
        raise ShapeError(
            f"{op}: expected image, K and dist with the same leading axes, got {tuple(image.shape)}, {tuple(K.shape)} "
            f"and {tuple(dist.shape)}"
        )
    flat = image
    if len(leading) != 1:
        flat, dist = image.reshape(-1, *image.shape[-3:]), dist.reshape(-1, dist.shape[-1])
        K = K.reshape(-1, 3, 3)
    elif one_for_all:
        K, dist = K[None], dist[None]
    dtype = compute_dtype(image)
    K, dist = as_dtype(K, dtype), as_dtype(dist, dtype)
    tilt = tilt_projection(dist[:, 12:13], dist[:, 13:]) if dist.shape[-1] == 14 else None
    x, y = _map(K, dist, tilt, [h, w]).unbind(1)
    options = (INTERPOLATION["bilinear"], PADDING["fill"], True, False, False)
    result: Tensor = sampling.remap(flat, x, y, None, None, *options)
    return result if result.shape == image.shape else result.reshape(image.shape)


def _check_lens(op: str, points: Tensor, K: Tensor, dist: Tensor, new_K: Tensor | None) -> None:
    _check.floating_trailing_shape(op, "points", points, "N", 2)
    _check.floating_trailing_shape(op, "K", K, 3, 3)
    _check_coefficients(op, dist)
    _check.same_device(op, points=points, K=K, dist=dist)
    leading = {"points": points.shape[:-2], "K": K.shape[:-2], "dist": dist.shape[:-1]}
    if new_K is not None:
        _check.floating_trailing_shape(op, "new_K", new_K, 3, 3)
        _check.same_device(op, points=points, new_K=new_K)
        leading["new_K"] = new_K.shape[:-2]
    _check.broadcastable(op, **leading)


def _check_coefficients(op: str, dist: Tensor) -> None:
    _check.floating_trailing_shape(op, "dist", dist, "n")
    if dist.shape[-1] not in _COUNTS:
        listed = ", ".join(map(str, _COUNTS))
        raise ShapeError(
            f"{op}: expected dist of shape (*, n) with n one of {listed}, got {tuple(dist.shape)}",
            actual_shape=dist.shape,
        )
