"""Sampling of images between their pixels, which all warps and maps share.

Sampling coordinates are in pixels; the center of the first one is (0, 0). `sample` defines the result for images and
volumes. The operators `warp` (coordinates from a matrix) and `remap` (coordinates from maps) have kernels.
csrc/geometry/transform/sampling.h has the rules of taps and padding.

Samples may outnumber the images. `image_index` (N,) has the image that each sample reads; without it one image serves all
samples, or sample b reads image b. The gradient to the images adds up the samples of each.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Interpolation, PaddingOrFill
from kvision._clamp import clamp
from kvision._constants import constant
from kvision._dtype import as_dtype, compute_dtype
from kvision._modes import INTERPOLATION_NAMES, PADDING, PADDING_NAMES, WARP_FORMULA
from kvision._ops import Operator, flatten_batch, on_cuda, register, size_below_vmap
from kvision.core.exceptions import ShapeError
from kvision.geometry.conversions.homogeneous import homogeneous
from kvision.geometry.conversions.pixels import by_axes
from kvision.geometry.linalg import adjugate
from kvision.geometry.transform import matrices, nearest

INTERPOLATIONS = get_args(Interpolation)
PADDINGS = get_args(PaddingOrFill)

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
        first, weights = _nearest(x.detach()), [1 + 0 * x]  # its gradient is 0, where torch gives none
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


def _nearest(x: Tensor) -> Tensor:
    """The nearest pixels. Midway but for an error of rounding is midway: half to even, whatever computed the coordinates."""
    shift = 1.5 * 2.0 ** (22 if x.dtype == torch.float64 else 11)  # the sum has digits down to 2^-30 and 2^-12
    return ((x + shift) - shift).round()


def _near_image(x: Tensor, size: int, padding: str, align_corners: bool) -> Tensor:
    """Equivalent coordinates in or near the image, with the same sampled value. NaN is out of bounds, to the left."""
    if padding != "reflection":
        return clamp(torch.where(x > -4, x, -4.0), high=size + 3)
    period = 2 * (size - 1 if align_corners else size)
    if period == 0:
        return 0 * x.nan_to_num()  # all coordinates read the only pixel
    reflected = x - period * (x.detach() / period).floor()
    return clamp(torch.where(reflected.isfinite(), reflected, 0.0), 0, period)


# --- sampling coordinates of a matrix -------------------------------------------------------------------------------


def source_coords(
    matrix: Tensor, output: Sequence[int], source: Sequence[int], align_corners: bool, inverse: bool, normalized: bool
) -> list[Tensor]:
    """Sampling coordinates in the source of the pixels of the output: x and y, (B, h, w)."""
    promoted = source_map(matrix, source, output, align_corners, inverse, normalized)
    u, v, _, horizon = mapped_pixels(promoted, output)
    return [torch.where(horizon, torch.nan, x).to(matrix.dtype) for x in (u, v)]


def source_map(
    matrix: Tensor, source: Sequence[int], output: Sequence[int], align_corners: bool, inverse: bool, normalized: bool
) -> Tensor:
    """The map (B, 3, 3) from pixels of the output to those of the source."""
    promoted = matrices.promoted(matrix)
    if promoted.shape[1] == 2:
        promoted = homogeneous(promoted)
    if inverse:
        promoted = adjugate(promoted)
    if normalized:
        promoted = from_unit(source, align_corners, promoted) @ promoted @ to_unit(output, align_corners, promoted)
    return promoted / homography_scale(promoted.detach())


def mapped_pixels(map: Tensor, size: Sequence[int]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Where a map takes the pixels of a size: x and y, their divisor, which is 1 on the horizon, and where that is."""
    (h, w), m = size, map[..., None, None]
    x = torch.arange(w, dtype=map.dtype, device=map.device)
    y = torch.arange(h, dtype=map.dtype, device=map.device)[:, None]
    u, v, depth = (m[:, i, 0] * x + (m[:, i, 1] * y + m[:, i, 2]) for i in range(3))
    horizon = depth == 0
    depth = torch.where(horizon, 1, depth)
    return u / depth, v / depth, depth, horizon


