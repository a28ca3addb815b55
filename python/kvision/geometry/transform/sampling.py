"""Sampling of images between their pixels, which all warps and maps share.

Sampling coordinates are in pixels; the center of the first one is (0, 0). `sample` defines the result for images and
volumes. The operators `warp` (coordinates from a matrix) and `remap` (coordinates from maps) have kernels.
csrc/geometry/transform/sampling.h has the rules of taps and padding.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype
from kvision._modes import INTERPOLATION_NAMES, PADDING, PADDING_NAMES, WARP_FORMULA
from kvision._ops import Operator, on_cuda, register
from kvision.core.exceptions import ShapeError
from kvision.geometry.conversions.homogeneous import homogeneous
from kvision.geometry.conversions.pixels import by_axes
from kvision.geometry.linalg import adjugate
from kvision.geometry.transform import matrices

INTERPOLATIONS = ("bilinear", "nearest", "bicubic")
PADDINGS = ("zeros", "border", "reflection", "fill")

# --- the definition -------------------------------------------------------------------------------------------------


def sample(
    image: Tensor,
    coords: Sequence[Tensor],
    interpolation: str,
    padding: str,
    align_corners: bool,
    fill: Tensor | None = None,
) -> Tensor:
    """Values of `image` (B, C, *S) at `coords`, one tensor (B, *O) for each axis of S, the last axis first.

    `padding` is 'border', 'reflection', or 'fill' with the numbers `fill` (B or 1, C or 1), None for 0.
    """
    batch, channels, *sizes = image.shape
    taps = [_taps(x, n, interpolation, padding, align_corners) for x, n in zip(reversed(coords), sizes)]
    pixels = image.flatten(2)
    outside: Any = 0.0 if fill is None else fill[..., None]
    total: Any = 0.0
    for tap in itertools.product(*taps):
        index: Any = 0
        weight: Any = 1.0
        exists: Any = True
        for size, (i, w, inside) in zip(sizes, tap):
            index, weight, exists = index * size + i, weight * w, exists & inside
        flat = index.flatten(1)[:, None].expand(batch, channels, -1)
        value = torch.where(exists.flatten(1)[:, None], pixels.gather(2, flat), outside)
        weight = weight.flatten(1)[:, None]
        # A tap of weight 0 contributes nothing, even if it is inf or NaN.
        total = total + weight * torch.where((weight == 0) & ~value.isfinite(), 0.0, value)
    result: Tensor = total.unflatten(2, coords[0].shape[1:])
    return result


def _taps(
    x: Tensor, size: int, interpolation: str, padding: str, align_corners: bool
) -> list[tuple[Tensor, Tensor, Tensor]]:
    """The taps along an axis: index of the pixel, weight, whether it is in bounds."""
    x = _near_image(x, size, padding, align_corners)
    if interpolation == "nearest":
        first, weights = x.detach().round(), [1 + 0 * x]  # its gradient is 0, where torch gives none
    else:
        first = x.detach().floor()
        t = x - first
        s = 1 - t
        if interpolation == "bilinear":
            weights = [s, t]
        else:
            first = first - 1
            inner = [(1.25 * u - 2.25) * u * u + 1 for u in (t, s)]
            weights = [-0.75 * t * s * s, *inner, -0.75 * s * t * t]
    taps = []
    for k, weight in enumerate(weights):
        i = first.long() + k
        if padding == "reflection":
            edge = 0 if align_corners else 1
            i = torch.where(i < 0, -i - edge, i)
            i = torch.where(i >= size, 2 * (size - 1) + edge - i, i)
            i = torch.where(i < 0, -i - edge, i)
        pixel = i.clamp(0, size - 1)
        taps.append((pixel, weight, (i == pixel) | (padding != "fill")))
    return taps


def _near_image(x: Tensor, size: int, padding: str, align_corners: bool) -> Tensor:
    """Equivalent coordinates in or near the image, with the same sampled value. NaN is out of bounds, to the left."""
    if padding != "reflection":
        return torch.where(x > -4, x, -4.0).clamp(max=size + 3)
    period = 2 * (size - 1 if align_corners else size)
    if period == 0:
        return 0 * x.nan_to_num()  # all coordinates read the only pixel
    folded = x - period * (x.detach() / period).floor()
    return torch.where(folded.isfinite(), folded, 0.0).clamp(0, period)


# --- sampling coordinates of a matrix -------------------------------------------------------------------------------


def source_coords(
    matrix: Tensor, output: Sequence[int], source: Sequence[int], align_corners: bool, inverse: bool, normalized: bool
) -> list[Tensor]:
    """Sampling coordinates in the source of the pixels of the output: x and y, (B, h, w)."""
    promoted = matrices.promoted(matrix)
    if promoted.shape[1] == 2:
        promoted = homogeneous(promoted)
    if inverse:
        promoted = adjugate(promoted)
    if normalized:
        promoted = from_unit(source, align_corners, promoted) @ promoted @ to_unit(output, align_corners, promoted)
    promoted = promoted / _scale(promoted.detach())
    (h, w), m = output, promoted[..., None, None]
    x = torch.arange(w, dtype=promoted.dtype, device=promoted.device)
    y = torch.arange(h, dtype=promoted.dtype, device=promoted.device)[:, None]
    u, v, depth = (m[:, i, 0] * x + (m[:, i, 1] * y + m[:, i, 2]) for i in range(3))
    horizon = depth == 0
    depth = torch.where(horizon, 1, depth)
    return [torch.where(horizon, torch.nan, x / depth).to(matrix.dtype) for x in (u, v)]


def _scale(m: Tensor) -> Tensor:
    largest = m.abs().amax((1, 2), keepdim=True)
    last = m[:, 2:, 2:]
    scale = torch.where(last.abs() > 1e-6 * largest, last, largest)
    return torch.where(scale == 0, 1, scale)


def from_unit(size: Sequence[int], align_corners: bool, like: Tensor) -> Tensor:
    """Pixels from [-1, 1]: between the centers of the first and the last pixel, or between their outer edges."""
    less = 1 if align_corners else 0
    return by_axes([((n - less) / 2, (n - 1) / 2) for n in reversed(size)], like.device, like.dtype)


def to_unit(size: Sequence[int], align_corners: bool, like: Tensor) -> Tensor:
    less = 1 if align_corners else 0
    # The only pixel of an axis is at 0.
    scales = [2 / (n - less) if n > less else 0.0 for n in size]
    lines = [(scale, -scale * (n - 1) / 2) for scale, n in zip(scales, size)]
    return by_axes(lines[::-1], like.device, like.dtype)


# --- warp -----------------------------------------------------------------------------------------------------------


def _warp_reference(image, matrix, fill, size, interpolation, padding, align_corners, inverse, normalized):
    matrix = matrix.expand(image.shape[0], -1, -1)
    coords = source_coords(matrix, size, image.shape[2:], align_corners, inverse, normalized)
    return sample(image, coords, INTERPOLATION_NAMES[interpolation], PADDING_NAMES[padding], align_corners, fill)


def _warp_backward(needs, grad, image, matrix, fill, size, *options):
    grads = [None, None, None]
    if needs[0]:
        grads[0] = warp_image_backward(grad, matrix, list(image.shape[2:]), *options)
    if needs[1]:
        grads[1] = _warp_matrix_backward(grad, image, matrix, fill, *options).sum_to_size(matrix.shape)
    if needs[2]:
        inside = warp(torch.ones_like(image[:, :1]), matrix, None, size, *options)
        grads[2] = _grad_fill(grad, inside, fill)
    return grads


def _grad_fill(grad: Tensor, inside: Tensor, fill: Tensor) -> Tensor:
    promoted = fill.dtype
    return (grad.to(promoted) * (1 - inside.to(promoted))).sum((2, 3)).sum_to_size(fill.shape)


def _warp_image_backward_reference(grad, matrix, size, *options):
    def of_image(image: Tensor) -> Tensor:
        return _warp_reference(image, matrix, None, grad.shape[2:], *options)

    _, vjp_fn = torch.func.vjp(of_image, matrix.new_zeros(*grad.shape[:2], *size))
    return vjp_fn(grad.to(matrix.dtype))[0].to(grad.dtype)


def _warp_image_backward_vjp(needs, grad_grad, grad, matrix, size, *options):
    grads = warp_image_backward.differentiate_reference((False, *needs[1:]), grad_grad, grad, matrix, size, *options)
    if needs[0]:
        grads[0] = warp(grad_grad, matrix, None, list(grad.shape[2:]), *options)
    return grads


def _matrix_backward_reference(grad, image, matrix, fill, *options):
    promoted = matrix.dtype

    def of_matrix(matrix: Tensor) -> Tensor:
        return _warp_reference(image.to(promoted), matrix, fill, grad.shape[2:], *options)

    _, vjp_fn = torch.func.vjp(of_matrix, matrix.expand(image.shape[0], -1, -1))
    return vjp_fn(grad.to(promoted))[0]


def _adds_by_atomics(
    grad: Tensor, matrix: Tensor, size: Sequence[int], interpolation: int, padding: int, *_: bool
) -> bool:
    return grad.is_cuda and padding != PADDING["fill"]


warp = register(
    "warp",
    _warp_reference,
    fake=lambda image, matrix, fill, size, *options: (*image.shape[:2], *size),
    backward=_warp_backward,
    bytes=True,
)
warp_image_backward = register(
    "warp_image_backward",
    _warp_image_backward_reference,
    fake=lambda grad, matrix, size, *options: grad.new_empty(*grad.shape[:2], *size),
    backward=_warp_image_backward_vjp,
    nondeterministic=_adds_by_atomics,
)
_warp_matrix_backward = register(
    "warp_matrix_backward",
    _matrix_backward_reference,
    fake=lambda grad, image, matrix, *rest: matrix.new_empty(image.shape[0], *matrix.shape[1:]),
    casts_outputs=True,
)

# --- warps by formulas ----------------------------------------------------------------------------------------------


class Formula(NamedTuple):
    """A formula of a matrix as warps use it: its operator, its number of tensors, and its number of rows, if it takes one."""

    matrix: Operator
    tensors: int
    rows: tuple[int, ...] = ()


def register_warp_by_formula(by: Operator, formulas: dict[str, Formula], *unused: None, **rules: Any) -> Operator:
    """A warp whose matrix a formula computes in the same launch, from up to six tensors and numbers; `by` is the warp.

    Takes the images, six tensors or None, the number of the formula, its plain arguments, then the arguments of `by` after
    its matrix and the tensors `unused`.
    """

    by_number = {WARP_FORMULA[name]: formula for name, formula in formulas.items()}

    def split(image: Tensor, args: Sequence[Any]) -> tuple[Formula, tuple[Any, ...], Sequence[Any]]:
        formula = by_number[args[6]]
        first = args[0]
        if first is None:  # a translation
            first = torch.zeros(1, len(args[7]), dtype=compute_dtype(image), device=image.device)
        tensors = (first, *args[1:6], *[None] * 6)[: formula.tensors]
        return formula, (*tensors, *args[7], *formula.rows), args[8:]

    def reference(image: Tensor, *args: Any) -> Tensor:
        formula, given, options = split(image, args)
        warped: Tensor = by.definition(image, formula.matrix.definition(*given), *unused, *options)
        return warped

    def backward(needs: Sequence[bool], grad: Tensor, image: Tensor, *args: Any) -> list[Tensor | None]:
        formula, given, options = split(image, args)
        to_matrix = any(needs[1:7])
        needed = (needs[0], to_matrix, *[False] * (len(unused) + len(options)))
        grads = by.backward(needed, grad, image, formula.matrix(*given), *unused, *options)
        if not to_matrix:
            return [grads[0]]
        return [grads[0], *formula.matrix.backward(needs[1:], grads[1], *given)[:6]]

    return register(
        f"{by.name}_by_formula",
        reference,
        fake=lambda image, *args: (*image.shape[:2], *args[8]),
        backward=backward,
        **rules,
    )


warp_by_formula = register_warp_by_formula(
    warp,
    {
        "affine_matrix2d": Formula(matrices.affine_matrix2d, 6, (2,)),
        "translation_matrix2d": Formula(matrices.translation_matrix2d, 1, (2,)),
        "scale_matrix2d": Formula(matrices.scale_matrix2d, 2),
        "slant_matrix2d": Formula(matrices.slant_matrix2d, 1),
        "crop_matrix": Formula(matrices.crop_matrix, 2),
    },
    None,  # no fill
    bytes=True,
)

# --- remap ----------------------------------------------------------------------------------------------------------


def _remap_reference(image, map_x, map_y, fill, interpolation, padding, align_corners, normalized, displacements):
    coords = []
    for axis, (coord, size) in enumerate(((map_x, image.shape[3]), (map_y, image.shape[2]))):
        coord = coord.expand(image.shape[0], -1, -1)
        if normalized:
            coord = coord * ((size - 1 if align_corners else size) / 2)
        if displacements:
            index = torch.arange(coord.shape[2 - axis], dtype=coord.dtype, device=coord.device)
            coord = coord + (index[:, None] if axis else index)
        elif normalized:
            coord = coord + (size - 1) / 2
        coords.append(coord)
    return sample(image, coords, INTERPOLATION_NAMES[interpolation], PADDING_NAMES[padding], align_corners, fill)


def _remap_backward(needs, grad, image, map_x, map_y, fill, *options):
    grads = [None, None, None, None]
    if needs[0]:
        grads[0] = _remap_image_backward(grad, map_x, map_y, list(image.shape[2:]), *options)
    if needs[1] or needs[2]:
        map_grads = _remap_map_backward(grad, image, map_x, map_y, fill, *options)
        grads[1:3] = (g.sum_to_size(map_x.shape) for g in map_grads)
    if needs[3]:
        inside = remap(torch.ones_like(image[:, :1]), map_x, map_y, None, *options)
        grads[3] = _grad_fill(grad, inside, fill)
    return grads


def _remap_image_backward_reference(grad, map_x, map_y, size, *options):
    def of_image(image: Tensor) -> Tensor:
        return _remap_reference(image, map_x, map_y, None, *options)

    _, vjp_fn = torch.func.vjp(of_image, map_x.new_zeros(*grad.shape[:2], *size))
    return vjp_fn(grad.to(map_x.dtype))[0].to(grad.dtype)


def _remap_image_backward_vjp(needs, grad_grad, grad, map_x, map_y, size, *options):
    kept = (False, *needs[1:])
    grads = _remap_image_backward.differentiate_reference(kept, grad_grad, grad, map_x, map_y, size, *options)
    if needs[0]:
        grads[0] = remap(grad_grad, map_x, map_y, None, *options)
    return grads


def _map_backward_reference(grad, image, map_x, map_y, fill, *options):
    promoted = map_x.dtype

    def of_map(map_x: Tensor, map_y: Tensor) -> Tensor:
        return _remap_reference(image.to(promoted), map_x, map_y, fill, *options)

    maps = (m.expand(image.shape[0], -1, -1) for m in (map_x, map_y))
    _, vjp_fn = torch.func.vjp(of_map, *maps)
    return vjp_fn(grad.to(promoted))


remap = register(
    "remap",
    _remap_reference,
    fake=lambda image, map_x, *rest: (*image.shape[:2], *map_x.shape[1:]),
    backward=_remap_backward,
    bytes=True,
)
_remap_image_backward = register(
    "remap_image_backward",
    _remap_image_backward_reference,
    fake=lambda grad, map_x, map_y, size, *options: grad.new_empty(*grad.shape[:2], *size),
    backward=_remap_image_backward_vjp,
    nondeterministic=on_cuda,
)
_remap_map_backward = register(
    "remap_map_backward",
    _map_backward_reference,
    fake=lambda grad, image, map_x, *rest: [map_x.new_empty(image.shape[0], *map_x.shape[1:]) for _ in range(2)],
    casts_outputs=True,
)

# --- arguments ------------------------------------------------------------------------------------------------------


def check_options(op: str, mode: Any, padding_mode: Any, align_corners: Any) -> None:
    """Raise unless these are an interpolation, a padding and a bool."""
    if mode not in INTERPOLATIONS:
        _check.choice(op, "mode", mode, INTERPOLATIONS)
    if padding_mode not in PADDINGS:
        _check.choice(op, "padding_mode", padding_mode, PADDINGS)
    _check.flag(op, "align_corners", align_corners)


def padding_and_fill(op: str, image: Tensor, padding_mode: str, fill_value: Any) -> tuple[int, Tensor | None]:
    """The padding and the fill as the operators take them."""
    if padding_mode in ("border", "reflection"):
        return PADDING[padding_mode], None
    if padding_mode == "zeros" or fill_value is None:
        return PADDING["fill"], None
    dtype = compute_dtype(image)
    if isinstance(fill_value, (int, float)):
        fill_value = image.new_full((), fill_value, dtype=dtype)  # created on the device, without a copy from the host
    elif not isinstance(fill_value, Tensor):
        fill_value = torch.as_tensor(fill_value, dtype=dtype, device=image.device)
    _check.numbers(op, "fill_value", fill_value)
    _check.same_device(op, src=image, fill_value=fill_value)
    shape = fill_value.shape
    if len(shape) == 4 and shape[2:] == (1, 1):
        fill_value = fill_value[..., 0, 0]
    elif len(shape) < 2:
        fill_value = fill_value.reshape(1, -1)
    b, c = image.shape[:2]
    if fill_value.dim() != 2 or fill_value.shape[0] not in (1, b) or fill_value.shape[1] not in (1, c):
        raise ShapeError(
            f"{op}: expected fill_value of shape (), ({c},) or ({b}, {c}, 1, 1), got {tuple(shape)}", actual_shape=shape
        )
    return PADDING["fill"], as_dtype(fill_value, dtype)


def symbolic_point(image: Tensor, x: float, y: float) -> Tensor:
    """(1, 2), symbolic coordinates for the images: a plain argument of an operator would fix their value in the graph."""
    return torch.stack([image.new_full((), value, dtype=compute_dtype(image)) for value in (x, y)])[None]


def cast_to_image(op: str, image: Tensor, name: str, x: Tensor) -> Tensor:
    """A matrix, map or parameter as the operators take it: in the dtype of the computation, with 1 or B rows."""
    _check.same_device(op, image=image, **{name: x})
    if x.shape[0] not in (1, image.shape[0]):
        raise ShapeError(
            f"{op}: expected {name} with 1 or {image.shape[0]} rows, got {tuple(x.shape)}", actual_shape=x.shape
        )
    return as_dtype(x, compute_dtype(image))
