"""Pooling with a blur against aliasing."""

from __future__ import annotations

import math
import warnings

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._modules import FunctionModule
from kvision._ops import with_kernel_casts
from kvision.core.border import pad
from kvision.core.exceptions import ValueCheckError
from kvision.filters.kernels import binomial
from kvision.filters.separable import filter2d_separable


@with_kernel_casts
def _blur_pool(x: Tensor, ky: int, kx: int, stride: int) -> Tensor:
    # All pixels by the kernel of two passes take less time than the kept ones by a strided convolution of torch.
    blurred = filter2d_separable(x, binomial(kx, x.device, x.dtype), binomial(ky, x.device, x.dtype), "constant")
    return blurred[..., ::stride, ::stride]


def blur_pool2d(input: Tensor, kernel_size: tuple[int, int] | int, stride: int = 2) -> Tensor:
    """Blur with a binomial kernel (a row of Pascal's triangle along each axis) and keep every stride-th pixel.

    The border is zeros: (k - 1) // 2 before an axis and k // 2 after it.

    Args:
        input: features (B, C, H, W). Integers are computed in float32.
        kernel_size: size of the kernel, an int or (y, x).
        stride: step between the pixels that are kept.

    Returns:
        (B, C, ceil(H / stride), ceil(W / stride)).

    Raises:
        TypeCheckError: input is not a real tensor; kernel_size or stride is not of ints.
        ShapeError: input is not (B, C, H, W).
        ValueCheckError: a kernel_size or stride below 1.

    Source: R. Zhang, "Making convolutional networks shift-invariant again" (2019).

    Example:
        >>> import torch, kvision as K
        >>> K.filters.blur_pool2d(torch.ones(1, 1, 4, 4), 3)
        tensor([[[[0.5625, 0.7500],
                  [0.7500, 1.0000]]]])
    """
    return _blur_pool(*_arguments("blur_pool2d", input, kernel_size, stride))


def max_blur_pool2d(
    input: Tensor,
    kernel_size: tuple[int, int] | int,
    stride: int = 2,
    max_pool_size: int = 2,
    ceil_mode: bool | None = None,
) -> Tensor:
    """Take the maximum of every max_pool_size x max_pool_size window, at stride 1 and without border, then blur_pool2d.

    Args:
        input: features (B, C, H, W). Integers are computed in float32.
        kernel_size: size of the blur's kernel, an int or (y, x).
        stride: step between the pixels that are kept.
        max_pool_size: size of the windows of the maximum, at most H and W.
        ceil_mode: without effect and deprecated; sizes never need rounding at stride 1.

    Returns:
        (B, C, ceil(H' / stride), ceil(W' / stride)) with H' = H - max_pool_size + 1, and W' likewise.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError: as :func:`blur_pool2d`, or a max_pool_size larger than the input.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.max_blur_pool2d(torch.ones(1, 1, 5, 5), 3)
        tensor([[[[0.5625, 0.7500],
                  [0.7500, 1.0000]]]])
    """
    if ceil_mode is not None:
        warnings.warn("max_blur_pool2d: ceil_mode is deprecated and has no effect", DeprecationWarning, stacklevel=2)
    x, ky, kx, stride = _arguments("max_blur_pool2d", input, kernel_size, stride)
    (size,) = _check.ints("max_blur_pool2d", "max_pool_size", max_pool_size, 1)
    if size > min(x.shape[2:]):
        raise ValueCheckError(
            f"max_blur_pool2d: expected max_pool_size no larger than the input, got {size} for {tuple(x.shape)}"
        )
    pooled = F.max_pool2d(x.flatten(0, 1)[:, None], size, stride=1)  # as planes: torch pools no 0 channels
    return _blur_pool(pooled.reshape(*x.shape[:2], *pooled.shape[2:]), ky, kx, stride)