def homography_scale(m: Tensor) -> Tensor:
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


# --- which image each sample reads ----------------------------------------------------------------------------------


def _count_samples(image: Tensor, image_index: Tensor | None, *parameters: Tensor | None) -> int:
    if image_index is not None:
        return image_index.shape[0]
    if image.shape[0] == 1:
        for x in parameters:
            if x is not None and x.shape[0] != 1:
                return x.shape[0]
    return image.shape[0]


def _images_of_samples(image: Tensor, image_index: Tensor | None, samples: int) -> Tensor:
    if image_index is not None:
        # The kernels refuse bad indices on the CPU, and clamp them on CUDA.
        return image.index_select(0, image_index.clamp(0, image.shape[0] - 1))
    return image.expand(samples, *image.shape[1:]) if image.shape[0] == 1 else image


def _flatten_samples(image: int | None, image_index: int) -> Any:
    """The rule of vmap of an operator whose tensor `image` has one row for each image and the others one for each sample.

    Without such a tensor, the argument behind `image_index` is the size of the images, which starts with their number.
    """

    def flatten(n: int, in_dims: tuple[Any, ...], args: tuple[Any, ...]) -> list[Any]:
        flattened = list(args)
        is_mapped = image is None or in_dims[image] is not None
        images = args[image_index + 1][0] if image is None else size_below_vmap(args[image], in_dims[image])
        rows = {
            i: size_below_vmap(a, in_dims[i])
            for i, a in enumerate(args)
            if isinstance(a, Tensor) and i not in (image, image_index)
        }
        index = args[image_index]
        if index is not None:
            samples = size_below_vmap(index, in_dims[image_index])
            index = index[None] if in_dims[image_index] is None else index.movedim(in_dims[image_index], 0)
        else:
            samples = images if images != 1 else next((count for count in rows.values() if count != 1), 1)
            if not is_mapped or images != samples:
                index = torch.arange(samples, device=args[0].device)[None]
                index = index if images == samples else 0 * index
        if index is not None:
            if is_mapped:
                index = _offset_index(index, images, n)
            flattened[image_index] = index.expand(n, samples).reshape(-1)
        for i in rows:
            if in_dims[i] is not None or rows[i] == samples or i == 0:  # else one for all of them
                flattened[i] = flatten_batch(args[i], in_dims[i], n, samples)
        if image is None:
            flattened[image_index + 1] = [n * images, *args[image_index + 1][1:]]
            return flattened
        if is_mapped:
            flattened[image] = flatten_batch(args[image], in_dims[image], n, images)
        return flattened

    return flatten


def _offset_index(index: Tensor, images: int, n: int) -> Tensor:
    """Indices (1 or n, N) into n batches of images, one after the other; bad ones stay bad."""
    offset = images * torch.arange(n, device=index.device)[:, None]
    if index.device.type != "cpu":
        return index.clamp(0, images - 1) + offset
    return torch.where((index >= 0) & (index < images), index + offset, -1)


# --- warp -----------------------------------------------------------------------------------------------------------


def _warp_reference(image, matrix, fill, image_index, size, interpolation, padding, align_corners, inverse, normalized):
    samples = _count_samples(image, image_index, matrix)
    image = _images_of_samples(image, image_index, samples)
    coords = source_coords(matrix.expand(samples, -1, -1), size, image.shape[2:], align_corners, inverse, normalized)
    return sample(image, coords, INTERPOLATION_NAMES[interpolation], PADDING_NAMES[padding], align_corners, fill)


