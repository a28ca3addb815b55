"""Antialiased warps: a pixel of the result is the weighted mean of the pixels that it covers.

The weights are triangles along two axes of the image, as wide as the pixel of the result is there, and at least as wide as those of
bilinear sampling: csrc/geometry/transform/antialiased/warp_antialiased.h has them as formulas, docs/conventions.md in words. The
arguments of the operators are those of `warp` and `remap` without an interpolation, and samples may outnumber the images as there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._clamp import clamp
from kvision._limits import MAX_REACH, MAX_SHRINK, MAX_SLOPE
from kvision._modes import PADDING_NAMES
from kvision._ops import on_cuda, register
from kvision._torch_compat import without_transforms
from kvision.core.exceptions import ValueCheckError
from kvision.geometry.transform import sampling
from kvision.geometry.transform.sampling import _batch_size, _fake_image_backward, _flatten_samples, _grad_fill, _ones

# --- the definition -------------------------------------------------------------------------------------------------


class Slopes(NamedTuple):
    """The derivatives of sampling coordinates (u, v) by the pixel's (x, y), (B, h, w) each."""

    ux: Tensor
    uy: Tensor
    vx: Tensor
    vy: Tensor


class Footprint(NamedTuple):
    """The symmetric matrix that takes distances in the image to numbers of pixels of the result, and how far taps are away."""

    xx: Tensor
    xy: Tensor
    yy: Tensor
    reach_x: Tensor
    reach_y: Tensor


def footprint(slopes: Slopes) -> Footprint:
    """The inverse of the factor S of J = S R that is symmetric, with eigenvalues clamped to [1, MAX_SHRINK]."""
    ux, uy, vx, vy = (clamp(torch.where(slope.isnan(), 0.0, slope), -MAX_SLOPE, MAX_SLOPE) for slope in slopes)
    p, q, r = ux * ux + uy * uy, ux * vx + uy * vy, vx * vx + vy * vy
    e = (p - r) / 2
    d = _root(e * e + q * q)
    s1 = _root((p + r) / 2 + d)
    divisor = torch.where(s1 > 0, s1, 1)
    s2 = (ux * vy - uy * vx).abs() / divisor
    g1, g2 = (clamp(s, 1, MAX_SHRINK) for s in (s1, s2))
    # (g1 - g2) / (s1 - s2), which is 1 for axes of one length, too.
    kept = (s1 >= 1) & (s1 <= MAX_SHRINK) & (s2 >= 1) & (s2 <= MAX_SHRINK)
    apart = ~kept & (s1 > s2)
    ratio = torch.where(apart, (g1 - g2) / torch.where(apart, s1 - s2, 1), kept.to(s1.dtype))
    scale = ratio / torch.where(s1 > 0, s1 + s2, 1)
    inverse = -scale / (g1 * g2)
    across = (scale * q).abs()
    return Footprint(
        1 / g1 + inverse * (e - d),
        inverse * q,
        1 / g1 - inverse * (e + d),
        g1 + scale * (e - d) + across,
        g1 - scale * (e + d) + across,
    )


def _root(x: Tensor) -> Tensor:
    """The square root, whose derivative at 0 is 0."""
    return torch.where(x > 0, torch.where(x > 0, x, 1).sqrt(), 0.0)


def _triangle(q: Tensor) -> Tensor:
    """max(0, 1 - |q|), with derivatives from the right."""
    return torch.where((q > -1) & (q <= 1), torch.where(q > 0, 1 - q, 1 + q), 0.0)


