"""Responses of corners and blobs: a score of each pixel of an image, high at corners or blobs."""

from __future__ import annotations

import math
from typing import get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import DerivativeMode
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._limits import COARSE_REACH, CORNER_REACH, FINE_REACH
from kvision._modes import CORNER_KIND, DERIVATIVE_MODE, DERIVATIVE_MODE_NAMES
from kvision._modules import FunctionModule
from kvision._ops import register, transpose, vjp
from kvision.core.exceptions import ShapeError
from kvision.filters.edges.spatial_gradient import derivatives
from kvision.filters.separable import filter_separably
from kvision.filters.smoothing.gaussian import axis_kernels, gaussian_blur2d
from kvision.geometry.linalg import root

__all__ = [
    "BlobDoG",
    "BlobDoGSingle",
    "BlobHessian",
    "CornerGFTT",
    "CornerHarris",
    "dog_response",
    "dog_response_single",
    "gftt_response",
    "harris_response",
    "hessian_response",
]

_MODES = get_args(DerivativeMode)

_WINDOW, _SIGMA = 2 * CORNER_REACH + 1, 1.0
_HARRIS, _GFTT = CORNER_KIND["harris"], CORNER_KIND["gftt"]


def _corner_reference(
    x: Tensor, k: Tensor | None, sigmas: Tensor | None, fixed_k: float, kind: int, mode: int
) -> Tensor:
    dx, dy = derivatives(x, DERIVATIVE_MODE_NAMES[mode], 1, True).unbind(2)
    products = torch.cat([dx * dx, dy * dy, dx * dy], 1)
    kernel_y, kernel_x = axis_kernels(x, None, _WINDOW, _WINDOW, _SIGMA, _SIGMA)
    xx, yy, xy = filter_separably(products, kernel_x, kernel_y, "reflect").chunk(3, 1)
    if kind == _GFTT:
        # The discriminant as a sum of squares is never negative, and its root has a gradient of 0 where it is 0.
        response = (xx + yy - root((xx - yy) ** 2 + 4 * xy * xy)) / 2
    else:
        response = xx * yy - xy * xy - (fixed_k if k is None else _per_sample(k)) * (xx + yy) ** 2
    return _scaled(response, sigmas)


def _hessian_reference(x: Tensor, sigmas: Tensor | None, mode: int) -> Tensor:
    xx, xy, yy = derivatives(x, DERIVATIVE_MODE_NAMES[mode], 2, True).unbind(2)
    return _scaled(xx * yy - xy * xy, sigmas)


def _per_sample(values: Tensor) -> Tensor:
    return values[:, None, None, None]


def _scaled(response: Tensor, sigmas: Tensor | None) -> Tensor:
    return response if sigmas is None else response * _per_sample(sigmas.pow(4))


def _corner_parameter_gradients(needs, grad, x, k, sigmas, fixed_k, kind, mode):
    grads = [None, None, None]
    promoted = as_dtype(x, compute_dtype(x))
    if needs[1] and kind == _GFTT:
        grads[1] = torch.zeros_like(k)
    elif needs[1]:  # the response is linear in k
        at_one, at_zero = (_corner_response(promoted, None, sigmas, value, kind, mode) for value in (1.0, 0.0))
        grads[1] = _sum_samples(grad * (at_one - at_zero), k)
    if needs[2]:
        unscaled = _corner_response(promoted, k, None, fixed_k, kind, mode)
        grads[2] = 4 * sigmas**3 * _sum_samples(grad * unscaled, sigmas)
    return grads


def _hessian_parameter_gradients(needs, grad, x, sigmas, mode):
    unscaled = _hessian_response(as_dtype(x, compute_dtype(x)), None, mode)
    return [None, 4 * sigmas**3 * _sum_samples(grad * unscaled, sigmas)]


def _sum_samples(products: Tensor, values: Tensor) -> Tensor:
    """The sums of samples (B,), or the sum of all samples if `values` has one for all."""
    sums = products.sum((1, 2, 3))
    return sums if len(values) == len(sums) else sums.sum(0, keepdim=True)


