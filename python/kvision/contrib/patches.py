"""Extract patches from images, and combine patches into images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._modules import FunctionModule
from kvision._ops import register
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

Pad = tuple[int, int, int, int]  # top, bottom, left, right


def _extract_reference(
    x: Tensor, size: Sequence[int], window: Sequence[int], stride: Sequence[int], padding: Sequence[int]
) -> Tensor:
    """Patches (B, N, C, height, width), row by row, with zeros outside of the image."""
    top, bottom, left, right = padding
    x = F.pad(x, (left, right, top, bottom)) if any(padding) else x
    patches = x.unfold(2, window[0], stride[0]).unfold(3, window[1], stride[1])  # a view
    return patches.permute(0, 2, 3, 1, 4, 5).flatten(1, 2).contiguous()


def _combine_reference(
    patches: Tensor, size: Sequence[int], window: Sequence[int], stride: Sequence[int], padding: Sequence[int]
) -> Tensor:
    """Sum the patches at their positions: (B, C, *size)."""
    top, bottom, left, right = padding
    height, width = size[0] + top + bottom, size[1] + left + right
    grid = patches.unflatten(1, ((height - window[0]) // stride[0] + 1, (width - window[1]) // stride[1] + 1))
    total = _added(_added(grid, 1, 4, stride[0]), 1, 4, stride[1])  # (B, C, H, W)
    total = F.pad(total, (0, width - total.shape[3], 0, height - total.shape[2]))
    return total[..., top : top + size[0], left : left + size[1]]


def _extracted_size(x: Tensor, size: Any, window: Any, stride: Any, padding: Any) -> tuple[int, ...]:
    down, across = (
        (n + a + b - k) // s + 1 for n, a, b, k, s in zip(size, padding[::2], padding[1::2], window, stride)
    )
    return (x.shape[0], down * across, x.shape[1], *window)


_extract = register(
    "extract_patches",
    _extract_reference,
    fake=_extracted_size,
    gradients="input: combine_patches(patches=grad)",
    linear=True,
    bytes=True,
)
_combine = register(
    "combine_patches",
    _combine_reference,
    fake=lambda patches, size, *_: (patches.shape[0], patches.shape[2], *size),
    gradients="patches: extract_patches(input=grad)",
    linear=True,
)


def compute_padding(
    original_size: tuple[int, int] | int,
    window_size: tuple[int, int] | int,
    stride: tuple[int, int] | int | None = None,
) -> Pad:
    """Find the padding with which windows fit an image exactly.

    Args:
        original_size: height and width of the image, or an int for both.
        window_size: those of a window.
        stride: steps between windows; None for window_size.

    Returns:
        (top, bottom, left, right), the smallest there is; an odd pixel goes to the bottom and to the right.

    Raises:
        TypeCheckError: not ints.
        ValueCheckError: a size or stride below 1.

    Example:
        >>> import kvision as K
        >>> K.contrib.compute_padding((10, 7), (4, 3))
        (1, 1, 1, 1)
    """
    sizes = _check.pair("compute_padding", "original_size", original_size, maximum=_check.LARGEST_INT)
    window, step = _windows("compute_padding", window_size, window_size if stride is None else stride)
    return _fitting(sizes, window, step)


def _fitting(sizes: tuple[int, int], window: tuple[int, int], step: tuple[int, int]) -> Pad:
    missing = [max((k - n) % s, k - n) for n, k, s in zip(sizes, window, step)]
    (top, bottom), (left, right) = ((m // 2, m - m // 2) for m in missing)
    return top, bottom, left, right


def extract_tensor_patches(
    input: Tensor,
    window_size: tuple[int, int] | int,
    stride: tuple[int, int] | int = 1,
    padding: tuple[int, ...] | int = 0,
    allow_auto_padding: bool = False,
) -> Tensor:
    """Cut images into patches.

    Args:
        input: images (B, C, H, W) of any type.
        window_size: height and width of a patch, or an int for both.
        stride: steps from patch to patch, (y, x) or an int.
        padding: zeros around the image: an int, (y, x) or (top, bottom, left, right).
        allow_auto_padding: where there is no padding and patches do not fit, pad the image so that they do. Otherwise
            pixels at its right and lower end that fill no patch are left out.

    Returns:
        (B, N, C, height, width), patches row by row.

    Raises:
        TypeCheckError: input is not a tensor; sizes, stride or padding not of ints.
        ShapeError: input is not (B, C, H, W), or smaller than a patch.
        ValueCheckError: a size or stride below 1, a negative padding.

    Example:
        >>> import torch, kvision as K
        >>> K.contrib.extract_tensor_patches(torch.arange(9.0).view(1, 1, 3, 3), 2)[0, -1]
        tensor([[[4., 5.],
                 [7., 8.]]])
    """
    op = "extract_tensor_patches"
    _check.images(op, "input", input)
    window, step = _windows(op, window_size, stride)
    pads = _pads(op, "padding", padding)
    _check.flag(op, "allow_auto_padding", allow_auto_padding)
    h, w = input.shape[2:]
    if not any(pads) and allow_auto_padding:
        pads = _fitting((h, w), window, step)
    top, bottom, left, right = pads
    if h + top + bottom < window[0] or w + left + right < window[1]:
        raise ShapeError(
            f"{op}: expected an image no smaller than a window of {window}, got {tuple(input.shape)} and padding {pads}",
            actual_shape=input.shape,
        )
    return _extract(input, (h, w), window, step, pads)


def combine_tensor_patches(
    patches: Tensor,
    original_size: tuple[int, int] | int,
    window_size: tuple[int, int] | int,
    stride: tuple[int, int] | int,
    allow_auto_unpadding: bool = False,
    unpadding: tuple[int, ...] | int = 0,
    eps: float | None = None,
) -> Tensor:
    """Combine patches into images. Where patches overlap, their mean is taken.

    Args:
        patches: (B, N, C, height, width), row by row; integers come back as integers, rounded down.
        original_size: height and width of the image, or an int for both.
        window_size: those of a patch.
        stride: steps from patch to patch, at most window_size.
        allow_auto_unpadding: where there is no unpadding, take off what extract_tensor_patches with allow_auto_padding
            has put on.
        unpadding: what to take off: an int, (y, x) or (top, bottom, left, right).
        eps: for compatibility, without effect.

    Returns:
        (B, C, *original_size); pixels that no patch has are 0.

    Raises:
        TypeCheckError: patches is not a tensor; sizes, stride or unpadding not of ints.
        ShapeError: patches is not (B, N, C, height, width), or N is another number than fits.
        ValueCheckError: a stride larger than the window; a size or stride below 1.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.rand(1, 3, 6, 6)
        >>> patches = K.contrib.extract_tensor_patches(x, 4, 2)
        >>> bool(torch.allclose(K.contrib.combine_tensor_patches(patches, 6, 4, 2), x))
        True
    """
    op = "combine_tensor_patches"
    height, width = _check.pair(op, "original_size", original_size, maximum=_check.LARGEST_INT)
    window, step = _windows(op, window_size, stride)
    if step[0] > window[0] or step[1] > window[1]:
        raise ValueCheckError(f"{op}: expected a stride of at most the window_size {window}, got {step}")
    pads = _pads(op, "unpadding", unpadding)
    _check.flag(op, "allow_auto_unpadding", allow_auto_unpadding)
    _check.shape(op, "patches", patches, "B", "N", "C", *window)
    if patches.shape[2] == 0:
        raise ShapeError(f"{op}: expected patches with at least one channel, got {tuple(patches.shape)}")
    if not any(pads) and allow_auto_unpadding:
        pads = _fitting((height, width), window, step)
    top, bottom, left, right = pads
    size = (height + top + bottom, width + left + right)
    down, across = ((n - k) // s + 1 for n, k, s in zip(size, window, step))
    if down * across != patches.shape[1] or down < 1 or across < 1:
        raise ShapeError(
            f"{op}: expected {down} x {across} patches for an image of {size}, got {patches.shape[1]}",
            actual_shape=patches.shape,
        )
    if step == window:
        return _combine(patches, (height, width), window, step, pads)
    exact = patches.dtype == torch.float64 or not patches.is_floating_point()
    dtype = torch.float64 if exact else torch.float32
    total = _combine(patches.to(dtype), (height, width), window, step, pads)
    ones = patches.new_ones(1, patches.shape[1], 1, *window, dtype=dtype)
    mean = total / _combine(ones, (height, width), window, step, pads).clamp_min(1)
    return (mean if patches.is_floating_point() else mean.floor()).to(patches.dtype)


def _added(x: Tensor, index: int, axis: int, step: int) -> Tensor:
    """Sum the slices along the axis `index`, each shifted by `step` along `axis`. The result has no axis `index`."""
    count, size = x.shape[index], x.shape[axis]
    length = (count - 1) * step + size
    slices = enumerate(x.unbind(index))
    axes_behind = x.dim() - 1 - axis
    placed = [F.pad(s, [0, 0] * axes_behind + [i * step, length - size - i * step]) for i, s in slices]
    total = placed[0]
    for other in placed[1:]:
        total = total + other
    return total


def _windows(op: str, window_size: Any, stride: Any) -> tuple[tuple[int, int], tuple[int, int]]:
    window = _check.pair(op, "window_size", window_size, maximum=_check.LARGEST_INT)
    return window, _check.pair(op, "stride", stride, maximum=_check.LARGEST_INT)


def _pads(op: str, name: str, value: Any) -> Pad:
    if type(value) is int and 0 <= value <= _check.LARGEST_INT:
        return (value, value, value, value)
    sides = _check.scalars(op, name, value)
    sides = (sides, sides) if _check.is_int(sides) else sides
    if not isinstance(sides, (tuple, list)) or len(sides) not in (2, 4) or not all(map(_check.is_int, sides)):
        raise TypeCheckError(f"{op}: expected {name} to be an int, 2 or 4 ints, got {value!r}", actual_type=type(value))
    if min(sides) < 0 or max(sides) > _check.LARGEST_INT:
        raise ValueCheckError(f"{op}: expected {name} from 0 to 2^31 - 1, got {value!r}", actual_value=value)
    return (sides[0], sides[0], sides[1], sides[1]) if len(sides) == 2 else tuple(sides)


class ExtractTensorPatches(FunctionModule):
    """Module form of :func:`extract_tensor_patches`.

    Example:
        >>> import torch, kvision as K
        >>> K.contrib.ExtractTensorPatches(4, 2)(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 9, 3, 4, 4])
    """

    def __init__(
        self,
        window_size: tuple[int, int] | int,
        stride: tuple[int, int] | int = 1,
        padding: tuple[int, ...] | int = 0,
        allow_auto_padding: bool = False,
    ) -> None:
        super().__init__(window_size=window_size, stride=stride, padding=padding, allow_auto_padding=allow_auto_padding)

    def forward(self, input: Tensor) -> Tensor:
        return extract_tensor_patches(input, self.window_size, self.stride, self.padding, self.allow_auto_padding)


class CombineTensorPatches(FunctionModule):
    """Module form of :func:`combine_tensor_patches`; a stride of None is the window_size.

    Example:
        >>> import torch, kvision as K
        >>> K.contrib.CombineTensorPatches((8, 8), 4)(torch.rand(2, 4, 3, 4, 4)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        original_size: tuple[int, int] | int,
        window_size: tuple[int, int] | int,
        stride: tuple[int, int] | int | None = None,
        unpadding: tuple[int, ...] | int = 0,
        allow_auto_unpadding: bool = False,
    ) -> None:
        super().__init__(
            original_size=original_size,
            window_size=window_size,
            stride=window_size if stride is None else stride,
            unpadding=unpadding,
            allow_auto_unpadding=allow_auto_unpadding,
        )

    def forward(self, input: Tensor) -> Tensor:
        return combine_tensor_patches(
            input, self.original_size, self.window_size, self.stride, self.allow_auto_unpadding, self.unpadding
        )