def _warp_backward(needs, grad, image, matrix, fill, image_index, size, *options):
    grads = [None, None, None, None]
    if needs[0]:
        grads[0] = warp_image_backward(grad, matrix, image_index, _batch_size(image), *options)
    if needs[1]:
        grads[1] = _warp_matrix_backward(grad, image, matrix, fill, image_index, *options).sum_to_size(matrix.shape)
    if needs[2]:
        inside = warp(_ones(image), matrix, None, None, size, *options)
        grads[2] = _grad_fill(grad, inside, fill)
    return grads


def _batch_size(image: Tensor) -> list[int]:
    return [image.shape[0], image.shape[2], image.shape[3]]


def _ones(image: Tensor) -> Tensor:
    return image.new_ones(1, 1, *image.shape[2:])


def _grad_fill(grad: Tensor, inside: Tensor, fill: Tensor) -> Tensor:
    promoted = fill.dtype
    return (grad.to(promoted) * (1 - inside.to(promoted))).sum((2, 3)).sum_to_size(fill.shape)


def _warp_image_backward_reference(grad, matrix, image_index, size, *options):
    matrix = matrix.expand(grad.shape[0], -1, -1)

    def of_image(image: Tensor) -> Tensor:
        return _warp_reference(image, matrix, None, image_index, grad.shape[2:], *options)

    _, vjp_fn = torch.func.vjp(of_image, _zeros(matrix, grad, size))
    return vjp_fn(grad.to(matrix.dtype))[0].to(grad.dtype)


def _zeros(like: Tensor, grad: Tensor, size: Sequence[int]) -> Tensor:
    return like.new_zeros(size[0], grad.shape[1], *size[1:])


def _warp_image_backward_vjp(needs, grad_grad, grad, matrix, image_index, size, *options):
    needed = (False, *needs[1:])
    args = (grad, matrix, image_index, size, *options)
    grads = warp_image_backward.differentiate_reference(needed, grad_grad, *args)
    if needs[0]:
        grads[0] = warp(
            grad_grad, matrix.expand(grad.shape[0], -1, -1), None, image_index, list(grad.shape[2:]), *options
        )
    return grads


def _matrix_backward_reference(grad, image, matrix, fill, image_index, *options):
    promoted = matrix.dtype

    def of_matrix(matrix: Tensor) -> Tensor:
        return _warp_reference(image.to(promoted), matrix, fill, image_index, grad.shape[2:], *options)

    _, vjp_fn = torch.func.vjp(of_matrix, matrix.expand(grad.shape[0], -1, -1))
    return vjp_fn(grad.to(promoted))[0]


def _adds_by_atomics(
    grad: Tensor,
    matrix: Tensor,
    image_index: Tensor | None,
    size: Sequence[int],
    interpolation: int,
    padding: int,
    *_: bool,
) -> bool:
    return grad.is_cuda and padding != PADDING["fill"]


def _fake_image_backward(grad: Tensor, *args: Any) -> Tensor:
    size = next(a for a in args if isinstance(a, (list, tuple)))
    return grad.new_empty(size[0], grad.shape[1], *size[1:])


warp = register(
    "warp",
    _warp_reference,
    fake=lambda image, matrix, fill, image_index, size, *options: (
        _count_samples(image, image_index, matrix),
        image.shape[1],
        *size,
    ),
    backward=_warp_backward,
    bytes=True,
    flatten=_flatten_samples(image=0, image_index=3),
)
warp_image_backward = register(
    "warp_image_backward",
    _warp_image_backward_reference,
    fake=_fake_image_backward,
    backward=_warp_image_backward_vjp,
    nondeterministic=_adds_by_atomics,
    flatten=_flatten_samples(image=None, image_index=2),
)
_warp_matrix_backward = register(
    "warp_matrix_backward",
    _matrix_backward_reference,
    fake=lambda grad, image, matrix, *rest: matrix.new_empty(grad.shape[0], *matrix.shape[1:]),
    casts_outputs=True,
    flatten=_flatten_samples(image=1, image_index=4),
)

# --- warps by formulas ----------------------------------------------------------------------------------------------


