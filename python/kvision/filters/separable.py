"""Filtering with a kernel that is the product of a column and a row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Border, WindowPadding
from kvision._dtype import pixels
from kvision._modes import BORDER, BORDER_NAMES
from kvision._ops import register
from kvision._shared_memory import fitting
from kvision.core.border import pad, same_pads
from kvision.filters.filter2d import check_padding, correlate, prepare_kernel


def filter_separably(x: Tensor, kernel_x: Tensor, kernel_y: Tensor, border: str, same: bool = True) -> Tensor:
    """Filter `x` (B, C, H, W) along x with the rows of kernel_x (B or 1, kW), then along y with those of kernel_y."""
    for kernel in (kernel_x[:, None, :], kernel_y[:, :, None]):
        if same:
            x = pad(x, same_pads(kernel.shape[1:]), border)
        x = correlate(x, kernel)
    return x


def _reference(x: Tensor, kernel_x: Tensor, kernel_y: Tensor, border: int, same: bool) -> Tensor:
    return filter_separably(x, kernel_x, kernel_y, BORDER_NAMES[border], same)


def _transposed_reference(grad: Tensor, kernel_x: Tensor, kernel_y: Tensor, border: int, same: bool) -> Tensor:
    x = grad.new_zeros(_transposed_size(grad, kernel_x, kernel_y, border, same))
    _, vjp_fn = torch.func.vjp(lambda x: _reference(x, kernel_x, kernel_y, border, same), x)
    return vjp_fn(grad)[0]


def _weights_reference(kernel_x: Tensor, kernel_y: Tensor, grad: Tensor, x: Tensor, border: int, same: bool) -> Tensor:
    """(B, kW + kH): for each image the gradient to its kernel_x, then that to its kernel_y."""
    kernels = [kernel.expand(x.shape[0], -1) for kernel in (kernel_x, kernel_y)]
    _, vjp_fn = torch.func.vjp(lambda kx, ky: _reference(x, kx, ky, border, same), *kernels)
    return torch.cat(vjp_fn(grad), 1)


def _size(x: Tensor, kernel_x: Tensor, kernel_y: Tensor, border: int, same: bool) -> tuple[int, ...]:
    b, c, h, w = x.shape
    return (b, c, h, w) if same else (b, c, h - kernel_y.shape[1] + 1, w - kernel_x.shape[1] + 1)


def _transposed_size(grad: Tensor, kernel_x: Tensor, kernel_y: Tensor, border: int, same: bool) -> tuple[int, ...]:
    b, c, h, w = grad.shape
    return (b, c, h, w) if same else (b, c, h + kernel_y.shape[1] - 1, w + kernel_x.shape[1] - 1)


def _weights_size(kernel_x: Tensor, kernel_y: Tensor, grad: Tensor, *_: Any) -> tuple[int, ...]:
    return (grad.shape[0], kernel_x.shape[1] + kernel_y.shape[1])


_MAX_CUDA_TAPS = 128  # a GPU's shared memory holds the rows of the gradient and the sums


def _weights_supports(kernel_x: Tensor, kernel_y: Tensor, grad: Tensor, *_: Any) -> str | None:
    """On CUDA kernels have at most 128 taps, or fewer on smaller GPUs."""
    taps = max(kernel_x.shape[1], kernel_y.shape[1])
    if grad.is_cpu or taps <= (most := fitting(grad, _MAX_CUDA_TAPS)):
        return None
    return f"there is no kernel for gradients of {taps} taps, only for up to {most}"


def _backward(needs, grad, x, kernel_x, kernel_y, border, same):
    return [
        _transposed(grad, kernel_x, kernel_y, border, same) if needs[0] else None,
        *weight_gradients(needs[1:], grad, x, kernel_x, kernel_y, border, same),
    ]


def _transposed_backward(needs, gradgrad, grad, kernel_x, kernel_y, border, same):
    return [
        _filter2d_separable(gradgrad, kernel_x, kernel_y, border, same) if needs[0] else None,
        *weight_gradients(needs[1:], grad, gradgrad, kernel_x, kernel_y, border, same),
    ]


def weight_gradients(
    needs: Sequence[bool], grad: Tensor, x: Tensor, kernel_x: Tensor, kernel_y: Tensor, border: int, same: bool = True
) -> list[Tensor | None]:
    """The gradients to kernel_x and kernel_y, those that are needed, from the gradient to the filtered `x`."""
    if not (needs[0] or needs[1]):
        return [None, None]
    both = _weights_backward(kernel_x, kernel_y, grad, x, border, same)
    each = both.split((kernel_x.shape[1], kernel_y.shape[1]), 1)
    return [
        (part.sum(0, keepdim=True) if kernel.shape[0] == 1 else part) if need else None
        for need, part, kernel in zip(needs, each, (kernel_x, kernel_y))
    ]


_filter2d_separable = register("filter2d_separable", _reference, fake=_size, backward=_backward, bytes=True)
_transposed = register(
    "filter2d_separable_backward", _transposed_reference, fake=_transposed_size, backward=_transposed_backward
)
_weights_backward = register(
    "filter2d_separable_weights_backward", _weights_reference, fake=_weights_size, supports=_weights_supports
)


def filter2d_separable(
    input: Tensor,
    kernel_x: Tensor,
    kernel_y: Tensor,
    border_type: Border = "reflect",
    normalized: bool = False,
    padding: WindowPadding = "same",
) -> Tensor:
    """Filter every channel of an image along x, then along y.

    The same as `filter2d` with the kernel kernel_y[:, :, None] * kernel_x[:, None, :], at the cost of two rows.

    Args:
        input: image (B, C, H, W). uint8 gives uint8 (rounded once, at the end), other integers give float32.
        kernel_x: (1, kW), or (B, kW) with a kernel for every image.
        kernel_y: (1, kH) or (B, kH).
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.
        normalized: divide each kernel by the sum of its absolute values.
        padding: 'same' keeps the size, 'valid' gives (B, C, H - kH + 1, W - kW + 1) and reads no border.

    Returns:
        The filtered image; differentiable in image and kernels.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as `filter2d`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[1., 2., 3.], [4., 5., 6.]]]])
        >>> K.filters.filter2d_separable(x, torch.ones(1, 3), torch.ones(1, 1), border_type="constant")
        tensor([[[[ 3.,  6.,  5.],
                  [ 9., 15., 11.]]]])
    """
    _check.images("filter2d_separable", "input", input)
    _check.shape("filter2d_separable", "kernel_x", kernel_x, "B or 1", "kW")
    _check.shape("filter2d_separable", "kernel_y", kernel_y, "B or 1", "kH")
    kernel_x = prepare_kernel("filter2d_separable", input, kernel_x, normalized, "corr")
    kernel_y = prepare_kernel("filter2d_separable", input, kernel_y, normalized, "corr")
    taps = (kernel_y.shape[1], kernel_x.shape[1])
    same = check_padding("filter2d_separable", input, taps, border_type, padding)
    return _filter2d_separable(pixels(input), kernel_x, kernel_y, BORDER[border_type], same)