_corner_response = register(
    "corner_response",
    _corner_reference,
    gradients="input: corner_response_backward; k, sigmas: by_hand",
    backward=_corner_parameter_gradients,
)
register("corner_response_backward", vjp(_corner_reference), layout_of=1)
_hessian_response = register(
    "hessian_response",
    _hessian_reference,
    gradients="input: hessian_response_backward; sigmas: by_hand",
    backward=_hessian_parameter_gradients,
)
register("hessian_response_backward", vjp(_hessian_reference), layout_of=1)


_DOG_WINDOWS = (
    2 * FINE_REACH + 1,
    2 * COARSE_REACH + 1,
)  # sizes of windows that the kernel supports: those of the default sigmas


def _dog_reference(x: Tensor, sigma1: float, sigma2: float) -> Tensor:
    def blur(size: int, sigma: float) -> Tensor:
        kernel_y, kernel_x = axis_kernels(x, None, size, size, sigma, sigma)
        return filter_separably(x, kernel_x, kernel_y, "reflect")

    return blur(_DOG_WINDOWS[1], sigma2) - blur(_DOG_WINDOWS[0], sigma1)


_difference_of_gaussians = register(
    "difference_of_gaussians", _dog_reference, gradients="input: difference_of_gaussians_backward", linear=True
)
register(
    "difference_of_gaussians_backward",
    transpose(_dog_reference),
    gradients="grad: difference_of_gaussians(input=grad_grad)",
    linear=True,
)


def _arguments(
    op: str, input: Tensor, grads_mode: DerivativeMode, sigmas: Tensor | None
) -> tuple[Tensor, Tensor | None, int]:
    """The image in floating point, the sigmas in the compute type, and the number of the mode."""
    _check.images(op, "input", input)
    _check.choice(op, "grads_mode", grads_mode, _MODES)
    x = floats(input)
    if sigmas is not None:
        _check.shape(op, "sigmas", sigmas, input.shape[0])
        _check.same_device(op, input=input, sigmas=sigmas)
        sigmas = as_dtype(sigmas, compute_dtype(x))
    return x, sigmas, DERIVATIVE_MODE[grads_mode]


