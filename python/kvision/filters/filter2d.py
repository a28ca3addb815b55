"""Cross-correlation and convolution of images with any small kernel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._choices import Behaviour, Border, WindowPadding
from kvision._clamp import clamp
from kvision._dtype import as_dtype, compute_dtype, pixels
from kvision._modes import BORDER, BORDER_NAMES
from kvision._ops import Operator, register
from kvision.core.border import pad, same_pads
from kvision.core.exceptions import ShapeError

_PADDINGS = get_args(WindowPadding)

_BEHAVIOURS = get_args(Behaviour)


def correlate(x: Tensor, kernel: Tensor, stride: int = 1) -> Tensor:
    """Cross-correlate the channels of `x` (B, C, *S) with `kernel` (B or 1, *K) where it fits inside; 2-D or 3-D."""
    b, c, *size = x.shape
    n, *taps = kernel.shape
    if n * c == 0:  # a convolution has at least one group; without planes any crop of the right size will do
        crop: tuple[Any, ...] = (..., *(slice(k - 1, None, stride) for k in taps))
        return x[crop] * kernel.sum()
    convolve = F.conv2d if len(size) == 2 else F.conv3d
    weight = kernel[:, None].expand(n, c, *taps).reshape(n * c, 1, *taps)
    y = convolve(x.reshape(b // n, n * c, *size), weight, stride=stride, groups=n * c)
    return y.reshape(b, c, *y.shape[2:])


def _reference(x: Tensor, kernel: Tensor, border: int, same: bool) -> Tensor:
    if same:
        x = pad(x, same_pads(kernel.shape[1:]), BORDER_NAMES[border])
    return correlate(x, kernel)


def _transposed(grad: Tensor, kernel: Tensor, border: int, same: bool) -> Tensor:
    x = grad.new_zeros(_size(grad, kernel, 0 if same else 1))
    _, vjp_fn = torch.func.vjp(lambda x: _reference(x, kernel, border, same), x)
    return vjp_fn(grad)[0]


def _kernel_backward_reference(kernel: Tensor, grad: Tensor, x: Tensor, border: int, same: bool) -> Tensor:
    zeros = kernel.new_zeros(x.shape[0], *kernel.shape[1:])
    _, vjp_fn = torch.func.vjp(lambda kernel: _reference(x, kernel, border, same), zeros)
    return vjp_fn(grad)[0]


def _size(x: Tensor, kernel: Tensor, sign: int) -> tuple[int, ...]:
    return (*x.shape[:2], *(n + sign * (k - 1) for n, k in zip(x.shape[2:], kernel.shape[1:])))


def register_filter(name: str, bytes: bool = False) -> tuple[Operator, Operator, Operator]:
    """Register the filter `name` of images or volumes, its transpose and its gradient to the kernel, and return them.

    The three are the derivatives of each other: of the sum over pixels of grad * filter(x, kernel), they are the
    derivatives for grad, x and kernel.
    """

    forward = register(
        name,
        _reference,
        fake=lambda x, kernel, border, same: _size(x, kernel, 0 if same else -1),
        gradients=f"input: {name}_backward; kernel: {name}_kernel_backward",
        bytes=bytes,
    )
    transposed = register(
        f"{name}_backward",
        _transposed,
        fake=lambda grad, kernel, border, same: _size(grad, kernel, 0 if same else 1),
        gradients=f"grad: {name}(input=grad_grad); kernel: {name}_kernel_backward(input=grad_grad)",
    )
    # The kernel comes first: the gradient to it has its type, not that of the images. Its values do not matter.
    of_kernel = register(
        f"{name}_kernel_backward",
        _kernel_backward_reference,
        fake=lambda kernel, grad, x, border, same: (x.shape[0], *kernel.shape[1:]),
        gradients=f"grad: {name}(kernel=grad_grad); input: {name}_backward(kernel=grad_grad)",
    )
    return forward, transposed, of_kernel


_filter2d, _filter2d_backward, _kernel_backward = register_filter("filter2d", bytes=True)


def _clamped_reference(x: Tensor, kernel: Tensor, border: int) -> Tensor:
    return clamp(_reference(x, kernel, border, True), 0, 1)


def clamped_gradients(
    needs: Sequence[bool], grad: Tensor, x: Tensor, kernel: Tensor, border: int
) -> list[Tensor | None]:
    """Those of images and kernels that :func:`filter2d_clamped` filters."""
    y = _filter2d(as_dtype(x, compute_dtype(x)), kernel, border, True)
    grad = torch.where((y < 0) | (y > 1), 0, grad)
    return [
        _filter2d_backward(grad, kernel, border, True) if needs[0] else None,
        _kernel_backward(kernel, grad, x, border, True).sum_to_size(kernel.shape) if needs[1] else None,
    ]


filter2d_clamped = register("filter2d_clamped", _clamped_reference, backward=clamped_gradients, bytes=True, levels=255)


def filter2d(
    input: Tensor,
    kernel: Tensor,
    border_type: Border = "reflect",
    normalized: bool = False,
    padding: WindowPadding = "same",
    behaviour: Behaviour = "corr",
) -> Tensor:
    """Filter every channel of an image with one kernel.

    The kernel lies on the image unflipped, with its tap (kH - 1) // 2, (kW - 1) // 2 on the pixel that is computed.

    Args:
        input: image (B, C, H, W). uint8 gives uint8 (rounded half to even, saturated), other integers give float32.
        kernel: (1, kH, kW), or (B, kH, kW) with a kernel for every image; sizes may be even.
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.
        normalized: divide the kernel by the sum of its absolute values.
        padding: 'same' keeps the size, 'valid' gives (B, C, H - kH + 1, W - kW + 1) and reads no border.
        behaviour: 'corr', or 'conv' to flip the kernel first (convolution).

    Returns:
        The filtered image; differentiable in image and kernel.

    Raises:
        TypeCheckError: input or kernel is not a real tensor.
        ShapeError: wrong ranks or batch sizes; a 'valid' kernel larger than the image, a border wider than it.
        ValueCheckError: an unknown border_type, padding or behaviour.
        DeviceError: a kernel on another device; one in CPU memory is moved.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[1., 2., 3.]]]])
        >>> K.filters.filter2d(x, torch.tensor([[[1., 0., 0.]]]), border_type="replicate")
        tensor([[[[1., 1., 2.]]]])
    """
    return filter_images("filter2d", input, kernel, border_type, normalized, padding, behaviour)


def correlate2d(
    input: Tensor,
    kernel: Tensor,
    border_type: Border = "reflect",
    normalized: bool = False,
    padding: WindowPadding = "same",
) -> Tensor:
    """Cross-correlate every channel of an image with one kernel: :func:`filter2d` with behaviour 'corr'.

    Args:
        input: image (B, C, H, W). uint8 gives uint8 (rounded half to even, saturated), other integers give float32.
        kernel: (1, kH, kW), or (B, kH, kW) with a kernel for every image; sizes may be even.
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.
        normalized: divide the kernel by the sum of its absolute values.
        padding: 'same' keeps the size, 'valid' gives (B, C, H - kH + 1, W - kW + 1) and reads no border.

    Returns:
        The filtered image; differentiable in image and kernel.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`filter2d`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 1., 0.]]]])
        >>> K.filters.correlate2d(x, torch.tensor([[[1., 2., 3.]]]), border_type="constant")
        tensor([[[[3., 2., 1.]]]])
    """
    return filter_images("correlate2d", input, kernel, border_type, normalized, padding, "corr")


def convolve2d(
    input: Tensor,
    kernel: Tensor,
    border_type: Border = "reflect",
    normalized: bool = False,
    padding: WindowPadding = "same",
) -> Tensor:
    """Convolve every channel of an image with one kernel: :func:`filter2d` with behaviour 'conv'.

    Args:
        input: image (B, C, H, W). uint8 gives uint8 (rounded half to even, saturated), other integers give float32.
        kernel: (1, kH, kW), or (B, kH, kW) with a kernel for every image; sizes may be even.
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.
        normalized: divide the kernel by the sum of its absolute values.
        padding: 'same' keeps the size, 'valid' gives (B, C, H - kH + 1, W - kW + 1) and reads no border.

    Returns:
        The filtered image; differentiable in image and kernel.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`filter2d`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 1., 0.]]]])
        >>> K.filters.convolve2d(x, torch.tensor([[[1., 2., 3.]]]), border_type="constant")
        tensor([[[[1., 2., 3.]]]])
    """
    return filter_images("convolve2d", input, kernel, border_type, normalized, padding, "conv")


def filter_images(
    op: str,
    input: Tensor,
    kernel: Tensor,
    border_type: Border,
    normalized: bool,
    padding: WindowPadding,
    behaviour: Behaviour,
) -> Tensor:
    """:func:`filter2d`, under the name of the function that was called."""
    arguments = filter_arguments(op, input, kernel, border_type, normalized, padding, behaviour)
    return _filter2d(*arguments)


def filter_arguments(
    op: str,
    input: Tensor,
    kernel: Tensor,
    border_type: Border = "reflect",
    normalized: bool = False,
    padding: WindowPadding = "same",
    behaviour: Behaviour = "corr",
) -> tuple[Tensor, Tensor, int, bool]:
    """The checked arguments of a filter as its operator takes them."""
    _check.images(op, "input", input)
    _check.shape(op, "kernel", kernel, "B or 1", "kH", "kW")
    kernel = prepare_kernel(op, input, kernel, normalized, behaviour)
    same = check_padding(op, input, kernel.shape[1:], border_type, padding)
    return pixels(input), kernel, BORDER[border_type], same


def prepare_kernel(op: str, x: Tensor, kernel: Tensor, normalized: bool, behaviour: Behaviour) -> Tensor:
    """The checked `kernel` (B or 1, *K) as the operators take it: unit absolute sum and flipped where asked."""
    sizes = kernel.shape
    if sizes[0] != 1 and sizes[0] != x.shape[0]:
        raise ShapeError(
            f"{op}: expected a kernel batch of 1 or the {x.shape[0]} of the input, got {sizes[0]}", actual_shape=sizes
        )
    if 0 in sizes[1:]:
        raise ShapeError(f"{op}: expected a kernel with at least one tap, got {tuple(sizes)}")
    kernel = _check.to_device_of(op, x, "kernel", kernel)
    _check.flag(op, "normalized", normalized)
    _check.choice(op, "behaviour", behaviour, _BEHAVIOURS)
    kernel = as_dtype(kernel, compute_dtype(x))
    if not normalized and behaviour == "corr":
        return kernel
    axes = tuple(range(1, kernel.dim()))
    if normalized:
        kernel = kernel / kernel.abs().sum(axes, keepdim=True)
    return kernel.flip(axes) if behaviour == "conv" else kernel


def check_padding(op: str, x: Tensor, taps: Sequence[int], border_type: Border, padding: WindowPadding) -> bool:
    """Whether `padding` is 'same'; raise where the border or, for 'valid', a kernel of these sizes does not fit."""
    _check.border(op, border_type)
    _check.choice(op, "padding", padding, _PADDINGS)
    if padding == "same":
        _check.reflectable(op, x, [size // 2 for size in taps], border_type)
    elif any(k > n for k, n in zip(taps, x.shape[2:])):
        raise ShapeError(
            f"{op}: expected a 'valid' kernel no larger than the input, got {tuple(taps)} for {tuple(x.shape)}"
        )
    return padding == "same"
