"""Gaussian blur."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Border
from kvision._dtype import as_dtype, compute_dtype, floats, pixels
from kvision._modes import BORDER, BORDER_NAMES
from kvision._modules import FunctionModule
from kvision._ops import register, transpose
from kvision.core.exceptions import ShapeError
from kvision.filters.kernels import gaussian, sigmas
from kvision.filters.separable import filter_separably, weight_gradients


def _reference(
    x: Tensor, sigma: Tensor | None, ky: int, kx: int, sigma_y: float, sigma_x: float, border: int
) -> Tensor:
    kernel_y, kernel_x = axis_kernels(x, sigma, ky, kx, sigma_y, sigma_x)
    return filter_separably(x, kernel_x, kernel_y, BORDER_NAMES[border])


def sigma_gradient(
    grad: Tensor, x: Tensor, sigma: Tensor, ky: int, kx: int, sigma_y: float, sigma_x: float, border: int
) -> Tensor:
    """The gradient to sigma from the gradient to the blurred `x`, through the weights.

    The weights sum to 1, so most of their gradient cancels: it goes on in float64.
    """
    (kernel_y, kernel_x), vjp_fn = torch.func.vjp(
        lambda s: axis_kernels(x, s, ky, kx, sigma_y, sigma_x, torch.float64), sigma.double()
    )
    dtype = compute_dtype(x)
    gradients = weight_gradients((True, True), grad, x, kernel_x.to(dtype), kernel_y.to(dtype), border)
    grad_x, grad_y = (g.double() for g in gradients if g is not None)
    return vjp_fn((grad_y, grad_x))[0].to(sigma.dtype)


_gaussian_blur2d = register(
    "gaussian_blur2d",
    _reference,
    gradients="input: gaussian_blur2d_backward; sigma: by_hand",
    backward=lambda needs, grad, x, *blur: [None, sigma_gradient(grad, x, *blur)],
    linear=True,
    bytes=True,
)
_transposed = register(
    "gaussian_blur2d_backward",
    transpose(_reference),
    gradients="grad: gaussian_blur2d(input=grad_grad); sigma: by_hand",
    backward=lambda needs, grad_grad, grad, *blur: [None, sigma_gradient(grad, grad_grad, *blur)],
    linear=True,
)


def _reference_levels(x: Tensor, sizes: list[int], sigmas: list[float], border: int) -> Tensor:
    levels = [x]
    for size, sigma in zip(sizes, sigmas):
        levels.append(_reference(levels[-1], None, size, size, sigma, sigma, border))
    return torch.stack(levels, 2)


def _levels_backward(needs, grad, _, sizes, sigmas, border):
    steps = enumerate(zip(sizes, sigmas))
    grad_level = grad[:, :, -1]
    for i, (size, sigma) in reversed(list(steps)):
        grad_level = grad[:, :, i] + _transposed(grad_level, None, size, size, sigma, sigma, border)
    return [grad_level]


_gaussian_levels = register(
    "gaussian_levels",
    _reference_levels,
    fake=lambda x, sizes, *_: (*x.shape[:2], 1 + len(sizes), *x.shape[2:]),
    backward=_levels_backward,
    linear=True,
)


def gaussian_levels(input: Tensor, sizes: list[int], sigmas: list[float], border_type: Border = "reflect") -> Tensor:
    """Levels (B, C, 1 + n, H, W) of an image (B, C, H, W), each blurred to the next one by sizes[i] x sizes[i] and sigmas[i]."""
    _check.images("gaussian_levels", "input", input)
    _check.border("gaussian_levels", border_type)
    for size in sizes:
        _check.reflectable("gaussian_levels", input, (size // 2, size // 2), border_type)
    return _gaussian_levels(floats(input), sizes, sigmas, BORDER[border_type])


def gaussian_blur2d(
    input: Tensor,
    kernel_size: tuple[int, int] | int,
    sigma: tuple[float, float] | Tensor | float,
    border_type: Border = "reflect",
    separable: bool = True,
) -> Tensor:
    """Blur an image with a Gaussian: weights exp(-d^2 / (2 sigma^2)), divided by their sum.

    Args:
        input: image (B, C, H, W). uint8 gives uint8 (rounded half to even), other integers give float32.
        kernel_size: size of the window, an odd int or (y, x).
        sigma: standard deviation in pixels, a number, (y, x), or a tensor (1, 2) or (B, 2), which may carry a gradient.
            Where a tensor is not positive the result is NaN, as its values are not read on the host.
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.
        separable: for compatibility; the result is the same.

    Returns:
        The blurred image; differentiable in image and sigma.

    Raises:
        TypeCheckError: input is not a real tensor; kernel_size or sigma of the wrong type.
        ShapeError: wrong ranks or batch sizes; a border wider than the image.
        ValueCheckError: an even kernel size, a sigma that is not positive, an unknown border_type.
        DeviceError: a sigma on another device; one in CPU memory is moved.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 0., 1., 0., 0.]]]])
        >>> K.filters.gaussian_blur2d(x, (1, 3), (1.0, 1.0))
        tensor([[[[0.0000, 0.2741, 0.4519, 0.2741, 0.0000]]]])
    """
    return _gaussian_blur2d(*blur_arguments("gaussian_blur2d", input, kernel_size, sigma, border_type))


class GaussianBlur2d(FunctionModule):
    """Module form of :func:`gaussian_blur2d`; a sigma that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.GaussianBlur2d(5, (1.5, 1.5))(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        kernel_size: tuple[int, int] | int,
        sigma: tuple[float, float] | Tensor | float,
        border_type: Border = "reflect",
        separable: bool = True,
    ) -> None:
        super().__init__(kernel_size=kernel_size, sigma=sigma, border_type=border_type, separable=separable)

    def forward(self, input: Tensor) -> Tensor:
        return gaussian_blur2d(input, self.kernel_size, self.sigma, self.border_type, self.separable)


