"""Laplacian with a kernel of ones around a negative center."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._choices import Border
from kvision._dtype import pixels
from kvision._modes import BORDER
from kvision._modules import FunctionModule
from kvision._ops import register, transpose
from kvision.filters.kernels import laplacian_sizes
from kvision.filters.smoothing.box import divide_exactly, window_sum


def _reference(x: Tensor, ky: int, kx: int, normalized: bool, border: int) -> Tensor:
    n = ky * kx
    y = window_sum(x, ky, kx, border) - n * x
    return divide_exactly(y, 2 * (n - 1)) if normalized else y


_laplacian = register("laplacian", _reference, gradients="input: laplacian_backward", linear=True, bytes=True)
register("laplacian_backward", transpose(_reference), gradients="grad: laplacian(input=grad_grad)", linear=True)


def laplacian(
    input: Tensor, kernel_size: tuple[int, int] | int, border_type: Border = "reflect", normalized: bool = True
) -> Tensor:
    """Filter an image with ones around a center of 1 - kH * kW: the sum of every window less kH * kW times its center.

    Args:
        input: image (B, C, H, W). uint8 gives uint8 (rounded half to even, saturated), other integers give float32.
        kernel_size: size of the kernel, an odd int or (y, x), at least 3 along one axis.
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.
        normalized: divide by the sum of the kernel's absolute values, 2 (kH * kW - 1).

    Returns:
        The Laplacian: positive in dark spots, negative in bright ones.

    Raises:
        TypeCheckError: input is not a real tensor; kernel_size is not of ints.
        ShapeError: input is not (B, C, H, W); a border wider than the image.
        ValueCheckError: an even kernel size or one of 1 x 1, an unknown border_type.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 0., 4., 0., 0.]]]])
        >>> K.filters.laplacian(x, (1, 3))
        tensor([[[[ 0.,  1., -2.,  1.,  0.]]]])
    """
    _check.images("laplacian", "input", input)
    ky, kx = laplacian_sizes("laplacian", kernel_size, 2)
    _check.flag("laplacian", "normalized", normalized)
    _check.border("laplacian", border_type)
    _check.reflectable("laplacian", input, (ky // 2, kx // 2), border_type)
    return _laplacian(pixels(input), ky, kx, normalized, BORDER[border_type])


class Laplacian(FunctionModule):
    """Module form of :func:`laplacian`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.Laplacian(5)(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self, kernel_size: tuple[int, int] | int, border_type: Border = "reflect", normalized: bool = True
    ) -> None:
        super().__init__(kernel_size=kernel_size, border_type=border_type, normalized=normalized)

    def forward(self, input: Tensor) -> Tensor:
        return laplacian(input, self.kernel_size, self.border_type, self.normalized)