class Formula(NamedTuple):
    """A formula of a matrix as warps use it: its operator, its number of tensors, and its number of rows, if it takes one."""

    matrix: Operator
    tensors: int
    rows: tuple[int, ...] = ()


def register_warp_by_formula(
    by: Operator, formulas: dict[str, Formula], is_indexed: bool = False, **rules: Any
) -> Operator:
    """A warp whose matrix a formula computes in the same launch, from up to six tensors and numbers; `by` is the warp.

    Takes the images, six tensors or None, the number of the formula, its plain arguments, then the plain arguments of `by`.
    With `is_indexed` the image_index of `by` follows the six tensors; there is no fill.
    """

    by_number = {WARP_FORMULA[name]: formula for name, formula in formulas.items()}
    plain = 7 if is_indexed else 6  # the first argument after the image that is no tensor

    def split(image: Tensor, args: Sequence[Any]) -> tuple[Formula, tuple[Any, ...], Sequence[Any]]:
        formula, numbers, options = by_number[args[plain]], args[plain + 1], args[plain + 2 :]
        first = args[0]
        if first is None:  # a translation
            first = torch.zeros(1, len(numbers), dtype=compute_dtype(image), device=image.device)
        tensors = (first, *args[1:6], *[None] * 6)[: formula.tensors]
        return formula, (*tensors, *numbers, *formula.rows), (None, args[6], *options) if is_indexed else options

    def reference(image: Tensor, *args: Any) -> Tensor:
        formula, inputs, rest = split(image, args)
        warped: Tensor = by.definition(image, formula.matrix.definition(*inputs), *rest)
        return warped

    def backward(needs: Sequence[bool], grad: Tensor, image: Tensor, *args: Any) -> list[Tensor | None]:
        formula, inputs, rest = split(image, args)
        to_matrix = any(needs[1:7])
        needed = (needs[0], to_matrix, *[False] * len(rest))
        grads = by.backward(needed, grad, image, formula.matrix(*inputs), *rest)
        if not to_matrix:
            return [grads[0]]
        return [grads[0], *formula.matrix.backward(needs[1:], grads[1], *inputs)[:6]]

    def fake(image: Tensor, *args: Any) -> Sequence[int]:
        samples = _count_samples(image, args[6], *args[:6]) if is_indexed else image.shape[0]
        return (samples, image.shape[1], *args[plain + 2])

    return register(
        f"{by.name}_by_formula",
        reference,
        fake=fake,
        backward=backward,
        **rules,
    )


FORMULAS = {
    "affine_matrix2d": Formula(matrices.affine_matrix2d, 6, (2,)),
    "translation_matrix2d": Formula(matrices.translation_matrix2d, 1, (2,)),
    "scale_matrix2d": Formula(matrices.scale_matrix2d, 2),
    "shear_factor_matrix2d": Formula(matrices.shear_factor_matrix2d, 1),
    "crop_matrix": Formula(matrices.crop_matrix, 2),
}
warp_by_formula = register_warp_by_formula(
    warp,
    FORMULAS,
    is_indexed=True,
    bytes=True,
    flatten=_flatten_samples(image=0, image_index=7),
)

# --- remap ----------------------------------------------------------------------------------------------------------


def _remap_reference(
    image, map_x, map_y, fill, image_index, interpolation, padding, align_corners, normalized, displacements
):
    samples = _count_samples(image, image_index, map_x, map_y)
    image = _images_of_samples(image, image_index, samples)
    coords = map_coords((map_x, map_y), samples, image.shape[2:], align_corners, normalized, displacements)
    return sample(image, coords, INTERPOLATION_NAMES[interpolation], PADDING_NAMES[padding], align_corners, fill)