def blur_arguments(
    op: str,
    input: Tensor,
    kernel_size: tuple[int, int] | int,
    sigma: tuple[float, float] | Tensor | float,
    border_type: Border,
) -> tuple[Tensor, Tensor | None, int, int, float, float, int]:
    """The checked arguments of a Gaussian as its operators take them: sigma as a tensor, or as two floats with None."""
    _check.images(op, "input", input)
    ky, kx = _check.pair(op, "kernel_size", kernel_size)
    _check.odd(op, "kernel_size", (ky, kx))
    tensor, sigma_y, sigma_x = sigma_arguments(op, "sigma", input, sigma)
    _check.border(op, border_type)
    _check.reflectable(op, input, (ky // 2, kx // 2), border_type)
    return pixels(input), tensor, ky, kx, sigma_y, sigma_x, BORDER[border_type]


def sigma_arguments(
    op: str, name: str, x: Tensor, value: tuple[float, float] | Tensor | float
) -> tuple[Tensor | None, float, float]:
    """Sigmas for images `x`: (tensor (B or 1, 2), 0, 0) or (None, sigma_y, sigma_x)."""
    checked = sigmas(op, name, value, 2)
    if isinstance(checked, Tensor):
        return batch_of(op, name, x, checked), 0.0, 0.0
    sigma_y, sigma_x = checked
    return None, sigma_y, sigma_x


def batch_of(op: str, name: str, x: Tensor, values: Tensor) -> Tensor:
    """`values` as images `x` are computed, in type and device; raise unless there is one row, or one for each image."""
    if not _check.is_one_or(values.shape[0], x.shape[0]):
        raise ShapeError(
            f"{op}: expected {name} with a batch size of 1 or {x.shape[0]}, got {tuple(values.shape)}",
            actual_shape=values.shape,
        )
    return as_dtype(_check.to_device_of(op, x, name, values), compute_dtype(x))


def axis_kernels(
    x: Tensor,
    sigma: Tensor | None,
    ky: int,
    kx: int,
    sigma_y: float,
    sigma_x: float,
    dtype: torch.dtype | None = None,
) -> tuple[Tensor, Tensor]:
    """The Gaussian kernels (B or 1, ky) and (B or 1, kx) for images `x`, by default in the type that is computed in."""
    columns = (sigma_y, sigma_x) if sigma is None else positive(sigma)[:, :, None].unbind(1)
    dtype = dtype or compute_dtype(x)
    return (
        gaussian(ky, columns[0], device=x.device, dtype=dtype),
        gaussian(kx, columns[1], device=x.device, dtype=dtype),
    )


def windowed(size: int, half: Tensor, sigma: Tensor) -> Tensor:
    """Gaussian kernels (B, size) of deviations (B or 1, 1), 0 from more than `half`, (B, 1), pixels off their centers."""
    kernels = gaussian(size, positive(sigma))
    outside = (torch.arange(size, device=half.device) - size // 2).abs() > half
    kernels = kernels.masked_fill(outside, 0.0)
    return kernels / kernels.sum(1, keepdim=True)


def positive(values: Tensor) -> Tensor:
    """`values`, NaN where they are not positive: an invalid sigma makes its images NaN without a synchronization."""
    return torch.where(values > 0, values, torch.nan)