def sample_antialiased(
    image: Tensor,
    coords: Sequence[Tensor],
    slopes: Slopes,
    padding: str,
    align_corners: bool,
    fill: Tensor | None = None,
) -> Tensor:
    """Means of the pixels of `image` (B, C, H, W) around `coords`, x and y (B, h, w)."""
    batch, channels, height, width = image.shape
    shape = footprint(slopes)
    u, v = (_near_image(c, n, padding, align_corners) for c, n in zip(coords, (width, height)))
    first_x, first_y = ((c - reach).detach().ceil() for c, reach in ((u, shape.reach_x), (v, shape.reach_y)))
    columns, rows = _count_taps(u, shape.reach_x), _count_taps(v, shape.reach_y)
    pixels = image.flatten(2)
    outside: Any = 0.0 if fill is None else fill[..., None]
    together = 16 if is_compiling() else 4  # rows of taps: graphs hold each step, which takes memory for all of them
    x = first_x[..., None, None] + torch.arange(columns, dtype=u.dtype, device=u.device)  # (B, h, w, 1, columns)
    dx = x - u[..., None, None]
    column, in_columns = _padded_pixel(x.long(), width, padding, align_corners)
    value: Any = 0.0
    total: Any = 0.0
    xx, xy, yy = (entry[..., None, None] for entry in shape[:3])
    for j in range(0, rows, together):
        some = torch.arange(j, min(j + together, rows), dtype=v.dtype, device=v.device)
        y = (first_y[..., None] + some)[..., None]  # (B, h, w, rows, 1)
        dy = y - v[..., None, None]
        row, in_rows = _padded_pixel(y.long(), height, padding, align_corners)
        weight = _triangle(xx * dx + xy * dy) * _triangle(xy * dx + yy * dy)
        index = (row * width + column).flatten(1)[:, None].expand(batch, channels, -1)
        tap = torch.where((in_columns & in_rows).flatten(1)[:, None], pixels.gather(2, index), outside)
        # A tap of weight 0 contributes nothing, even if it is inf or NaN.
        each = weight.flatten(1)[:, None]
        product = each * torch.where((each == 0) & ~tap.isfinite(), 0.0, tap)
        value = value + product.unflatten(2, weight.shape[1:]).sum((-1, -2))
        total = total + weight.sum((-1, -2))
    result: Tensor = value / total[:, None]
    return result


def _count_taps(center: Tensor, reach: Tensor) -> int:
    """How many taps along an axis the widest window has; the largest number where nothing may depend on it, or is known."""
    if is_compiling() or center.is_meta:
        return 2 * MAX_REACH
    count = without_transforms(((center + reach).floor() - (center - reach).ceil()).detach() + 1)
    return int(count.max()) if count.numel() else 1


def _near_image(x: Tensor, size: int, padding: str, align_corners: bool) -> Tensor:
    """Equivalent coordinates near the image. NaN is out of bounds, to the left."""
    period = 2 * (size - 1 if align_corners else size)
    if padding != "reflection" or period == 0:  # reflections between the centers of one pixel are that, as is a border
        low = -2.0 * MAX_REACH
        return clamp(torch.where(x > low, x, low), high=size + 2 * MAX_REACH)
    reflected = x - period * (x.detach() / period).floor()
    return clamp(torch.where(reflected.isfinite(), reflected, 0.0), 0, period)


def _padded_pixel(i: Tensor, size: int, padding: str, align_corners: bool) -> tuple[Tensor, Tensor]:
    """The pixel that a tap reads along an axis, and whether it is in bounds."""
    if padding == "reflection":
        edge = 0 if align_corners else 1
        period = 2 * (size - 1 + edge)
        i = i.remainder(period) if period else 0 * i
        i = torch.where(i < size, i, period - i - edge)
    pixel = i.clamp(0, size - 1)
    return pixel, (i == pixel) | (padding != "fill")


# --- by a matrix ----------------------------------------------------------------------------------------------------


def _warp_reference(image, matrix, fill, image_index, size, padding, align_corners, inverse, normalized):
    samples = sampling._count_samples(image, image_index, matrix)
    image = sampling._images_of_samples(image, image_index, samples)
    matrix = matrix.expand(samples, -1, -1)
    to_source = sampling.source_map(matrix, image.shape[2:], size, align_corners, inverse, normalized)
    u, v, depth, horizon = sampling.mapped_pixels(to_source, size)
    m = to_source[..., None, None]
    slopes = [(m[:, i, k] - c * m[:, 2, k]) / depth for i, c in enumerate((u, v)) for k in (0, 1)]
    slopes = Slopes(*(torch.where(horizon, 0, slope).to(matrix.dtype) for slope in slopes))
    coords = [torch.where(horizon, torch.nan, c).to(matrix.dtype) for c in (u, v)]
    return sample_antialiased(image, coords, slopes, PADDING_NAMES[padding], align_corners, fill)


