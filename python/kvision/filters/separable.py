"""Filtering with a kernel that is the product of a column and a row."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._dtype import pixels
from kvision._ops import as_stored
from kvision.filters.border import pad, same_pads
from kvision.filters.filter2d import check_padding, correlate, prepare_kernel


def _reference(x: Tensor, kernel_x: Tensor, kernel_y: Tensor, border: str, same: bool) -> Tensor:
    for kernel in (kernel_x[:, None, :], kernel_y[:, :, None]):
        if same:
            x = pad(x, same_pads(kernel.shape[1:]), border)
        x = correlate(x, kernel)
    return x


_filter2d_separable = as_stored(_reference)


def filter2d_separable(
    input: Tensor,
    kernel_x: Tensor,
    kernel_y: Tensor,
    border_type: str = "reflect",
    normalized: bool = False,
    padding: str = "same",
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
    return _filter2d_separable(pixels(input), kernel_x, kernel_y, border_type, same)
