"""Frames of video decoders and encoders: luma and chroma planes of codes, to RGB and back, whole, resized or warped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._constants import constant
from kvision._modes import CHROMA_SITE, DTYPE
from kvision._ops import register, saturate_to_byte
from kvision.color.steps import NAMES, STEPS
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.core.windows import windows_of

__all__ = ["Frames", "frames_to_rgb", "resize_frames", "rgb_to_frames", "warp_frames"]

Matrix: TypeAlias = Literal["bt601", "bt709", "bt2020"]
Layout: TypeAlias = Literal["nv12", "nv21", "i420", "yuy2", "p010"]
_LAYOUTS = get_args(Layout)
ColorRange: TypeAlias = Literal["limited", "full"]
_RANGES = get_args(ColorRange)
Chroma: TypeAlias = Literal["nearest", "linear"]
_CHROMAS = get_args(Chroma)
Siting: TypeAlias = Literal["left", "center", "topleft"]
# The shares of red and blue in luma (ITU-R BT.601-7, BT.709-6, BT.2020-2 with non-constant luminance).
_LUMA: dict[Matrix, tuple[float, float]] = {
    "bt601": (0.299, 0.114),
    "bt709": (0.2126, 0.0722),
    "bt2020": (0.2627, 0.0593),
}
_DTYPES = tuple(getattr(torch, name) for name in DTYPE)

# The weight of luma pixels 2 c - 1 to 2 c + 2 for chroma sample c along an axis, by where the sample is: `nearest` repeats it,
# `cosited` samples are at pixel 2 c, `between` ones in the middle of pixels 2 c and 2 c + 1.
_NEAREST, _COSITED, _BETWEEN = CHROMA_SITE.values()
# Where chroma is along x and y.
_SITES: dict[Siting, tuple[int, int]] = {
    "left": (_COSITED, _BETWEEN),
    "center": (_BETWEEN, _BETWEEN),
    "topleft": (_COSITED, _COSITED),
}
# How boxes are read: as they are, or antialiased. So are matrices as windows of whole pixels, by their edges or by the centers of
# their outermost pixels.
_PLAIN, _ANTIALIASED, _CENTERS = 0, 1, 2


class Reading(NamedTuple):
    """How a map is read."""

    windows: int = _PLAIN
    from_result: bool = False  # matrices are from pixels of the result to those of the frame
    nearest: bool = False  # matrices take the nearest pixel
    border: bool = False  # which continues outside, for matrices


PLAINLY = Reading()


# --- the operator ----------------------------------------------------------------------------------------------------


def _upsampled(x: Tensor, size: int, dim: int, kind: int) -> Tensor:
    """Chroma along an axis at all `size` luma pixels of it. Made of slices, so that gradients add up in one order."""
    count = x.shape[dim]
    if count == size:
        return x
    even = odd = x
    if kind != _NEAREST:
        after = torch.cat([x.narrow(dim, 1, count - 1), x.narrow(dim, count - 1, 1)], dim)
        odd = x + (after - x) * (0.5 if kind == _COSITED else 0.25)
    if kind == _BETWEEN:
        before = torch.cat([x.narrow(dim, 0, 1), x.narrow(dim, 0, count - 1)], dim)
        even = before + (x - before) * 0.75
    return torch.stack([even, odd], dim + 1).flatten(dim, dim + 1).narrow(dim, 0, size)


def _windows(axis: tuple[Tensor, ...], count: int, size: int, antialias: bool) -> Tensor:
    """The weights (B, count, size) of an axis of `size` pixels for `count` pixels of the interval from start to end, (B,).

    Only pixels within bounds count, the third and the fourth of `axis`, or those that the interval touches.
    """
    start, end, *bounds = axis
    if bounds:
        low, high = (bound.to(start.dtype)[:, None] for bound in bounds)
    else:
        low, high = torch.minimum(start, end).detach().floor(), torch.maximum(start, end).detach().ceil()
        low = low.nan_to_num(0.0).clamp(0, size - 1)[:, None]
        high = torch.maximum(high.nan_to_num(0.0).clamp(0, size)[:, None], low + 1)
    scale = ((end - start) / count)[:, None]
    support = scale.abs().clamp(min=1.0) if antialias else torch.ones_like(scale)
    steps = torch.arange(count, device=start.device, dtype=start.dtype) + 0.5
    center = torch.minimum(torch.maximum(start[:, None] + steps * scale, low + 0.5), high - 0.5)
    pixels = torch.arange(size, device=start.device, dtype=start.dtype)
    distance = (pixels + 0.5 - center[..., None]) / support[..., None]
    inside = (pixels >= low[..., None]) & (pixels < high[..., None])
    weights = torch.where(inside, (1 - distance.abs()).clamp(min=0.0), 0.0)
    return weights / weights.sum(-1, keepdim=True)


def _axis_of_windows(
    matrix: Tensor, axis: int, source: int, count: int, align_corners: bool, dtype: torch.dtype
) -> tuple[Tensor, ...]:
    """The interval of an axis (0: x, 1: y) that a window is, and its pixels."""
    first, size, mirrored = windows_of(matrix, axis, source, count, align_corners)
    low, high = first.to(dtype), (first + size).to(dtype)
    pixel = (high - low) / count
    if align_corners:
        pixel = (high - low - 1) / (count - 1) if count > 1 else torch.ones_like(low)
    margin = (1 - pixel) / 2 if align_corners else torch.zeros_like(pixel)
    start, step = torch.where(mirrored, high - margin, low + margin), torch.where(mirrored, -pixel, pixel)
    return start, start + count * step, low, high


def _tents(position: Tensor, size: int) -> tuple[tuple[Tensor, Tensor], ...]:
    """Index and weight of the two pixels around a position, 0 outside of the axis."""
    first = position.detach().floor()

    def tap(pixel: Tensor) -> tuple[Tensor, Tensor]:
        inside = (pixel >= 0) & (pixel < size)
        weight = torch.where(inside, 1 - (position - pixel).abs(), 0.0)
        return torch.where(inside, pixel, 0.0).long(), weight

    return tap(first), tap(first + 1)


def _warped(
    yuv: Tensor, matrix: Tensor, height: int, width: int, is_inverse: int, nearest: int, border: int
) -> tuple[Tensor, Tensor]:
    """Planes (B, 3, height, width) at the sources of the result's pixels, and the share of these that is in the frame."""
    if matrix.shape[1] == 2:
        matrix = F.pad(matrix, (0, 0, 0, 1)) + constant(((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), matrix)
    a, b, c = matrix.unbind(1)
    adjugate = torch.stack([torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], 2)
    determinant = (a * adjugate[..., 0]).sum(1)[:, None, None]
    inverse = matrix if is_inverse else torch.where(determinant == 0, torch.nan, adjugate)
    xs, ys = (torch.arange(n, device=yuv.device, dtype=yuv.dtype) for n in (width, height))
    grid = torch.stack([xs.expand(height, width), ys[:, None].expand(height, width), yuv.new_ones(height, width)])
    x, y, z = (inverse @ grid.flatten(1)).unbind(1)
    x, y = x / z, y / z
    if nearest:
        x, y = x.round(), y.round()
    if border:
        x, y = x.clamp(0, yuv.shape[3] - 1), y.clamp(0, yuv.shape[2] - 1)
    batch = max(yuv.shape[0], matrix.shape[0]) if yuv.shape[0] else 0
    planes = yuv.flatten(2).expand(batch, -1, -1)
    values, inside = yuv.new_zeros(()), yuv.new_zeros(())
    for row, of_row in _tents(y, yuv.shape[2]):
        for column, of_column in _tents(x, yuv.shape[3]):
            index = (row * yuv.shape[3] + column)[:, None].expand(batch, 3, -1)
            weight = of_row * of_column
            values = values + planes.gather(2, index) * weight[:, None]
            inside = inside + weight
    return values.unflatten(2, (height, width)), inside[:, None].expand(batch, 1, -1).unflatten(2, (height, width))


def _reference(
    y: Tensor, u: Tensor, v: Tensor, map: Tensor | None, plan: Sequence[int], numbers: Sequence[float]
) -> Tensor:
    height, width, dtype_number, along_x, along_y, kind, *options = plan
    if not height:
        height, width = y.shape[1:]
    dtype = _DTYPES[dtype_number]
    wide = torch.float64 if torch.float64 in (dtype, y.dtype) else torch.float32
    whole = (_upsampled(_upsampled(c.to(wide), y.shape[1], 1, along_y), y.shape[2], 2, along_x) for c in (u, v))
    yuv = torch.stack(torch.broadcast_tensors(y.to(wide), *whole), 1)
    inside: Tensor | float = 1.0
    if map is None and (height, width) != yuv.shape[2:]:
        map = torch.cat(
            [yuv.new_zeros(1, 2), yuv.new_full((1, 1), yuv.shape[3]), yuv.new_full((1, 1), yuv.shape[2])], 1
        )
    if map is not None and (map.dim() == 2 or kind != _PLAIN):
        sizes, counts = (yuv.shape[3], yuv.shape[2]), (width, height)
        if map.dim() == 2:
            x1, y1, x2, y2 = map.to(wide).unbind(1)
            axes: list[tuple[Tensor, ...]] = [(x1, x2), (y1, y2)]
        else:
            axes = [_axis_of_windows(map, i, sizes[i], counts[i], kind == _CENTERS, wide) for i in range(2)]
        columns, rows = (_windows(axes[i], counts[i], sizes[i], kind != _PLAIN) for i in range(2))
        yuv = rows[:, None] @ yuv @ columns[:, None].mT
    elif map is not None:
        yuv, inside = _warped(yuv, map.to(wide), height, width, *options)
    luma, blue, red = yuv.unbind(1)
    matrix, (offset, bias, low, high) = numbers[:9], (numbers[i : i + 3] for i in (9, 12, 15, 18))
    inside = inside if isinstance(inside, float) else inside[:, 0]
    colors = []
    for k in range(3):
        color = luma * matrix[3 * k] + blue * matrix[3 * k + 1] + red * matrix[3 * k + 2]
        colors.append((color + inside * offset[k] + bias[k]).clamp(low[k], high[k]))
    rgb = torch.stack(colors, 1)
    return saturate_to_byte(rgb) if dtype == torch.uint8 else rgb.to(dtype)


def _fake(y: Tensor, u: Tensor, v: Tensor, map: Tensor | None, plan: Sequence[int], numbers: Sequence[float]) -> Tensor:
    batch = y.shape[0] if map is None or y.shape[0] != 1 else map.shape[0]
    height, width = plan[:2] if plan[0] else y.shape[1:]
    return y.new_empty((batch, 3, height, width), dtype=_DTYPES[plan[2]])


def _backward_reference(
    grad: Tensor,
    result: Tensor,
    y: Tensor,
    u: Tensor,
    v: Tensor,
    map: Tensor | None,
    plan: Sequence[int],
    numbers: Sequence[float],
) -> tuple[Tensor, ...]:
    # Clamped are results that equal a bound as they are stored.
    bounds = (constant(tuple(numbers[i : i + 3]), grad, _DTYPES[plan[2]]).to(grad.dtype) for i in (15, 18))
    low, high = (bound.view(3, 1, 1) for bound in bounds)
    taken = torch.where((result > low) & (result < high), grad, 0.0)
    unbounded = [*numbers[:15], *[-math.inf] * 3, *[math.inf] * 3]
    own_plan = [*plan[:2], _DTYPES.index(grad.dtype), *plan[3:]]

    def colors(y: Tensor, u: Tensor, v: Tensor) -> Tensor:
        return _reference(y, u, v, map, own_plan, unbounded)

    pulled_back: Any = torch.func.vjp(colors, *(x.expand(grad.shape[0], -1, -1) for x in (y, u, v)))
    return tuple(pulled_back[1](taken))


def _backward_sizes(grad: Tensor, result: Tensor, *planes: Any) -> list[Sequence[Any]]:
    return [(grad.shape[0], *x.shape[1:]) for x in planes[:3]]


def _kernel_serves(y: Tensor, *args: Any) -> str | None:
    """Frames have at least one pixel, and there is at least one frame."""
    return None if y.numel() else f"there is no kernel for empty tensors, here {tuple(y.shape)}"


# RGB (B, 3, h, w) of the planes y (B, H, W), u and v (B, (H + 1) // 2 or H, (W + 1) // 2 or W): the whole frame, or that part of
# it that `map` says, by boxes (B, 4) or by matrices (B, 2, 3) or (B, 3, 3) from pixels of the frame to those of the result.
# `plan` holds height and width of the result, 0 for those of the frame, its DType, the sites of chroma along x and y and a
# Reading of the map. `numbers` are the color matrix, its offset, the bias, the lowest and the highest colors.
_planes_to_rgb = register(
    "planes_to_rgb",
    _reference,
    fake=_fake,
    gradients="y, u, v: planes_to_rgb_backward(result=detach(result)); map: reference",
    bytes=True,
    uint16=True,
    casts_outputs=True,
    supports=_kernel_serves,
)
# What planes gave to colors that were not clamped, (B, H, W) for each of them.
_planes_to_rgb_backward = register(
    "planes_to_rgb_backward", _backward_reference, fake=_backward_sizes, supports=_kernel_serves
)


# --- what the codes mean ---------------------------------------------------------------------------------------------


def _codes(layout: Layout, color_range: ColorRange, dtype: torch.dtype) -> tuple[float, float, float, float, float]:
    """Of stored codes: black, white minus black, gray of chroma, the width of chroma, the largest code; y = (code - black) / ..."""
    bits = 10 if layout == "p010" else 8
    step = 1 << (bits - 8)
    largest = float((1 << bits) - 1)
    black, luma, chroma = (16 * step, 219 * step, 224 * step) if color_range == "limited" else (0, largest, largest)
    unit = 64.0 if layout == "p010" else 1.0 if dtype == torch.uint8 else 1 / 255
    return black * unit, luma * unit, (128 * step) * unit, chroma * unit, largest * unit


def _rgb_of_ycc(matrix: Matrix) -> list[list[float]]:
    """RGB of luma in [0, 1] and chroma in [-0.5, 0.5]."""
    red, blue = _LUMA[matrix]
    green = 1 - red - blue
    of_red, of_blue = 2 * (1 - red), 2 * (1 - blue)
    return [[1.0, 0.0, of_red], [1.0, -blue * of_blue / green, -red * of_red / green], [1.0, of_blue, 0.0]]


def _ycc_of_rgb(matrix: Matrix) -> list[list[float]]:
    red, blue = _LUMA[matrix]
    green = 1 - red - blue
    of_red, of_blue = 2 * (1 - red), 2 * (1 - blue)
    return [
        [red, green, blue],
        [-red / of_blue, -green / of_blue, 0.5],
        [0.5, -green / of_red, -blue / of_red],
    ]


def _color_numbers(
    codes: tuple[float, ...], matrix: Matrix, factors: Sequence[float], shifts: Sequence[float]
) -> list[float]:
    """The numbers of the operator: conversion, and then factors and shifts of colors in [0, 1], are one affine map."""
    black, luma, gray, chroma, _ = codes
    weights, offsets = [], []
    for row, factor in zip(_rgb_of_ycc(matrix), factors):
        of_codes = [w * factor / width for w, width in zip(row, (luma, chroma, chroma))]
        weights += of_codes
        offsets.append(-sum(f * zero for f, zero in zip(of_codes, (black, gray, gray))))
    bounds = [sorted((shift, factor + shift)) for factor, shift in zip(factors, shifts)]
    return [*weights, *offsets, *shifts, *(low for low, _ in bounds), *(high for _, high in bounds)]


def affine_of(
    steps: Sequence[int], columns: Sequence[int], numbers: Sequence[float]
) -> tuple[list[float], list[float]] | None:
    """Factors and shifts of the channels that the steps of a color program are; None if they are more, or not numbers."""
    if any(column >= 0 for column in columns):
        return None
    factors, shifts, at = [1.0] * 3, [0.0] * 3, 0
    for step in steps:
        name, count = NAMES[step], STEPS[NAMES[step]].parameters
        own, at = list(numbers[at : at + count]), at + count
        channels = 3 if name.endswith("_rgb") else 1
        first, second = ((own[i * channels : (i + 1) * channels] * (3 // channels)) for i in range(2))
        if name in ("standardize", "standardize_rgb") and all(second):
            factor, shift = [1 / s for s in second], [-m / s for m, s in zip(first, second)]
        elif name in ("scale_shift", "scale_shift_rgb") and not own[-1]:
            factor, shift = first, second
        else:
            return None
        factors = [f * g for f, g in zip(factors, factor)]
        shifts = [s * g + t for s, g, t in zip(shifts, factor, shift)]
    return factors, shifts


# --- layouts ---------------------------------------------------------------------------------------------------------


def _whole_frame(op: str, x: Tensor, shape: torch.Size, layout: Layout) -> tuple[Tensor, Tensor, Tensor]:
    """The planes of frames (B, rows, W) in one tensor, which was passed in a `shape` with B or without it."""
    rows, width = x.shape[-2:]
    height = rows * 2 // 3
    if height + (height + 1) // 2 != rows or height == 0 or width % 2 or (layout == "i420" and height % 2):
        raise ShapeError(
            f"{op}: expected planes of layout {layout!r} of shape (B, 3 H / 2, W) with even W"
            f"{' and H' if layout == 'i420' else ''}, or luma and chroma as a tuple, got {tuple(shape)}",
            actual_shape=shape,
        )
    y, chroma = x[:, :height], x[:, height:]
    if (
        layout == "i420"
    ):  # each chroma plane is (H / 2, W / 2), one after the other: two of its rows in one of the tensor
        u, v = chroma.reshape(x.shape[0], 2, height // 2, width // 2).unbind(1)
        return y, u, v
    u, v = chroma.unflatten(2, (width // 2, 2)).unbind(3)
    return y, u, v


def _planes(op: str, planes: Any, layout: Layout, size: Any) -> tuple[Tensor, Tensor, Tensor, bool]:
    """y (B, H, W), u and v of the displayed part of frames, as views, and whether it is one frame without a batch."""
    _check.choice(op, "layout", layout, _LAYOUTS)
    parts = tuple(planes) if isinstance(planes, (tuple, list)) else (planes,)
    if not parts or not all(isinstance(x, Tensor) for x in parts):
        got = type(planes).__name__
        raise TypeCheckError(f"{op}: expected planes to be a Tensor or a tuple of Tensors, got {got}")
    for x in parts:
        _check.is_tensor(op, "planes", x)
    expected = torch.uint16 if layout == "p010" else None
    for x in parts:
        right = x.dtype == torch.uint16 if layout == "p010" else x.is_floating_point() or x.dtype == torch.uint8
        if not right or x.dtype != parts[0].dtype:
            kind = "torch.uint16" if expected else "torch.uint8 or one floating-point type"
            got = ", ".join(str(p.dtype) for p in parts)
            raise TypeCheckError(f"{op}: expected planes of layout {layout!r} to be {kind}, got {got}")
    _check.same_device(op, **{f"plane {i}": x for i, x in enumerate(parts)})
    three, packed = layout == "i420", layout == "yuy2"
    counts = (1,) if packed else (1, 3 if three else 2)
    if len(parts) not in counts:
        named = "one tensor" if packed else "one tensor or (y, u, v)" if three else "one tensor or (y, uv)"
        raise ShapeError(f"{op}: expected planes of layout {layout!r} as {named}, got {len(parts)} tensors")
    if len(parts) == 1:
        (x,) = parts
        trailing = 3 if packed else 2
        if x.dim() not in (trailing, trailing + 1) or 0 in x.shape[x.dim() - trailing :]:
            shape = "(B, H, W, 2)" if packed else "(B, 3 H / 2, W)"
            raise ShapeError(
                f"{op}: expected planes of layout {layout!r} of shape {shape}, got {tuple(x.shape)}",
                actual_shape=x.shape,
            )
        single = x.dim() == trailing
        x = x[None] if single else x
        if packed:  # Y0 U Y1 V
            if x.shape[3] != 2 or x.shape[2] % 2:
                raise ShapeError(
                    f"{op}: expected planes of layout 'yuy2' of shape (B, H, W, 2) with even W, got {tuple(parts[0].shape)}",
                    actual_shape=parts[0].shape,
                )
            y, (u, v) = x[..., 0], x[..., 1].unflatten(2, (x.shape[2] // 2, 2)).unbind(3)
        else:
            y, u, v = _whole_frame(op, x, parts[0].shape, layout)
    else:
        y, *chroma = parts
        single = y.dim() == 2
        y = y[None] if single else y.squeeze(1) if y.dim() == 4 and y.shape[1] == 1 else y
        if y.dim() != 3 or 0 in y.shape[1:]:
            raise ShapeError(
                f"{op}: expected y of shape (B, 1, H, W), (B, H, W) or (H, W), got {tuple(parts[0].shape)}"
            )
        batch, half = y.shape[0], ((y.shape[1] + 1) // 2, (y.shape[2] + 1) // 2)
        if single:
            chroma = [c[None] for c in chroma]
        if three:
            chroma = [c.squeeze(1) if c.dim() == 4 and c.shape[1] == 1 else c for c in chroma]
        wanted = (batch, *half) if three else (batch, *half, 2)
        for c, part in zip(chroma, parts[1:]):
            if tuple(c.shape) != wanted:
                raise ShapeError(
                    f"{op}: expected chroma of shape {wanted[1:] if single else wanted} for y of shape "
                    f"{tuple(parts[0].shape)}, got {tuple(part.shape)}",
                    actual_shape=part.shape,
                )
        u, v = chroma if three else chroma[0].unbind(3)
    if layout == "nv21":
        u, v = v, u
    if size is not None:
        height, width = _check.ints(op, "size", size, 2)
        if height > y.shape[1] or width > y.shape[2]:
            raise ShapeError(f"{op}: expected size within the frame of {tuple(y.shape[1:])}, got {(height, width)}")
        rows = height if packed else (height + 1) // 2
        y, u, v = y[:, :height, :width], u[:, :rows, : (width + 1) // 2], v[:, :rows, : (width + 1) // 2]
    return y, u, v, single


def _check_colors(op: str, matrix: Any, color_range: Any, chroma: Any, siting: Any) -> tuple[int, int]:
    """The sites of chroma along x and y."""
    _check.choice(op, "matrix", matrix, tuple(_LUMA))
    _check.choice(op, "color_range", color_range, _RANGES)
    _check.choice(op, "chroma", chroma, _CHROMAS)
    _check.choice(op, "siting", siting, tuple(_SITES))
    return (_NEAREST, _NEAREST) if chroma == "nearest" else _SITES[siting]


def _per_channel(op: str, name: str, value: Any, default: float) -> list[float]:
    if value is None:
        return [default] * 3
    if isinstance(value, (tuple, list)):
        if len(value) != 3:
            raise ValueCheckError(f"{op}: expected {name} to be a number or three of them, got {value!r}")
        return [_check.number(op, name, v) for v in value]
    return [_check.number(op, name, value)] * 3


# --- frames ----------------------------------------------------------------------------------------------------------


class Frames:
    """Frames of a video decoder in place of the images that they are: what reads them converts them.

    They are read where they are, without RGB of their size, by :func:`kvision.geometry.resize`, `center_crop`,
    `crop_and_resize`, `warp_affine` and `warp_perspective` where these are bilinear, and by augmentations and containers
    whose first step is such a crop, resize or warp; a normalization right behind it is part of that launch. All others
    begin with :meth:`rgb`. The results are those of RGB images that are not clamped before they are resampled, but once,
    behind it.

    Args:
        planes: as :func:`frames_to_rgb` takes them, like the other arguments.
        layout: 'nv12', 'nv21', 'i420', 'yuy2' or 'p010'.
        matrix: 'bt601', 'bt709' or 'bt2020'.
        color_range: 'limited' or 'full'.
        chroma: 'nearest' or 'linear'.
        siting: 'left', 'center' or 'topleft'.
        size: height and width to display.
        dtype: of the images: uint8, or a floating-point type for colors in [0, 1]. Default: uint8 for uint8 planes, that of
            floating-point planes, float32 for uint16.

    Attributes:
        shape: (B, 3, H, W), or (3, H, W) without B.
        dtype: of the images.
        device: of the planes.

    Raises:
        TypeError, ValueError: as :func:`frames_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> nv12 = torch.full((2, 1620, 1920), 128, dtype=torch.uint8)
        >>> frames = K.color.Frames(nv12, matrix="bt709", dtype=torch.float16)
        >>> frames
        Frames((2, 3, 1080, 1920), 'nv12', dtype=torch.float16)
        >>> crop, normalize = K.augmentation.RandomResizedCrop((224, 224)), K.augmentation.Normalize(0.5, 0.5)
        >>> K.augmentation.ImageSequential(crop, K.augmentation.RandomHorizontalFlip(), normalize)(frames).shape
        torch.Size([2, 3, 224, 224])
    """

    def __init__(
        self,
        planes: Tensor | Sequence[Tensor],
        layout: Layout = "nv12",
        *,
        matrix: Matrix = "bt601",
        color_range: ColorRange = "limited",
        chroma: Chroma = "nearest",
        siting: Siting = "left",
        size: tuple[int, int] | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        self._set("Frames", planes, layout, matrix, color_range, chroma, siting, size, dtype)

    @classmethod
    def _of(cls, op: str, *arguments: Any) -> Frames:
        """Those of a function, whose errors say its name."""
        frames = cls.__new__(cls)
        frames._set(op, *arguments)
        return frames

    def _set(
        self,
        op: str,
        planes: Any,
        layout: Layout,
        matrix: Matrix,
        color_range: ColorRange,
        chroma: Chroma,
        siting: Siting,
        size: Any,
        dtype: torch.dtype | None,
    ) -> None:
        self._sites = _check_colors(op, matrix, color_range, chroma, siting)
        self._y, self._u, self._v, self.is_single = _planes(op, planes, layout, size)
        if dtype is not None and (not isinstance(dtype, torch.dtype) or dtype not in _DTYPES):
            raise TypeCheckError(f"{op}: expected dtype to be torch.uint8 or a floating-point type, got {dtype!r}")
        stored = self._y.dtype
        self.dtype = dtype or (torch.float32 if stored == torch.uint16 else stored)
        self.layout, self._matrix = layout, matrix
        self._codes = _codes(layout, color_range, stored)

    @property
    def shape(self) -> torch.Size:
        batch, height, width = self._y.shape
        return torch.Size((3, height, width) if self.is_single else (batch, 3, height, width))

    @property
    def device(self) -> torch.device:
        return self._y.device

    @property
    def computed(self) -> torch.dtype:
        """The type of colors that are not rounded."""
        return torch.float64 if torch.float64 in (self.dtype, self._y.dtype) else torch.float32

    def __len__(self) -> int:
        return self.shape[0]

    def __repr__(self) -> str:
        return f"Frames({tuple(self.shape)}, {self.layout!r}, dtype={self.dtype})"

    def rgb(self) -> Tensor:
        """The images, (B, 3, H, W) or (3, H, W)."""
        rgb = self._read(None, None)
        return rgb[0] if self.is_single else rgb

    def _like(self) -> Tensor:
        """Images of their shape, type and device without values."""
        return self._y.new_empty(1, dtype=self.dtype).expand(self.shape)

    def _read(
        self,
        map: Tensor | None,
        dsize: tuple[int, int] | None,
        reading: Reading = PLAINLY,
        factors: Sequence[float] = (1.0, 1.0, 1.0),
        shifts: Sequence[float] = (0.0, 0.0, 0.0),
        dtype: torch.dtype | None = None,
    ) -> Tensor:
        """What a map takes of the frames, as the operator says; colors in [0, 1] times factors, plus shifts; a batch always."""
        y, dtype = self._y, dtype or self.dtype
        # Planes of floats give their own type, which is then converted: kernels of all pairs of types are not worth their size.
        stored = y.dtype if y.is_floating_point() else dtype
        if map is not None:
            map = map.to(torch.float64 if stored == torch.float64 else torch.float32)
        levels = 255.0 if dtype == torch.uint8 else 1.0
        scaled = ([value * levels for value in values] for values in (factors, shifts))
        numbers = _color_numbers(self._codes, self._matrix, *scaled)
        plan = [*(dsize or (0, 0)), _DTYPES.index(stored), *self._sites, *(int(option) for option in reading)]
        rgb: Tensor = _planes_to_rgb(y, self._u, self._v, map, plan, numbers)
        if stored != dtype:
            rgb = saturate_to_byte(rgb) if dtype == torch.uint8 else rgb.to(dtype)
        return rgb

    def _map_of(self, op: str, name: str, map: Tensor) -> Tensor:
        """A map on the device of the frames, if there is one of each, one for all, or one frame."""
        map = _check.to_device_of(op, self._y, name, map, "planes")
        count = self._y.shape[0]
        if map.shape[0] not in (1, count) and count != 1:
            raise ShapeError(f"{op}: expected one row of {name} for each of {count} frames, got {tuple(map.shape)}")
        return map


def _run(
    op: str,
    planes: Any,
    map: Tensor | None,
    dsize: Any,
    layout: Layout,
    matrix: Matrix,
    color_range: ColorRange,
    chroma: Chroma,
    siting: Siting,
    size: Any,
    mean: Any,
    std: Any,
    dtype: torch.dtype | None,
    antialias: bool = False,
) -> Tensor:
    frames = Frames._of(op, planes, layout, matrix, color_range, chroma, siting, size, dtype)
    means, deviations = _per_channel(op, "mean", mean, 0.0), _per_channel(op, "std", std, 1.0)
    if min(deviations) <= 0:
        raise ValueCheckError(f"{op}: expected std above 0, got {std!r}", actual_value=std)
    normalizes = mean is not None or std is not None
    if dtype is None and normalizes and frames.dtype == torch.uint8:
        dtype = torch.float32
    if dtype == torch.uint8 and normalizes:
        raise TypeCheckError(f"{op}: expected a floating-point dtype of normalized colors, got {dtype}")
    sizes: Any = None if dsize is None else _check.ints(op, "dsize", dsize, 2)
    if map is not None:
        map = frames._map_of(op, "matrices" if map.dim() == 3 else "boxes", map)
    factors, shifts = [1 / s for s in deviations], [-m / s for m, s in zip(means, deviations)]
    rgb = frames._read(map, sizes, Reading(_ANTIALIASED if antialias else _PLAIN), factors, shifts, dtype)
    return rgb[0] if frames.is_single and rgb.shape[0] == 1 else rgb


# --- frames to RGB ---------------------------------------------------------------------------------------------------


def frames_to_rgb(
    planes: Tensor | Sequence[Tensor],
    layout: Layout = "nv12",
    *,
    matrix: Matrix = "bt601",
    color_range: ColorRange = "limited",
    chroma: Chroma = "nearest",
    siting: Siting = "left",
    size: tuple[int, int] | None = None,
    mean: float | Sequence[float] | None = None,
    std: float | Sequence[float] | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """Frames of a video decoder to RGB.

    The planes are read where they are: rows may have any pitch, and planes may be views of a larger buffer.
    Standard definition is coded with BT.601, high definition with BT.709; the stream says which, the frame does not.

    Args:
        planes: uint8, or floating-point codes / 255; uint16 with 10 bits at the top for 'p010'. By `layout`

            - 'nv12', 'nv21', 'p010': (B, 3 H / 2, W), or y (B, 1, H, W) and interleaved chroma (B, H / 2, W / 2, 2);
            - 'i420': (B, 3 H / 2, W), as OpenCV has it, or y (B, 1, H, W), u and v (B, 1, H / 2, W / 2);
            - 'yuy2': (B, H, W, 2).

            B may be missing. Separate planes of odd sizes have (H + 1) // 2 rows and (W + 1) // 2 columns of chroma.
        layout: 'nv12', 'nv21' (NV12 with v first), 'i420', 'yuy2' or 'p010'.
        matrix: 'bt601', 'bt709' or 'bt2020' (non-constant luminance).
        color_range: 'limited', where 16 is black, 235 white, and chroma is 16 to 240; or 'full', 0 to 255.
        chroma: 'nearest' repeats chroma, as OpenCV does; 'linear' interpolates it.
        siting: where chroma is, for 'linear': 'left' (MPEG-2, H.264), 'center' (JPEG, MPEG-1) or 'topleft' (BT.2020).
        size: height and width to display, from the top left, of coded frames that are larger.
        mean: subtracted from the colors in [0, 1], a number or one of each channel.
        std: what colors are divided by then.
        dtype: of the result. Default: that of floating-point planes; uint8 for uint8 without `mean` and `std`; float32.

    Returns:
        (B, 3, H, W), or (3, H, W) without B. Colors are clamped to [0, 1], then normalized; uint8 has 255 levels.

    Raises:
        TypeError: `planes` are not tensors of one type, or not of the type of `layout`; `dtype` is no type of colors.
        ValueError: `planes` do not fit `layout` or each other; an option is unknown; `size` exceeds the frame; `std` is
            not above 0; the planes are on different devices.

    Source: ITU-R BT.601-7, BT.709-6, BT.2020-2; H.273.

    Example:
        >>> import torch, kvision as K
        >>> red = torch.tensor([[81, 81], [81, 81], [90, 240]], dtype=torch.uint8)  # OpenCV's I420 of red
        >>> K.color.frames_to_rgb(red, "i420")[:, 0, 0]
        tensor([254,   0,   0], dtype=torch.uint8)
    """
    op = "frames_to_rgb"
    colors = (layout, matrix, color_range, chroma, siting, size, mean, std, dtype)
    return _run(op, planes, None, None, *colors)


def resize_frames(
    planes: Tensor | Sequence[Tensor],
    dsize: int | tuple[int, int],
    boxes: Tensor | None = None,
    layout: Layout = "nv12",
    *,
    antialias: bool = False,
    matrix: Matrix = "bt601",
    color_range: ColorRange = "limited",
    chroma: Chroma = "nearest",
    siting: Siting = "left",
    size: tuple[int, int] | None = None,
    mean: float | Sequence[float] | None = None,
    std: float | Sequence[float] | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """Crop, mirror, resize and normalize frames of a video decoder, to RGB, in one pass over the planes.

    The values are those of :func:`frames_to_rgb` in floating point, cropped and resized by
    :func:`kvision.geometry.resize`, where no color is clamped: here colors are clamped once, at the end.

    Args:
        planes: as :func:`frames_to_rgb` takes them.
        dsize: height and width of the result, or one number for both.
        boxes: (B, 4), or (1, 4) for all frames, or (N, 4) of one frame: the edges x1, y1, x2, y2 of what is resized, in
            pixels, where the frame is from 0, 0 to W, H. x1 above x2 mirrors. Fractions are taken as they are. No pixel
            is read that a box does not touch; outside of the frame its border continues. Default: the frame.
        layout: as for :func:`frames_to_rgb`.
        antialias: whether shrinking averages all pixels, as that of `resize`.
        matrix: as for :func:`frames_to_rgb`.
        color_range: as for :func:`frames_to_rgb`.
        chroma: as for :func:`frames_to_rgb`.
        siting: as for :func:`frames_to_rgb`.
        size: as for :func:`frames_to_rgb`.
        mean: as for :func:`frames_to_rgb`.
        std: as for :func:`frames_to_rgb`.
        dtype: as for :func:`frames_to_rgb`.

    Returns:
        (B, 3, h, w), (N, 3, h, w), or (3, h, w) for one frame without B and at most one box.

    Raises:
        TypeError: as :func:`frames_to_rgb` does; `boxes` is not a tensor of numbers, `antialias` not a bool.
        ValueError: as :func:`frames_to_rgb` does; `boxes` is not (B, 4).

    Example:
        >>> import torch, kvision as K
        >>> frames = torch.full((2, 1620, 1920), 128, dtype=torch.uint8)
        >>> boxes = torch.tensor([[419.0, 11, 1499, 1080], [1499, 11, 419, 1080]])  # the second one mirrored
        >>> K.color.resize_frames(frames, 224, boxes, antialias=True, mean=0.5, std=0.5, dtype=torch.float16).shape
        torch.Size([2, 3, 224, 224])
    """
    op = "resize_frames"
    if boxes is not None:
        _check.shape(op, "boxes", boxes, "B", 4)
    _check.flag(op, "antialias", antialias)
    colors = (layout, matrix, color_range, chroma, siting, size, mean, std, dtype)
    return _run(op, planes, boxes, dsize, *colors, antialias)


def warp_frames(
    planes: Tensor | Sequence[Tensor],
    M: Tensor,
    dsize: int | tuple[int, int],
    layout: Layout = "nv12",
    *,
    matrix: Matrix = "bt601",
    color_range: ColorRange = "limited",
    chroma: Chroma = "nearest",
    siting: Siting = "left",
    size: tuple[int, int] | None = None,
    mean: float | Sequence[float] | None = None,
    std: float | Sequence[float] | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """Warp frames of a video decoder by affine or perspective transformations, to RGB, in one pass over the planes.

    Bilinear, black outside of the frame, as :func:`kvision.geometry.warp_affine` and `warp_perspective`.

    Args:
        planes: as :func:`frames_to_rgb` takes them.
        M: (B, 2, 3) or (B, 3, 3), from pixels (x, y) of the frames to pixels of the result; one for all or one a frame.
        dsize: height and width of the result, or one number for both.
        layout: as for :func:`frames_to_rgb`.
        matrix: as for :func:`frames_to_rgb`.
        color_range: as for :func:`frames_to_rgb`.
        chroma: as for :func:`frames_to_rgb`.
        siting: as for :func:`frames_to_rgb`.
        size: as for :func:`frames_to_rgb`.
        mean: as for :func:`frames_to_rgb`.
        std: as for :func:`frames_to_rgb`.
        dtype: as for :func:`frames_to_rgb`.

    Returns:
        (B, 3, h, w), or (3, h, w) for one frame without B. A matrix without an inverse gives black.

    Raises:
        TypeError: as :func:`frames_to_rgb` does; `M` is not a tensor of numbers.
        ValueError: as :func:`frames_to_rgb` does; `M` is not (B, 2, 3) or (B, 3, 3).

    Example:
        >>> import torch, kvision as K
        >>> shift = torch.tensor([[[1.0, 0, 1], [0, 1, 0]]])
        >>> white = torch.tensor([[235, 235], [235, 235], [128, 128]], dtype=torch.uint8)
        >>> K.color.warp_frames(white, shift, (1, 2))[0]
        tensor([[  0, 255]], dtype=torch.uint8)
    """
    op = "warp_frames"
    _check.numbers(op, "M", M)
    if M.dim() != 3 or M.shape[1:] not in ((2, 3), (3, 3)):
        raise ShapeError(
            f"{op}: expected M of shape (B, 2, 3) or (B, 3, 3), got {tuple(M.shape)}", actual_shape=M.shape
        )
    colors = (layout, matrix, color_range, chroma, siting, size, mean, std, dtype)
    return _run(op, planes, M, dsize, *colors)


# --- RGB to frames ---------------------------------------------------------------------------------------------------


def _subsampled(x: Tensor, dim: int, kind: int) -> Tensor:
    """Chroma along an axis, of every second pixel or of the pixels around the samples. Made of slices, as `_upsampled`."""
    count = x.shape[dim]
    x = torch.cat([x, x.narrow(dim, count - 1, 1)], dim) if count % 2 else x
    here, after = x.unflatten(dim, (-1, 2)).unbind(dim + 1)
    if kind == _NEAREST:
        return here
    if kind == _BETWEEN:
        return (here + after) / 2
    before = torch.cat([here.narrow(dim, 0, 1), after.narrow(dim, 0, after.shape[dim] - 1)], dim)
    return here / 2 + (before + after) / 4


def _coded_reference(input: Tensor, plan: Sequence[int], numbers: Sequence[float]) -> Tensor:
    number, is_integer, along_x, along_y = plan
    layout = _LAYOUTS[number]
    wide = torch.float64 if input.dtype == torch.float64 else torch.float32
    red, green, blue = input.to(wide).unbind(1)

    def coded(k: int) -> Tensor:
        a, b, c = numbers[3 * k : 3 * k + 3]
        return red * a + green * b + blue * c + numbers[9 + k]

    y, u, v = coded(0), coded(1), coded(2)
    u, v = (_subsampled(c, 2, along_x) for c in (u, v))
    if layout != "yuy2":
        u, v = (_subsampled(c, 1, along_y) for c in (u, v))
    if layout == "nv21":
        u, v = v, u
    if layout == "yuy2":
        codes = torch.stack([y, torch.stack([u, v], 3).flatten(2)], 3).flatten(1)
    elif layout == "i420":
        codes = torch.cat([c.flatten(1) for c in (y, u, v)], 1)
    else:
        codes = torch.cat([y.flatten(1), torch.stack([u, v], 3).flatten(1)], 1)
    if not is_integer:
        return codes.to(input.dtype)
    if layout == "p010":
        return (codes.round().clamp(0, 1023) * 64).to(torch.int32).to(torch.uint16)
    return saturate_to_byte(codes)


def _fake_codes(input: Tensor, plan: Sequence[int], numbers: Sequence[float]) -> Tensor:
    layout, (height, width) = _LAYOUTS[plan[0]], input.shape[2:]
    rows = height if layout == "yuy2" else (height + 1) // 2
    dtype = input.dtype if not plan[1] else torch.uint16 if layout == "p010" else torch.uint8
    return input.new_empty((input.shape[0], height * width + 2 * rows * ((width + 1) // 2)), dtype=dtype)


# The codes of each frame (B, N) in their order, of RGB (B, 3, H, W). `plan` holds the number of the layout, whether codes are
# integers, and the sites of chroma along x and y. `numbers` are the matrix from colors to codes, and its offset.
_coded_frames = register(
    "coded_frames",
    _coded_reference,
    fake=_fake_codes,
    bytes=True,
    casts_outputs=True,
    supports=_kernel_serves,
)


def rgb_to_frames(
    image: Tensor,
    layout: Layout = "nv12",
    *,
    matrix: Matrix = "bt601",
    color_range: ColorRange = "limited",
    chroma: Chroma = "nearest",
    siting: Siting = "left",
    split: bool = False,
    dtype: torch.dtype | None = None,
) -> Any:
    """RGB to frames for a video encoder.

    Args:
        image: (B, 3, H, W) or (3, H, W), uint8 or floating-point in [0, 1].
        layout: as for :func:`frames_to_rgb`.
        matrix: as for :func:`frames_to_rgb`.
        color_range: as for :func:`frames_to_rgb`.
        chroma: 'nearest' takes the chroma of the top left pixel, as OpenCV does; 'linear' averages the pixels around the
            sample.
        siting: where chroma is, for 'linear', as for :func:`frames_to_rgb`.
        split: return the planes one by one, which may have odd sizes then.
        dtype: torch.uint8, or a floating-point type for codes / 255. Default: that of `image`. 'p010' has uint16 alone.

    Returns:
        (B, 3 H / 2, W), (B, H, W, 2) for 'yuy2', and without B where `image` has none. With `split` y (B, 1, H, W) and
        chroma (B, H / 2, W / 2, 2), or y, u and v for 'i420'.

    Raises:
        TypeError: `image` is not a tensor of uint8 or floating point; `split` is not a bool; `dtype` is no type of codes.
        ValueError: `image` is not (B, 3, H, W); it has an odd size that the layout cannot say; an option is unknown.

    Source: ITU-R BT.601-7, BT.709-6, BT.2020-2; H.273.

    Example:
        >>> import torch, kvision as K
        >>> red = torch.tensor([255, 0, 0], dtype=torch.uint8).view(3, 1, 1).expand(3, 2, 2)
        >>> K.color.rgb_to_frames(red, "i420")
        tensor([[ 81,  81],
                [ 81,  81],
                [ 90, 240]], dtype=torch.uint8)
    """
    op = "rgb_to_frames"
    _check.choice(op, "layout", layout, _LAYOUTS)
    sites = _check_colors(op, matrix, color_range, chroma, siting)
    _check.flag(op, "split", split)
    _check.is_tensor(op, "image", image)
    _check.floating_or_bytes(op, "image", image)
    if image.dim() not in (3, 4) or image.shape[-3] != 3 or 0 in image.shape[-2:]:
        raise ShapeError(
            f"{op}: expected image of shape (B, 3, H, W), got {tuple(image.shape)}", actual_shape=image.shape
        )
    allowed = (torch.uint16,) if layout == "p010" else _DTYPES
    if dtype is None:
        dtype = torch.uint16 if layout == "p010" else image.dtype
    if not isinstance(dtype, torch.dtype) or dtype not in allowed:
        raise TypeCheckError(f"{op}: expected dtype of layout {layout!r} to be one of {allowed}, got {dtype}")
    height, width = image.shape[-2:]
    packed = layout == "yuy2"
    if (packed or not split) and (width % 2 or (height % 2 and layout == "i420")):
        advice = "" if packed else "; split=True gives planes of odd sizes"
        raise ShapeError(f"{op}: expected image of even size for layout {layout!r}, got {tuple(image.shape)}{advice}")
    is_integer = dtype in (torch.uint8, torch.uint16)
    rgb = image[None] if image.dim() == 3 else image
    if not is_integer and (rgb.dtype == torch.uint8 or dtype == torch.float64):
        rgb = rgb.to(torch.float64 if dtype == torch.float64 else torch.float32)
    step = 1.0 if is_integer else 1 / 255
    level = step / 255 if image.dtype == torch.uint8 else step
    black, luma, gray, of_chroma, _ = _codes(layout, color_range, torch.uint8)
    if layout == "p010":
        black, luma, gray, of_chroma = (value / 64 for value in (black, luma, gray, of_chroma))
    widths = (luma, of_chroma, of_chroma)
    weights = [w * width * level for row, width in zip(_ycc_of_rgb(matrix), widths) for w in row]
    offsets = [black * step, gray * step, gray * step]
    codes = _coded_frames(rgb, [_LAYOUTS.index(layout), int(is_integer), *sites], [*weights, *offsets])
    codes = codes if codes.dtype == dtype else codes.to(dtype)
    if image.dim() == 3:
        codes = codes[0]
    lead, half = codes.shape[:-1], ((height + 1) // 2, (width + 1) // 2)
    if packed:
        return codes.reshape(*lead, height, width, 2)
    if not split:
        return codes.reshape(*lead, height + half[0], width)
    y, chroma_codes = codes.split([height * width, 2 * half[0] * half[1]], -1)
    y = y.reshape(*lead, 1, height, width)
    if layout != "i420":
        return y, chroma_codes.reshape(*lead, *half, 2)
    u, v = chroma_codes.reshape(*lead, 2, 1, *half).unbind(-4)
    return y, u, v