def _warp_backward(needs, grad, image, matrix, fill, image_index, size, *options):
    grads = [None, None, None, None]
    if needs[0]:
        grads[0] = _warp_image_backward(grad, matrix, image_index, _batch_size(image), *options)
    if needs[1]:
        grads[1] = _warp_matrix_backward(grad, image, matrix, fill, image_index, *options).sum_to_size(matrix.shape)
    if needs[2]:
        inside = warp_antialiased(_ones(image), matrix, None, None, size, *options)
        grads[2] = _grad_fill(grad, inside, fill)
    return grads


def _warp_image_backward_reference(grad, matrix, image_index, size, *options):
    matrix = matrix.expand(grad.shape[0], -1, -1)

    def of_image(image: Tensor) -> Tensor:
        return _warp_reference(image, matrix, None, image_index, grad.shape[2:], *options)

    _, vjp_fn = torch.func.vjp(of_image, sampling._zeros(matrix, grad, size))
    return vjp_fn(grad.to(matrix.dtype))[0].to(grad.dtype)


def _warp_image_backward_vjp(needs, grad_grad, grad, matrix, image_index, size, *options):
    needed = (False, *needs[1:])
    args = (grad, matrix, image_index, size, *options)
    grads = _warp_image_backward.differentiate_reference(needed, grad_grad, *args)
    if needs[0]:
        matrix = matrix.expand(grad.shape[0], -1, -1)
        grads[0] = warp_antialiased(grad_grad, matrix, None, image_index, list(grad.shape[2:]), *options)
    return grads


def _matrix_backward_reference(grad, image, matrix, fill, image_index, *options):
    promoted = matrix.dtype

    def of_matrix(matrix: Tensor) -> Tensor:
        return _warp_reference(image.to(promoted), matrix, fill, image_index, grad.shape[2:], *options)

    _, vjp_fn = torch.func.vjp(of_matrix, matrix.expand(grad.shape[0], -1, -1))
    return vjp_fn(grad.to(promoted))[0]


warp_antialiased = register(
    "warp_antialiased",
    _warp_reference,
    fake=lambda image, matrix, fill, image_index, size, *options: (
        sampling._count_samples(image, image_index, matrix),
        image.shape[1],
        *size,
    ),
    backward=_warp_backward,
    bytes=True,
    flatten=_flatten_samples(image=0, image_index=3),
)
_warp_image_backward = register(
    "warp_antialiased_image_backward",
    _warp_image_backward_reference,
    fake=_fake_image_backward,
    backward=_warp_image_backward_vjp,
    nondeterministic=on_cuda,
    flatten=_flatten_samples(image=None, image_index=2),
)
_warp_matrix_backward = register(
    "warp_antialiased_matrix_backward",
    _matrix_backward_reference,
    fake=lambda grad, image, matrix, *rest: matrix.new_empty(grad.shape[0], *matrix.shape[1:]),
    casts_outputs=True,
    flatten=_flatten_samples(image=1, image_index=4),
)


def warp_antialiased_by_formula(
    image: Tensor,
    image_index: Tensor | None,
    formula: str,
    arguments: Sequence[Any],
    size: Sequence[int],
    padding: int,
    align_corners: bool,
    inverse: bool,
    normalized: bool,
) -> Tensor:
    """What `warp_by_formula` does, with one launch more: the matrix by the formula of that name, of six tensors and numbers."""
    entry = sampling.FORMULAS[formula]
    matrix = entry.matrix(*arguments[: entry.tensors], *arguments[6:], *entry.rows)
    return warp_antialiased(image, matrix, None, image_index, list(size), padding, align_corners, inverse, normalized)


# --- by maps --------------------------------------------------------------------------------------------------------


def _differences(coords: Tensor, axis: int) -> Tensor:
    """Half the differences of the neighbors along an axis, whole ones at its ends, 0 along an axis of one pixel."""
    n = coords.shape[axis]
    if n == 1:
        return torch.zeros_like(coords)
    first, last = coords.narrow(axis, 0, 1), coords.narrow(axis, n - 1, 1)
    after = torch.cat([coords.narrow(axis, 1, n - 1), last], axis)
    before = torch.cat([first, coords.narrow(axis, 0, n - 1)], axis)
    index = torch.arange(n, device=coords.device)
    between = torch.where((index == 0) | (index == n - 1), 1.0, 0.5).to(coords.dtype)
    return (after - before) * between.reshape(-1, *(1,) * (coords.dim() - 1 - axis))