def map_coords(
    maps: Sequence[Tensor],
    samples: int,
    size: Sequence[int],
    align_corners: bool,
    normalized: bool,
    displacements: bool,
) -> list[Tensor]:
    """Sampling coordinates, in pixels of images of a size, that maps of x and y give all samples."""
    coords = []
    for axis, (coord, n) in enumerate(zip(maps, reversed(size))):
        coord = coord.expand(samples, -1, -1)
        if normalized:
            coord = coord * ((n - 1 if align_corners else n) / 2)
        if displacements:
            index = torch.arange(coord.shape[2 - axis], dtype=coord.dtype, device=coord.device)
            coord = coord + (index[:, None] if axis else index)
        elif normalized:
            coord = coord + (n - 1) / 2
        coords.append(coord)
    return coords


def _remap_backward(needs, grad, image, map_x, map_y, fill, image_index, *options):
    grads = [None, None, None, None, None]
    if needs[0]:
        grads[0] = _remap_image_backward(grad, map_x, map_y, image_index, _batch_size(image), *options)
    if needs[1] or needs[2]:
        map_grads = _remap_map_backward(grad, image, map_x, map_y, fill, image_index, *options)
        grads[1:3] = (g.sum_to_size(m.shape) for g, m in zip(map_grads, (map_x, map_y)))
    if needs[3]:
        inside = remap(_ones(image), map_x, map_y, None, None, *options)
        grads[3] = _grad_fill(grad, inside, fill)
    return grads


def _remap_image_backward_reference(grad, map_x, map_y, image_index, size, *options):
    map_x = map_x.expand(grad.shape[0], -1, -1)

    def of_image(image: Tensor) -> Tensor:
        return _remap_reference(image, map_x, map_y, None, image_index, *options)

    _, vjp_fn = torch.func.vjp(of_image, _zeros(map_x, grad, size))
    return vjp_fn(grad.to(map_x.dtype))[0].to(grad.dtype)


def _remap_image_backward_vjp(needs, grad_grad, grad, map_x, map_y, image_index, size, *options):
    needed = (False, *needs[1:])
    args = (grad, map_x, map_y, image_index, size, *options)
    grads = _remap_image_backward.differentiate_reference(needed, grad_grad, *args)
    if needs[0]:
        grads[0] = remap(grad_grad, map_x.expand(grad.shape[0], -1, -1), map_y, None, image_index, *options)
    return grads


def _map_backward_reference(grad, image, map_x, map_y, fill, image_index, *options):
    promoted = map_x.dtype

    def of_map(map_x: Tensor, map_y: Tensor) -> Tensor:
        return _remap_reference(image.to(promoted), map_x, map_y, fill, image_index, *options)

    maps = (m.expand(grad.shape[0], -1, -1) for m in (map_x, map_y))
    _, vjp_fn = torch.func.vjp(of_map, *maps)
    return vjp_fn(grad.to(promoted))


remap = register(
    "remap",
    _remap_reference,
    fake=lambda image, map_x, map_y, fill, image_index, *options: (
        _count_samples(image, image_index, map_x, map_y),
        image.shape[1],
        *map_x.shape[1:],
    ),
    backward=_remap_backward,
    bytes=True,
    flatten=_flatten_samples(image=0, image_index=4),
)
_remap_image_backward = register(
    "remap_image_backward",
    _remap_image_backward_reference,
    fake=_fake_image_backward,
    backward=_remap_image_backward_vjp,
    nondeterministic=on_cuda,
    flatten=_flatten_samples(image=None, image_index=3),
)
_remap_map_backward = register(
    "remap_map_backward",
    _map_backward_reference,
    fake=lambda grad, image, map_x, *rest: [map_x.new_empty(grad.shape[0], *map_x.shape[1:]) for _ in range(2)],
    casts_outputs=True,
    flatten=_flatten_samples(image=1, image_index=5),
)

# --- arguments ------------------------------------------------------------------------------------------------------


def check_options(
    op: str, mode: Any, padding_mode: Any, align_corners: Any, paddings: Sequence[str] = PADDINGS
) -> None:
    """Raise unless these are an interpolation, a padding and a bool."""
    if mode not in INTERPOLATIONS:
        _check.choice(op, "mode", mode, INTERPOLATIONS)
    if padding_mode not in paddings:
        _check.choice(op, "padding_mode", padding_mode, paddings)
    _check.flag(op, "align_corners", align_corners)


