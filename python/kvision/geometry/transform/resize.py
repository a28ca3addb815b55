"""Resampling of images to other sizes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, get_args

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._choices import ResizeInterpolation, ResizeSide
from kvision._clamp import clamp
from kvision._dtype import compute_dtype
from kvision._list_ops import ListOperator
from kvision._modes import BORDER, BORDER_NAMES, INTERPOLATION, INTERPOLATION_NAMES
from kvision._modules import FunctionModule
from kvision._ops import match_layout, register, saturate_to_byte
from kvision._torch_compat import in_onnx_export, is_tracing, largest, smallest
from kvision.color.frames import Frames
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.filters import gaussian_blur2d
from kvision.geometry.transform.frames import resized_frames
from kvision.geometry.transform.lists import arguments as lists
from kvision.geometry.transform.nearest import as_values, of_values

__all__ = ["Rescale", "Resize", "rescale", "resize", "resize_to_be_divisible"]

INTERPOLATIONS = get_args(ResizeInterpolation)
_SIDES = get_args(ResizeSide)

# --- the definition: csrc/geometry/transform/resize/resize.h has it in a table ----------------------------------------

SUPPORT = {"bilinear": 1, "bicubic": 2, "lanczos": 3}  # half of a window's width

# Indices (n, k) and weights (n, k) of the k source pixels of each pixel of the result.
Taps = tuple[Tensor, Tensor]


def resize_reference(input, size, filter, align_corners, antialias, border):
    window, border = INTERPOLATION_NAMES[filter], BORDER_NAMES[border]
    for axis, result in ((2, size[0]), (3, size[1])):
        n = input.shape[axis]
        steps = [_taps("bilinear" if window.startswith("pyr") else window, n, result, align_corners, antialias, input)]
        if window == "pyrdown":
            steps.insert(0, _blur_taps(n, border, input))
        if window == "pyrup":
            steps.append(_blur_taps(result, border, input))
        for taps in steps:
            input = _weighted(input, axis, taps)
    return input


def _weighted(image: Tensor, axis: int, taps: Taps) -> Tensor:
    shape = [1] * image.dim()
    shape[axis] = -1
    total = torch.zeros((), dtype=image.dtype, device=image.device)
    for index, weight in zip(taps[0].unbind(1), taps[1].to(image.dtype).unbind(1)):
        value, weight = image.index_select(axis, index), weight.reshape(shape)
        # A tap of weight 0 contributes nothing, even if it is inf or NaN.
        total = total + weight * torch.where((weight == 0) & ~value.isfinite(), 0.0, value)
    return total


def _taps(window: str, source: int, result: int, align_corners: bool, antialias: bool, like: Tensor) -> Taps:
    """Taps of an axis. Coordinates are fractions of integers, so that the first tap is exact at any size."""
    if antialias and in_onnx_export() and not (type(source) is int and type(result) is int):
        raise NotImplementedError(
            "resize: ONNX of antialias=True needs a fixed height and width, which say how many pixels are averaged; leave "
            "these axes out of dynamic_shapes"
        )
    i = torch.arange(result, device=like.device)[:, None]
    if window in ("nearest", "nearest-exact", "area"):
        first, last = i * source // result, -((i + 1) * -source // result) - 1
        if window != "area":
            first = last = first if window == "nearest" else (2 * i + 1) * source // (2 * result)
        index = first + torch.arange(1 if window != "area" else -(-source // result) + 1, device=like.device)
        weight = (index <= last).to(like.dtype)
        return index.clamp(max=source - 1), weight / weight.sum(1, keepdim=True)
    if not align_corners:
        origin, num, den = source - result, 2 * source, 2 * result
    else:
        origin, num, den = 0, *((source - 1, result - 1) if result > 1 else (0, 1))
    coord = origin + num * i
    unit = max(num, den) if antialias else den
    support = SUPPORT[window]
    first = (coord - support * unit) // den + 1
    index = first + torch.arange(-(-2 * support * unit // den), device=like.device)
    weight = window_weight(window, (index * den - coord).to(like.dtype) / unit, antialias)
    inside = index.clamp(0, source - 1)
    if antialias or window == "lanczos":  # taps out of bounds have weight 0
        weight = torch.where(index == inside, weight, 0.0)
        weight = weight / weight.sum(1, keepdim=True)
    return inside, weight


def window_weight(window: str, x: Tensor, antialias: bool) -> Tensor:
    """The window at a distance x from its center."""
    x = x.abs()
    if window == "bilinear":
        return clamp(1 - x, 0)
    if window == "lanczos":
        # The value is exactly 0 at integers other than 0.
        return torch.where(x == x.round(), (x == 0).to(x.dtype), torch.sinc(x) * torch.sinc(x / 3) * (x < 3))
    a = -0.5 if antialias else -0.75  # as Pillow and OpenCV
    near = ((a + 2) * x - (a + 3)) * x * x + 1
    far = a * (((x - 5) * x + 8) * x - 4)
    return torch.where(x <= 1, near, torch.where(x < 2, far, 0.0))


def _blur_taps(n: int, border: str, like: Tensor) -> Taps:
    """Taps of the kernel 1 4 6 4 1 on an axis of n pixels."""
    d = torch.arange(-2, 3, device=like.device)
    index = torch.arange(n, device=like.device)[:, None] + d
    weight = ((6 - 1.5 * d.abs() - 0.5 * d * d) / 16).to(like.dtype).expand(n, 5)
    inside = index.clamp(0, n - 1)
    if border == "reflect":
        inside = (n - 1 - (n - 1 - index.abs()).abs()).clamp(0, n - 1)
    if border == "constant":
        weight = torch.where(index == inside, weight, 0.0)
    return inside, weight


def _backward_reference(grad, size, *options):
    def f(image: Tensor) -> Tensor:
        return resize_reference(image, grad.shape[2:], *options)

    _, vjp_fn = torch.func.vjp(f, grad.new_zeros(*grad.shape[:2], *size))
    return vjp_fn(grad)[0]


def _size(x, size, *options):
    return (*x.shape[:2], *size)


resized = register(
    "resize",
    resize_reference,
    fake=_size,
    gradients="input: resize_backward(size=sizes(input))",
    linear=True,
    bytes=True,
)
resized_backward = register(
    "resize_backward",
    _backward_reference,
    fake=_size,
    gradients="grad: resize(input=grad_grad, size=sizes(grad))",
    linear=True,
)

# --- lists of images ------------------------------------------------------------------------------------------------

# Arguments: images (C, H, W); height and width of the results, which are then one tensor (B, C, h, w), or of each result; the
# options of `resize`.


def _list_reference(images, size, *options):
    sizes = lists.sizes_of(size, len(images))
    results = [resized.reference(x[None], next(sizes), *options, BORDER["replicate"]) for x in images]
    return lists.collected(results, images[0][None], size)


def _list_backward_reference(grads, size, *options):
    sizes, grads = lists.sizes_of(size, len(size) // 2), lists.samples(grads)
    return [resized_backward.reference(grad, next(sizes), *options, BORDER["replicate"])[0] for grad in grads]


def _list_gradient(needs, grads, images, size, *options):
    return (resized_list_backward(grads, lists.sizes(images), *options),)


def _list_second_gradient(needs, grad_grads, grads, size, *options):
    return (resized_list(grad_grads, lists.shape_of(grads), *options),)


def _fake_list_gradients(grads, size, *options):
    like = lists.samples(grads)[0]
    empty = (like.new_empty(1, like.shape[1], *s) for s in lists.sizes_of(size, len(size) // 2))
    return [match_layout(grad, like)[0] for grad in empty]


resized_list = ListOperator(
    "resize_list",
    resized,
    _list_reference,
    fake=lambda images, size, *options: lists.fake_results(images, size),
    backward=_list_gradient,
)
resized_list_backward = ListOperator(
    "resize_list_backward",
    resized_backward,
    _list_backward_reference,
    fake=_fake_list_gradients,
    backward=_list_second_gradient,
)


def resize_each(
    images: list[Tensor],
    sizes: list[int],
    interpolation: ResizeInterpolation,
    align_corners: bool,
    antialias: bool,
    is_list: bool,
) -> Any:
    """Images resized to one size, or each to one of `sizes`; as a batch unless `is_list`."""
    values, like = lists.as_value_list(images, interpolation), lists.like_batch(images)
    results = resized_list(values, sizes, INTERPOLATION[interpolation], align_corners, antialias)
    return lists.of_value_list(results, like, interpolation, is_list)


# --- functions ------------------------------------------------------------------------------------------------------


def resize(
    input: Tensor | list[Tensor] | Frames,
    size: int | tuple[int, int],
    interpolation: ResizeInterpolation = "bilinear",
    align_corners: bool | None = None,
    side: ResizeSide = "short",
    antialias: bool | str = False,
) -> Tensor:
    """Resample images to a size.

    Args:
        input: images (*, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them. A list of images (C, H, W) may have different sizes. Of video
            :class:`~kvision.color.Frames` 'bilinear' reads the planes, other modes convert them first.
        size: height and width, or one side; the other side then keeps the aspect ratio, rounded down.
        interpolation: 'bilinear', 'bicubic', 'nearest', 'nearest-exact' (the pixel with the nearest center, in whole
            numbers: OpenCV's INTER_NEAREST_EXACT, Pillow and torch round and may read a neighbor), 'area' (means of
            whole pixels), or 'lanczos' (a kernel of 3 pixels to either side, as Pillow).
        align_corners: align the centers of the corner pixels, for 'bilinear', 'bicubic' and 'lanczos'. None or False
            aligns the edges of the images.
        side: the side that an int `size` is: 'short', 'long', 'vert' (height) or 'horz' (width).
        antialias: True scales the kernel of 'bilinear', 'bicubic' and 'lanczos' by the factor that the image shrinks
            by, as torch and Pillow do; 'bicubic' then has their coefficient also where the image does not shrink.
            'gaussian' blurs images that shrink, with sigma (factor - 1) / 2.

    Returns:
        (*, h, w), of the dtype of `input`; uint8 is rounded half to even and saturated. Of a list (B, C, h, w), or a list of
        results if `size` is one side.

    Raises:
        TypeError: `input` is not a tensor of real numbers; `size` is not one or two ints; `align_corners` is not a bool or
            None; `antialias` is not a bool or 'gaussian'.
        ValueError: `input` is not (*, H, W) with H, W of at least 1, or a list without images or of different types,
            devices or numbers of channels; `size` is below 1; `interpolation` or `side` is
            unknown.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.resize(torch.arange(4.0).reshape(1, 4), (1, 2))
        tensor([[0.5000, 2.5000]])
        >>> K.geometry.resize(torch.rand(3, 20, 30), 10).shape
        torch.Size([3, 10, 15])
    """
    return _resize("resize", input, size, interpolation, align_corners, side, antialias)


def _resize(op, input, size, interpolation, align_corners, side, antialias):
    if isinstance(input, list):
        return _resize_list(op, input, size, interpolation, align_corners, side, antialias)
    is_video = isinstance(input, Frames)
    h, w = _size_of_images(op, input._like() if is_video else input)
    _check.choice(op, "interpolation", interpolation, INTERPOLATIONS)
    _check.choice(op, "side", side, _SIDES)
    if antialias != "gaussian":
        _check.flag(op, "antialias", antialias)
    if align_corners is not None:
        _check.flag(op, "align_corners", align_corners)
    if type(size) is not tuple and _check.is_int(size):
        height, width = side_to_size(_check.ints(op, "size", size, 1)[0], h, w, side)
    else:
        height, width = _check.ints(op, "size", size, 2)
    if is_video:
        if interpolation == "bilinear" and antialias != "gaussian":
            return resized_frames(input, (height, width), align_corners or False, antialias)
        input = input.rgb()
    if not (is_compiling() or is_tracing()) and (height, width) == (h, w) and input.is_floating_point():
        return input.clone()  # graphs of any size would be bound not to have this one
    images = (
        input if input.dim() == 4 else input.reshape(-1, *input.shape[-3:]) if input.dim() > 2 else input[None, None]
    )
    if antialias == "gaussian":
        if height < h or width < w:
            images = _blurred(images.to(compute_dtype(images)), h / height, w / width)
        antialias = False
    result = resized(
        as_values(images, interpolation),
        [height, width],
        INTERPOLATION[interpolation],
        align_corners or False,
        antialias,
        BORDER["replicate"],
    )
    result = of_values(result, images, interpolation)
    if input.dtype == torch.uint8 and result.dtype != torch.uint8:
        result = saturate_to_byte(result)
    if result.dim() != input.dim():
        result = result.reshape(*input.shape[:-2], height, width)
    is_promoted = input.is_floating_point() and result.dtype != input.dtype
    return result.to(input.dtype) if is_promoted else result


def _resize_list(op, images, size, interpolation, align_corners, side, antialias):
    images = lists.check_list(op, "input", images)
    _check.choice(op, "interpolation", interpolation, INTERPOLATIONS)
    _check.choice(op, "side", side, _SIDES)
    is_side = type(size) is not tuple and _check.is_int(size)
    if is_side:
        size = _check.ints(op, "size", size, 1)[0]
        sizes = side_to_sizes(size, lists.sizes(images), side)
    else:
        sizes = list(_check.ints(op, "size", size, 2))
    if antialias == "gaussian":
        results = [_resize(op, x, size, interpolation, align_corners, side, antialias) for x in images]
        return results if is_side else torch.stack(results)
    _check.flag(op, "antialias", antialias)
    if align_corners is not None:
        _check.flag(op, "align_corners", align_corners)
    return resize_each(images, sizes, interpolation, align_corners or False, antialias, is_side)


def _size_of_images(op: str, input: Tensor) -> tuple[int, int]:
    _check.numbers(op, "input", input)
    if input.dim() >= 2:
        h, w = _check.sizes_as_numbers(input)[-2:]
        if h != 0 and w != 0:
            return h, w
    raise ShapeError(
        f"{op}: expected input of shape (*, H, W) with H, W of at least 1, got {tuple(input.shape)}",
        actual_shape=input.shape,
    )


def side_to_size(size: int, h: int, w: int, side: ResizeSide) -> tuple[int, int]:
    """Height and width of a result with one side of length `size`, and the aspect of an image h x w."""
    # Computed in floats, as in Kornia: products are rounded down. A side next to a short one is at least `size`.
    height, width = math.trunc(size / (w / h)), math.trunc(size * (w / h))
    most, least = (max, min) if type(height) is int and type(width) is int else (largest, smallest)
    if side == "short":
        return most(size, height), most(size, width)
    if side == "long":
        return least(size, most(1, height)), least(size, most(1, width))
    return (size, most(1, width)) if side == "vert" else (most(1, height), size)


_known_size = lru_cache(4096)(side_to_size)


def side_to_sizes(size: int, sides: Sequence[int], side: ResizeSide) -> list[int]:
    """The same of a list, from height and width of each image."""
    own = _known_size if {*map(type, sides)} == {int} else side_to_size  # symbols are not kept
    return [n for h, w in zip(sides[::2], sides[1::2]) for n in own(size, h, w, side)]


def _blurred(x: Tensor, *factors: float) -> Tensor:
    sigmas = [max((factor - 1) / 2, 0.001) for factor in factors]
    sizes = [int(max(4 * sigma, 3)) // 2 * 2 + 1 if n > 1 else 1 for sigma, n in zip(sigmas, x.shape[2:])]
    return gaussian_blur2d(x, (sizes[0], sizes[1]), (sigmas[0], sigmas[1]))


def rescale(
    input: Tensor,
    factor: float | tuple[float, float],
    interpolation: ResizeInterpolation = "bilinear",
    align_corners: bool | None = None,
    antialias: bool | str = False,
) -> Tensor:
    """Resample images to a multiple of their size, rounded down.

    Args:
        input: images (*, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them.
        factor: one factor for both sides, or (height, width).
        interpolation: 'bilinear', 'bicubic', 'nearest', 'nearest-exact', 'area' or 'lanczos'; see :func:`resize`.
        align_corners: align the centers of the corner pixels, not the edges of the images; see :func:`resize`.
        antialias: True, False or 'gaussian'; see :func:`resize`.

    Returns:
        (*, h, w), of the dtype of `input`.

    Raises:
        TypeError: `input` is not a tensor of real numbers; `factor` is not one or two numbers; `align_corners` is not a bool
            or None; `antialias` is not a bool or 'gaussian'.
        ValueError: `input` is not (*, H, W) with H, W of at least 1; a factor is negative; a side of the result would
            be 0; `interpolation` is unknown.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.rescale(torch.rand(1, 3, 5, 8), (0.5, 2.0)).shape
        torch.Size([1, 3, 2, 16])
    """
    return _rescale(input, factor, interpolation, align_corners, antialias)


def _rescale(input, factor, interpolation, align_corners, antialias):
    _size_of_images("rescale", input)
    factors = factor if isinstance(factor, (tuple, list)) else (factor, factor)
    if len(factors) != 2:
        raise TypeCheckError(f"rescale: expected factor to be a number or two, got {factor!r}")
    y, x = (_check.number("rescale", "factor", f, minimum=0) for f in factors)
    if math.inf in (y, x):
        raise ValueCheckError(f"rescale: expected a finite factor, got {factor!r}", actual_value=factor)
    h, w = _check.sizes_as_numbers(input)[-2:]
    size = (math.trunc(h * y), math.trunc(w * x))
    if 0 in size:
        raise ValueCheckError(f"rescale: expected factor to leave a pixel of {tuple(input.shape[-2:])}, got {factor!r}")
    return _resize("rescale", input, size, interpolation, align_corners, "short", antialias)


def resize_to_be_divisible(
    input: Tensor,
    divisible_factor: int,
    interpolation: ResizeInterpolation = "bilinear",
    align_corners: bool | None = None,
    side: ResizeSide = "short",
    antialias: bool | str = False,
) -> Tensor:
    """Resample images so that both sides are the nearest multiples of a number, at least one multiple.

    Args:
        input: images (*, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them.
        divisible_factor: the number that divides both sides of the result, at least 1.
        interpolation: 'bilinear', 'bicubic', 'nearest', 'nearest-exact', 'area' or 'lanczos'; see :func:`resize`.
        align_corners: align the centers of the corner pixels, not the edges of the images; see :func:`resize`.
        side: no effect on the result, which has a height and a width.
        antialias: True, False or 'gaussian'; see :func:`resize`.

    Returns:
        (*, h, w), of the dtype of `input`.

    Raises:
        TypeError: `input` is not a tensor of real numbers; `divisible_factor` is not an int; `align_corners` is not a bool or
            None; `antialias` is not a bool or 'gaussian'.
        ValueError: `input` is not (*, H, W) with H, W of at least 1; `divisible_factor` is below 1; `interpolation` or
            `side` is unknown.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.resize_to_be_divisible(torch.rand(1, 3, 37, 50), 16).shape
        torch.Size([1, 3, 32, 48])
    """
    op = "resize_to_be_divisible"
    _size_of_images(op, input)
    (n,) = _check.ints(op, "divisible_factor", divisible_factor, 1)
    h, w = (max(1, round(side / n)) * n for side in _check.sizes_as_numbers(input)[-2:])
    return _resize(op, input, (h, w), interpolation, align_corners, side, antialias)


class Resize(FunctionModule):
    """Module form of :func:`resize`.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.Resize((4, 6))(torch.rand(1, 3, 8, 8)).shape
        torch.Size([1, 3, 4, 6])
    """

    def __init__(
        self,
        size: int | tuple[int, int],
        interpolation: ResizeInterpolation = "bilinear",
        align_corners: bool | None = None,
        side: ResizeSide = "short",
        antialias: bool | str = False,
    ) -> None:
        super().__init__(
            size=size, interpolation=interpolation, align_corners=align_corners, side=side, antialias=antialias
        )

    def forward(self, input: Tensor) -> Tensor:
        return resize(input, self.size, self.interpolation, self.align_corners, self.side, self.antialias)


class Rescale(FunctionModule):
    """Module form of :func:`rescale`; the default of `align_corners` is True here.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.Rescale(0.5)(torch.rand(1, 3, 8, 8)).shape
        torch.Size([1, 3, 4, 4])
    """

    def __init__(
        self,
        factor: float | tuple[float, float],
        interpolation: ResizeInterpolation = "bilinear",
        align_corners: bool = True,
        antialias: bool | str = False,
    ) -> None:
        super().__init__(factor=factor, interpolation=interpolation, align_corners=align_corners, antialias=antialias)

    def forward(self, input: Tensor) -> Tensor:
        return rescale(input, self.factor, self.interpolation, self.align_corners, self.antialias)