def _remap_reference(image, map_x, map_y, fill, image_index, padding, align_corners, normalized, displacements):
    samples = sampling._count_samples(image, image_index, map_x, map_y)
    image = sampling._images_of_samples(image, image_index, samples)
    coords = sampling.map_coords((map_x, map_y), samples, image.shape[2:], align_corners, normalized, displacements)
    slopes = []
    for k, c in enumerate(coords):
        for axis in (2, 1):
            slope = _differences(c, axis)
            # A displaced pixel of an axis of one pixel still moves by one.
            slopes.append(slope + 1 if displacements and axis == 2 - k and c.shape[axis] == 1 else slope)
    return sample_antialiased(image, coords, Slopes(*slopes), PADDING_NAMES[padding], align_corners, fill)


def _remap_backward(needs, grad, image, map_x, map_y, fill, image_index, *options):
    grads = [None, None, None, None, None]
    if needs[0]:
        grads[0] = _remap_image_backward(grad, map_x, map_y, image_index, _batch_size(image), *options)
    if needs[1] or needs[2]:
        map_grads = _remap_map_backward(grad, image, map_x, map_y, fill, image_index, *options)
        grads[1:3] = (g.sum_to_size(m.shape) for g, m in zip(map_grads, (map_x, map_y)))
    if needs[3]:
        inside = remap_antialiased(_ones(image), map_x, map_y, None, None, *options)
        grads[3] = _grad_fill(grad, inside, fill)
    return grads


def _remap_image_backward_reference(grad, map_x, map_y, image_index, size, *options):
    map_x = map_x.expand(grad.shape[0], -1, -1)

    def of_image(image: Tensor) -> Tensor:
        return _remap_reference(image, map_x, map_y, None, image_index, *options)

    _, vjp_fn = torch.func.vjp(of_image, sampling._zeros(map_x, grad, size))
    return vjp_fn(grad.to(map_x.dtype))[0].to(grad.dtype)


def _remap_image_backward_vjp(needs, grad_grad, grad, map_x, map_y, image_index, size, *options):
    needed = (False, *needs[1:])
    args = (grad, map_x, map_y, image_index, size, *options)
    grads = _remap_image_backward.differentiate_reference(needed, grad_grad, *args)
    if needs[0]:
        map_x = map_x.expand(grad.shape[0], -1, -1)
        grads[0] = remap_antialiased(grad_grad, map_x, map_y, None, image_index, *options)
    return grads


def _map_backward_reference(grad, image, map_x, map_y, fill, image_index, *options):
    promoted = map_x.dtype

    def of_maps(map_x: Tensor, map_y: Tensor) -> Tensor:
        return _remap_reference(image.to(promoted), map_x, map_y, fill, image_index, *options)

    _, vjp_fn = torch.func.vjp(of_maps, *(m.expand(grad.shape[0], -1, -1) for m in (map_x, map_y)))
    return vjp_fn(grad.to(promoted))


remap_antialiased = register(
    "remap_antialiased",
    _remap_reference,
    fake=lambda image, map_x, map_y, fill, image_index, *options: (
        sampling._count_samples(image, image_index, map_x, map_y),
        image.shape[1],
        *map_x.shape[1:],
    ),
    backward=_remap_backward,
    bytes=True,
    flatten=_flatten_samples(image=0, image_index=4),
)
_remap_image_backward = register(
    "remap_antialiased_image_backward",
    _remap_image_backward_reference,
    fake=_fake_image_backward,
    backward=_remap_image_backward_vjp,
    nondeterministic=on_cuda,
    flatten=_flatten_samples(image=None, image_index=3),
)
_remap_map_backward = register(
    "remap_antialiased_map_backward",
    _map_backward_reference,
    fake=lambda grad, image, map_x, *rest: [map_x.new_empty(grad.shape[0], *map_x.shape[1:]) for _ in range(2)],
    casts_outputs=True,
    flatten=_flatten_samples(image=1, image_index=5),
)

# --- arguments ------------------------------------------------------------------------------------------------------


def check_antialias(op: str, antialias: Any, mode: str) -> None:
    """Raise unless `antialias` is a bool that the interpolation allows."""
    _check.flag(op, "antialias", antialias)
    if antialias and mode != "bilinear":
        raise ValueCheckError(f"{op}: expected mode 'bilinear' with antialias, got {mode!r}")
