"""Median blur."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Border
from kvision._dtype import pixels
from kvision._modes import BORDER, BORDER_NAMES
from kvision._modules import FunctionModule
from kvision._ops import register, vjp
from kvision._torch_compat import in_onnx_export
from kvision.core.border import windows


def _reference(x: Tensor, ky: int, kx: int, border: int) -> Tensor:
    taps = windows(x, ky, kx, BORDER_NAMES[border])
    median = taps.detach().sort(0).values[(ky * kx - 1) // 2]
    # amax shares its gradient evenly; with the median's sign, so that no median ties with the filling.
    sign = torch.where(median < 0, -1, 1)
    at_median = sign * torch.where(taps == median, sign * taps, -torch.inf).amax(0)
    return torch.where(taps.isnan().any(0), torch.nan, at_median)


def _backward_reference(grad: Tensor, x: Tensor, y: Tensor, ky: int, kx: int, border: int) -> Tensor:
    return vjp(_reference)(grad, x, ky, kx, border)


_median_blur = register(
    "median_blur", _reference, gradients="input: median_blur_backward(output=detach(result))", bytes=True
)
_backward = register("median_blur_backward", _backward_reference, layout_of=1)


def median_blur(input: Tensor, kernel_size: tuple[int, int] | int, border_type: Border = "reflect") -> Tensor:
    """Replace every pixel by the median of its window, for an even count of pixels by the lower middle one.

    The gradient goes to the pixel that is the median; where several pixels of a window equal it, they share it evenly.

    Args:
        input: image (B, C, H, W), floating point, integers or bool.
        kernel_size: size of the window, an int or (y, x); an even window reaches one pixel further right and down.
        border_type: 'constant' (zeros, which take part in the median), 'reflect', 'replicate' or 'circular'.

    Returns:
        The filtered image, in the type of `input`; NaN where the window holds a NaN. Infinities are ordinary values.

    Raises:
        TypeCheckError: input is not a real tensor; kernel_size is not of ints.
        ShapeError: input is not (B, C, H, W); a border wider than the image.
        ValueCheckError: a kernel size below 1, an unknown border_type.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[1., 9., 2., 3., 3.]]]])
        >>> K.filters.median_blur(x, (1, 3))
        tensor([[[[9., 2., 3., 3., 3.]]]])
    """
    _check.images("median_blur", "input", input)
    ky, kx = _check.pair("median_blur", "kernel_size", kernel_size)
    _check.border("median_blur", border_type)
    _check.reflectable("median_blur", input, (ky // 2, kx // 2), border_type)
    if input.is_floating_point() or input.dtype in (torch.uint8, torch.uint64):
        return _median_blur(pixels(input), ky, kx, BORDER[border_type])
    if input.element_size() == 8 and not _fits_float64(input):
        return windows(input, ky, kx, border_type).kthvalue((ky * kx + 1) // 2, 0).values
    exact = input.double() if input.element_size() >= 4 else input.float()
    return _median_blur(exact, ky, kx, BORDER[border_type]).to(input.dtype)


def _fits_float64(x: Tensor) -> bool:
    """Whether values of int64 can be read without waiting and are exact in float64."""
    if in_onnx_export():
        return True  # ONNX has no kthvalue; labels below 2^53 are exact
    if x.numel() == 0 or not _check.values_are_readable(x):
        return x.numel() == 0
    low, high = x.aminmax()
    return -(2**53) <= int(low) and int(high) <= 2**53


class MedianBlur(FunctionModule):
    """Module form of :func:`median_blur`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.MedianBlur(3)(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(self, kernel_size: tuple[int, int] | int, border_type: Border = "reflect") -> None:
        super().__init__(kernel_size=kernel_size, border_type=border_type)

    def forward(self, input: Tensor) -> Tensor:
        return median_blur(input, self.kernel_size, self.border_type)