def padding_and_fill(
    op: str,
    image: Tensor,
    padding_mode: str,
    fill_value: Any,
    samples: int | None = None,
    interpolation: str | None = None,
) -> tuple[int, Tensor | None]:
    """The padding and the fill as the operators take them, for one sample of each image unless their number is given."""
    if padding_mode in ("border", "reflection"):
        return PADDING[padding_mode], None
    if padding_mode == "zeros" or fill_value is None:
        return PADDING["fill"], None
    dtype = (
        compute_dtype(image)
        if interpolation is None or not nearest.moves_values(image, interpolation)
        else torch.float64
    )
    if not isinstance(fill_value, Tensor):
        fill_value = _check.scalars(op, "fill_value", fill_value)
    for number in fill_value if isinstance(fill_value, (tuple, list)) else (fill_value,):
        if isinstance(number, (int, float)):
            _check.representable(op, "fill_value", number, dtype)
    if isinstance(fill_value, (int, float)):
        fill_value = image.new_full(
            (), float(fill_value), dtype=dtype
        )  # created on the device, without a copy from the host
    elif isinstance(fill_value, (tuple, list)) and all(isinstance(x, (int, float)) for x in fill_value):
        fill_value = constant(tuple(map(float, fill_value)), image, dtype)
    elif not isinstance(fill_value, Tensor):
        fill_value = torch.as_tensor(fill_value, dtype=dtype, device=image.device)
    _check.numbers(op, "fill_value", fill_value)
    fill_value = _check.to_device_of(op, image, "fill_value", fill_value, of="src")
    shape = fill_value.shape
    if len(shape) == 4 and shape[2:] == (1, 1):
        fill_value = fill_value[..., 0, 0]
    elif len(shape) < 2:
        fill_value = fill_value.reshape(1, -1)
    b, c = image.shape[0] if samples is None else samples, image.shape[1]
    if (
        fill_value.dim() != 2
        or not _check.is_one_or(fill_value.shape[0], b)
        or not _check.is_one_or(fill_value.shape[1], c)
    ):
        raise ShapeError(
            f"{op}: expected fill_value of shape (), ({c},) or ({b}, {c}, 1, 1), got {tuple(shape)}", actual_shape=shape
        )
    if interpolation is not None and nearest.moves_values(image, interpolation):
        return PADDING["fill"], nearest.fill_of_values(fill_value, image)
    return PADDING["fill"], as_dtype(fill_value, dtype)


def symbolic_point(image: Tensor, *coordinates: float) -> Tensor:
    """(1, D), symbolic coordinates for the images: a plain argument of an operator would fix their value in the graph."""
    return torch.stack([image.new_full((), value, dtype=compute_dtype(image)) for value in coordinates])[None]


def cast_to_image(op: str, image: Tensor, name: str, x: Tensor, samples: int | None = None) -> Tensor:
    """A matrix or parameter as the operators take it: in the dtype and on the device of the computation, one for all
    samples or one for each.

    There is one sample of each image unless their number is given. Maps, too; their callers check that they are on the
    image's device, since images and maps are not moved.
    """
    x = _check.to_device_of(op, image, name, x, of="image")
    samples = image.shape[0] if samples is None else samples
    if not _check.is_one_or(x.shape[0], samples):
        raise ShapeError(
            f"{op}: expected {name} with a batch size of 1 or {samples}, got {tuple(x.shape)}", actual_shape=x.shape
        )
    return as_dtype(x, compute_dtype(image))


def count_samples(image: Tensor, x: Tensor) -> int:
    """How many samples matrices, maps or boxes `x` make of the images: one of each, or all of a single image."""
    return x.shape[0] if image.shape[0] == 1 else image.shape[0]
