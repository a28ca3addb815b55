"""Filtering in the Fourier domain, for large kernels."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._choices import Behaviour, Border, WindowPadding
from kvision._dtype import pixels
from kvision._ops import with_kernel_casts
from kvision._torch_compat import is_tracing
from kvision.core.border import pad, same_pads
from kvision.filters.filter2d import check_padding, prepare_kernel


@with_kernel_casts
def _correlate(x: Tensor, kernel: Tensor, border: str, same: bool) -> Tensor:
    ky, kx = kernel.shape[1:]
    if same:
        x = pad(x, same_pads((ky, kx)), border)
    h, w = x.shape[2:]
    if x.numel() == 0:  # there is no transform of nothing
        return x[..., ky - 1 :, kx - 1 :] * kernel.sum()
    # In graphs sizes are symbolic.
    size = (h, w) if is_compiling() or is_tracing() else (_fast_size(h), _fast_size(w))
    spectrum = torch.fft.rfft2(x, s=size) * torch.fft.rfft2(kernel[:, None], s=size).conj()
    return torch.fft.irfft2(spectrum, s=size)[..., : h - ky + 1, : w - kx + 1]  # beyond, the kernel wraps around


def _fast_size(n: int) -> int:
    """The smallest size of at least n without prime factors above 7, which make Fourier transforms slow."""
    while True:
        rest = n
        for factor in (2, 3, 5, 7):
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return n
        n += 1


def fft_conv(
    input: Tensor,
    kernel: Tensor,
    border_type: Border = "reflect",
    normalized: bool = False,
    padding: WindowPadding = "same",
    behaviour: Behaviour = "corr",
) -> Tensor:
    """Filter every channel of an image with one kernel, through the Fourier transform.

    The result of :func:`filter2d` up to rounding, at a cost that does not depend on the kernel's size. One NaN or
    infinity makes its whole channel NaN.

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
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`filter2d`.

    Example:
        >>> import torch, kvision as K
        >>> x, kernel = torch.rand(2, 3, 32, 32), torch.rand(1, 15, 15)
        >>> torch.allclose(K.filters.fft_conv(x, kernel), K.filters.filter2d(x, kernel), atol=1e-4)
        True
    """
    _check.images("fft_conv", "input", input)
    _check.shape("fft_conv", "kernel", kernel, "B or 1", "kH", "kW")
    kernel = prepare_kernel("fft_conv", input, kernel, normalized, behaviour)
    same = check_padding("fft_conv", input, kernel.shape[1:], border_type, padding)
    return _correlate(pixels(input), kernel, border_type, same)