def _corners(
    op: str, input: Tensor, k: Tensor | float, kind: int, grads_mode: DerivativeMode, sigmas: Tensor | None
) -> Tensor:
    x, sigmas, mode = _arguments(op, input, grads_mode, sigmas)
    _check.reflectable(op, x, (_WINDOW // 2, _WINDOW // 2), "reflect", "use hessian_response")
    if isinstance(k, Tensor):
        return _corner_response(x, as_dtype(k, compute_dtype(x)).reshape(1), sigmas, 0.0, kind, mode)
    return _corner_response(x, None, sigmas, float(k), kind, mode)


def harris_response(
    input: Tensor, k: float | Tensor = 0.04, grads_mode: DerivativeMode = "sobel", sigmas: Tensor | None = None
) -> Tensor:
    """Compute Harris' corner response: det M - k trace(M)^2 of the structure tensor M.

    M is the sum of products of the gradients in a 7 x 7 Gaussian window of sigma 1. The response is large at corners
    and negative at edges. Gradients have a replicated border, the window a reflected one.

    Args:
        input: image (B, C, H, W); integers give float32. At least 4 pixels along each side.
        k: a number, or a tensor with one, between 0.04 and 0.06 usually.
        grads_mode: 'sobel', or 'diff' for images that are blurred already.
        sigmas: (B,), whose fourth powers multiply the responses, so that those of a pyramid's levels compare.

    Returns:
        (B, C, H, W).

    Raises:
        TypeCheckError: an argument is not a tensor of real numbers, or no number.
        ShapeError: a shape is not as in Args.
        ValueCheckError: an unknown mode.
        DeviceError: the tensors are on different devices.

    Source: C. Harris and M. Stephens, "A combined corner and edge detector" (1988).

    Example:
        >>> import torch, kvision as K
        >>> square = torch.zeros(1, 1, 9, 9)
        >>> square[..., 4:, 4:] = 1
        >>> K.feature.harris_response(square)[0, 0].argmax()
        tensor(40)
    """
    op = "harris_response"
    if isinstance(k, Tensor):
        _check.images(op, "input", input)
        _check.numbers(op, "k", k)
        _check.same_device(op, input=input, k=k)
        if k.numel() != 1:
            raise ShapeError(f"{op}: expected k to be one number, got {tuple(k.shape)}")
    else:
        _check.number(op, "k", k)
    return _corners(op, input, k, _HARRIS, grads_mode, sigmas)


def gftt_response(input: Tensor, grads_mode: DerivativeMode = "sobel", sigmas: Tensor | None = None) -> Tensor:
    """Compute Shi and Tomasi's corner response ("good features to track"): the smaller eigenvalue of the structure tensor.

    The structure tensor is that of :func:`harris_response`.

    Args:
        input: image (B, C, H, W); integers give float32. At least 4 pixels along each side.
        grads_mode: 'sobel', or 'diff' for images that are blurred already.
        sigmas: (B,), whose fourth powers multiply the responses, so that those of a pyramid's levels compare.

    Returns:
        (B, C, H, W), not negative up to rounding.

    Raises:
        TypeCheckError: an argument is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.
        ValueCheckError: an unknown mode.
        DeviceError: the tensors are on different devices.

    Source: J. Shi and C. Tomasi, "Good features to track" (1994).

    Example:
        >>> import torch, kvision as K
        >>> K.feature.gftt_response(torch.arange(8.0).expand(1, 1, 8, 8)).max() < 1e-6
        tensor(True)
    """
    return _corners("gftt_response", input, 0.0, _GFTT, grads_mode, sigmas)


def hessian_response(input: Tensor, grads_mode: DerivativeMode = "sobel", sigmas: Tensor | None = None) -> Tensor:
    """Compute the determinant of the Hessian: positive at bright and dark blobs, negative at saddles.

    Derivatives have a replicated border.

    Args:
        input: image (B, C, H, W); integers give float32.
        grads_mode: 'sobel', or 'diff' for images that are blurred already.
        sigmas: (B,), whose fourth powers multiply the responses, so that those of a pyramid's levels compare.

    Returns:
        (B, C, H, W).

    Raises:
        TypeCheckError: an argument is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.
        ValueCheckError: an unknown mode.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> y, x = torch.meshgrid(torch.arange(9.0), torch.arange(9.0), indexing="ij")
        >>> K.feature.hessian_response((x**2 + y**2)[None, None] / 2)[0, 0, 4, 4]
        tensor(1.)
    """
    x, sigmas, mode = _arguments("hessian_response", input, grads_mode, sigmas)
    return _hessian_response(x, sigmas, mode)


def dog_response(input: Tensor) -> Tensor:
    """Compute differences of Gaussians from levels of increasing blur: level l + 1 minus level l.

    Args:
        input: levels (B, C, L, H, W); integers give float32.

    Returns:
        (B, C, L - 1, H, W): negative at bright blobs, positive at dark ones.

    Raises:
        TypeCheckError: `input` is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.dog_response(torch.rand(2, 1, 5, 8, 8)).shape
        torch.Size([2, 1, 4, 8, 8])
    """
    _check.volumes("dog_response", "input", input)
    x = floats(input)
    return x[:, :, 1:] - x[:, :, :-1]


def dog_response_single(input: Tensor, sigma1: float = 1.0, sigma2: float = 1.6) -> Tensor:
    """Compute the difference of two Gaussian blurs: that with `sigma2` minus that with `sigma1`.

    Kernels have int(8 sigma + 1) pixels, rounded up to an odd number, and a reflected border. Along a side of n pixels
    they have at most 2 n - 1, so that a reflection is within the image.

    Args:
        input: image (B, C, H, W); integers give float32.
        sigma1: in pixels, above 0.
        sigma2: in pixels, above 0.

    Returns:
        (B, C, H, W).

    Raises:
        TypeCheckError: `input` is not a tensor of real numbers, a sigma not a number.
        ShapeError: a shape is not as in Args.
        ValueCheckError: a sigma is not above 0.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.dog_response_single(torch.ones(1, 1, 20, 20)).abs().max() < 1e-6
        tensor(True)
    """
    op = "dog_response_single"
    _check.images(op, "input", input)
    x = floats(input)
    sizes = []
    for name, sigma in (("sigma1", sigma1), ("sigma2", sigma2)):
        if not 0 < _check.number(op, name, sigma) < math.inf:
            raise _check.ValueCheckError(f"{op}: expected {name} above 0 and finite, got {sigma!r}")
        sizes.append([min(int(8 * sigma + 1) // 2 * 2 + 1, 2 * side - 1) for side in x.shape[2:]])
    if sizes == [[size, size] for size in _DOG_WINDOWS]:
        return _difference_of_gaussians(x, float(sigma1), float(sigma2))
    fine, coarse = (
        gaussian_blur2d(x, (size[0], size[1]), (float(sigma), float(sigma)))
        for size, sigma in zip(sizes, (sigma1, sigma2))
    )
    return coarse - fine


class CornerHarris(FunctionModule):
    """Module form of :func:`harris_response`, whose `k` is a buffer.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.CornerHarris(0.04)(torch.rand(2, 1, 8, 8)).shape
        torch.Size([2, 1, 8, 8])
    """

    k: Tensor

    def __init__(self, k: float | Tensor, grads_mode: DerivativeMode = "sobel") -> None:
        if not isinstance(k, Tensor):
            _check.number("CornerHarris", "k", k)
        super().__init__(grads_mode=grads_mode)
        self.number = None if isinstance(k, Tensor) else float(k)
        self.register_buffer("k", k if isinstance(k, Tensor) else torch.tensor(float(k)))
        if self.k.numel() != 1:
            raise ShapeError(f"CornerHarris: expected k to be one number, got {tuple(self.k.shape)}")
        self._refuse_wrong_arguments([])  # which needs k

    def forward(self, input: Tensor, sigmas: Tensor | None = None) -> Tensor:
        return harris_response(input, self.k, self.grads_mode, sigmas)


class CornerGFTT(FunctionModule):
    """Module form of :func:`gftt_response`.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.CornerGFTT()(torch.rand(2, 1, 8, 8)).shape
        torch.Size([2, 1, 8, 8])
    """

    def __init__(self, grads_mode: DerivativeMode = "sobel") -> None:
        super().__init__(grads_mode=grads_mode)

    def forward(self, input: Tensor, sigmas: Tensor | None = None) -> Tensor:
        return gftt_response(input, self.grads_mode, sigmas)


class BlobHessian(FunctionModule):
    """Module form of :func:`hessian_response`.

    Example:
        >>> import torch, kvision as K
        >>> K.BlobHessian()(torch.rand(2, 1, 8, 8)).shape
        torch.Size([2, 1, 8, 8])
    """

    def __init__(self, grads_mode: DerivativeMode = "sobel") -> None:
        super().__init__(grads_mode=grads_mode)

    def forward(self, input: Tensor, sigmas: Tensor | None = None) -> Tensor:
        return hessian_response(input, self.grads_mode, sigmas)


class BlobDoG(FunctionModule):
    """Module form of :func:`dog_response`; it ignores `sigmas`.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.BlobDoG()(torch.rand(2, 1, 5, 8, 8)).shape
        torch.Size([2, 1, 4, 8, 8])
    """

    def __init__(self) -> None:
        super().__init__()

    def forward(self, input: Tensor, sigmas: Tensor | None = None) -> Tensor:
        return dog_response(input)


class BlobDoGSingle(FunctionModule):
    """Module form of :func:`dog_response_single`; it ignores `sigmas`.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.BlobDoGSingle()(torch.rand(2, 1, 20, 20)).shape
        torch.Size([2, 1, 20, 20])
    """

    def __init__(self, sigma1: float = 1.0, sigma2: float = 1.6) -> None:
        super().__init__(sigma1=sigma1, sigma2=sigma2)

    def forward(self, input: Tensor, sigmas: Tensor | None = None) -> Tensor:
        return dog_response_single(input, self.sigma1, self.sigma2)
