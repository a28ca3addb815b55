"""Antialiased resizing of a window of each image: what crops with antialiasing are."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision._modes import INTERPOLATION_NAMES
from kvision._ops import FastPath, register
from kvision.core.windows import windows_of
from kvision.geometry.transform.resize import SUPPORT, window_weight


def _reference(input, matrix, size, filter, align_corners):
    matrix = matrix.expand(input.shape[0], 3, 3)
    for axis in (1, 0):
        n, result = input.shape[3 - axis], size[1 - axis]
        index, weight = _taps(INTERPOLATION_NAMES[filter], matrix, axis, n, result, align_corners, input)
        input = _weighted(input, 3 - axis, index, weight)
    return input


def _weighted(image: Tensor, axis: int, index: Tensor, weight: Tensor) -> Tensor:
    """Means of the pixels `index` (B, n, k) of each image along an axis."""
    shape, sizes = [len(image), 1, 1, 1], [*image.shape]
    shape[axis] = sizes[axis] = index.shape[1]
    total = torch.zeros((), dtype=image.dtype, device=image.device)
    for at, factor in zip(index.unbind(2), weight.unbind(2)):
        value, factor = image.gather(axis, at.reshape(shape).expand(sizes)), factor.reshape(shape)
        # A tap of weight 0 contributes nothing, even if it is inf or NaN.
        total = total + factor * torch.where((factor == 0) & ~value.isfinite(), 0.0, value)
    return total


def _taps(
    filter: str, matrix: Tensor, axis: int, source: int, result: int, align_corners: bool, like: Tensor
) -> tuple[Tensor, Tensor]:
    """Pixels and weights (B, result, k) along an axis; as those of `resize`, along axes that begin at the windows."""
    first, n, mirrored = (v[:, None] for v in windows_of(matrix, axis, source, result, align_corners))
    i = torch.arange(result, device=like.device)
    i = torch.where(mirrored, result - 1 - i, i)
    if not align_corners:
        origin, num, den = n - result, 2 * n, 2 * result
    else:
        origin, num, den = 0 * n, n - 1 if result > 1 else 0 * n, max(result - 1, 1)
    coord, unit = origin + num * i, num.clamp(min=den)
    # As many as windows of the whole image have.
    longest = max(2 * source, den) if not align_corners else max(source - 1, den)
    taps = -(-2 * SUPPORT[filter] * longest // den)
    begin = torch.div(coord - SUPPORT[filter] * unit, den, rounding_mode="floor") + 1
    index = begin[..., None] + torch.arange(taps, device=like.device)
    weight = window_weight(filter, (index * den - coord[..., None]).to(like.dtype) / unit[..., None], True)
    weight = torch.where((index >= 0) & (index < n[..., None]), weight, 0.0)
    return (index + first[..., None]).clamp(0, source - 1), weight / weight.sum(2, keepdim=True)


def _reference_backward(grad, matrix, size, *options):
    def f(image: Tensor) -> Tensor:
        return _reference(image, matrix, grad.shape[2:], *options)

    _, vjp_fn = torch.func.vjp(f, grad.new_zeros(*grad.shape[:2], *size))
    return vjp_fn(grad)[0]


def _size(x, matrix, size, *options):
    return (*x.shape[:2], *size)


# Windows are whole pixels, so that the matrices have no gradient.
def _supports(x, *_):
    """Images have at least one pixel."""
    return None if 0 not in x.shape[2:] else f"there is no kernel for images without pixels, here {tuple(x.shape)}"


# Arguments: images (B, C, H, W); matrices (B, 3, 3) or (1, 3, 3), of the type that computes, without rotation and shear; height
# and width of the results; the number of 'bilinear', 'bicubic' or 'lanczos'; align_corners, as `resize` has it.
resized_windows = register(
    "resize_windows",
    _reference,
    fake=_size,
    gradients="input: resize_windows_backward(size=sizes(input))",
    linear=True,
    bytes=True,
    supports=_supports,
)
resized_windows_backward = register(
    "resize_windows_backward",
    _reference_backward,
    fake=_size,
    gradients="grad: resize_windows(input=grad_grad, size=sizes(grad))",
    linear=True,
    supports=_supports,
)

# Several views of each image by one launch: images (B, C, H, W); boxes (B, V, 4) in float32, x, y, width and height of windows
# in whole pixels; height and width of the views; the number of the filter. Result v * B + b is view v of image b.
resized_views = FastPath("resize_views", (torch.float32, torch.float16, torch.bfloat16, torch.uint8))