def edge_aware_blur_pool2d(
    input: Tensor,
    kernel_size: tuple[int, int] | int,
    edge_threshold: float = 1.25,
    edge_dilation_kernel_size: int = 3,
    epsilon: float = 1e-6,
) -> Tensor:
    """Blur with a binomial kernel, but leave the pixels near edges as they are.

    An edge is where two pixels 4 apart differ by a factor above edge_threshold, in the mean of log2 over the channels.
    The border is reflected.

    Args:
        input: features (B, C, H, W), floating point and not negative; H and W at least 3.
        kernel_size: size of the kernel, an int or (y, x).
        edge_threshold: above 1.
        edge_dilation_kernel_size: side of the square around an edge pixel that stays, odd.
        epsilon: added to the input before the logarithm.

    Returns:
        (B, C, H, W).

    Raises:
        TypeCheckError, ShapeError, ValueCheckError: as :func:`blur_pool2d`; an image no larger than the border; an
            edge_threshold that is not above 1; an even edge_dilation_kernel_size.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([1., 1., 1., 1., 9., 9., 9., 9.]).expand(1, 1, 3, 8)
        >>> K.filters.edge_aware_blur_pool2d(x, 3)[0, 0, 0]
        tensor([1., 1., 1., 1., 9., 9., 9., 9.])
    """
    x, ky, kx, _ = _arguments("edge_aware_blur_pool2d", input, kernel_size, 1)
    (dilation,) = _check.ints("edge_aware_blur_pool2d", "edge_dilation_kernel_size", edge_dilation_kernel_size, 1)
    _check.odd("edge_aware_blur_pool2d", "edge_dilation_kernel_size", (dilation,))
    edge_threshold = _check.number("edge_aware_blur_pool2d", "edge_threshold", edge_threshold)
    epsilon = _check.number("edge_aware_blur_pool2d", "epsilon", epsilon, minimum=0)
    if not edge_threshold > 1:
        raise ValueCheckError(f"edge_aware_blur_pool2d: expected edge_threshold above 1, got {edge_threshold!r}")
    _check.reflectable("edge_aware_blur_pool2d", x, (2, 2), "reflect", "pad to 3 x 3 pixels")
    _check.reflectable("edge_aware_blur_pool2d", x, (ky // 2, kx // 2), "reflect", "use a smaller kernel_size")
    return _edge_aware_blur(x, ky, kx, math.log2(edge_threshold), dilation, epsilon)


@with_kernel_casts
def _edge_aware_blur(x: Tensor, ky: int, kx: int, threshold: float, dilation: int, epsilon: float) -> Tensor:
    log = torch.log2(pad(x, ((2, 2), (2, 2)), "reflect") + epsilon).mean(1, keepdim=True)
    across_x = (log[..., 2:-2, 4:] - log[..., 2:-2, :-4]).abs() > threshold
    across_y = (log[..., 4:, 2:-2] - log[..., :-4, 2:-2]).abs() > threshold
    edges = F.max_pool2d((across_x | across_y).to(x.dtype), dilation, stride=1, padding=dilation // 2) > 0
    kernel_y, kernel_x = binomial(ky, x.device, x.dtype), binomial(kx, x.device, x.dtype)
    return torch.where(edges, x, filter2d_separable(x, kernel_x, kernel_y, "reflect"))


def _arguments(op: str, input: Tensor, kernel_size: tuple[int, int] | int, stride: int) -> tuple[Tensor, int, int, int]:
    _check.images(op, "input", input)
    ky, kx = _check.pair(op, "kernel_size", kernel_size)
    (stride,) = _check.ints(op, "stride", stride, 1)
    return floats(input), ky, kx, stride


class BlurPool2D(FunctionModule):
    """Module form of :func:`blur_pool2d`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.BlurPool2D(3)(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 4, 4])
    """

    def __init__(self, kernel_size: tuple[int, int] | int, stride: int = 2) -> None:
        super().__init__(kernel_size=kernel_size, stride=stride)

    def forward(self, input: Tensor) -> Tensor:
        return blur_pool2d(input, self.kernel_size, self.stride)


class MaxBlurPool2D(FunctionModule):
    """Module form of :func:`max_blur_pool2d`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.MaxBlurPool2D(3)(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 4, 4])
    """

    def __init__(
        self,
        kernel_size: tuple[int, int] | int,
        stride: int = 2,
        max_pool_size: int = 2,
        ceil_mode: bool | None = None,
    ) -> None:
        super().__init__(kernel_size=kernel_size, stride=stride, max_pool_size=max_pool_size, ceil_mode=ceil_mode)

    def forward(self, input: Tensor) -> Tensor:
        return max_blur_pool2d(input, self.kernel_size, self.stride, self.max_pool_size, self.ceil_mode)


class EdgeAwareBlurPool2D(FunctionModule):
    """Module form of :func:`edge_aware_blur_pool2d`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.EdgeAwareBlurPool2D(3)(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self, kernel_size: tuple[int, int] | int, edge_threshold: float = 1.25, edge_dilation_kernel_size: int = 3
    ) -> None:
        super().__init__(
            kernel_size=kernel_size,
            edge_threshold=edge_threshold,
            edge_dilation_kernel_size=edge_dilation_kernel_size,
        )

    def forward(self, input: Tensor, epsilon: float | None = None) -> Tensor:
        return edge_aware_blur_pool2d(
            input,
            self.kernel_size,
            self.edge_threshold,
            self.edge_dilation_kernel_size,
            1e-6 if epsilon is None else epsilon,
        )
