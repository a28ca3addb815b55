"""First and second derivatives of images and volumes."""

from __future__ import annotations

import functools

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import DerivativeMode
from kvision._dtype import floats, pixels
from kvision._modes import DERIVATIVE_MODE, DERIVATIVE_MODE_NAMES
from kvision._modules import VOLUME, FunctionModule
from kvision._ops import register
from kvision.core.border import pad
from kvision.filters.kernels import check_derivative, derivative_rows


def _along(x: Tensor, axis: int, row: tuple[int, ...]) -> Tensor:
    """Cross-correlate one axis with a row of small numbers, where it fits inside; pixels under a zero are not read."""
    n = x.shape[axis] - len(row) + 1
    return functools.reduce(torch.add, [weight * x.narrow(axis, i, n) for i, weight in enumerate(row) if weight])


def derivatives(x: Tensor, mode: str, order: int, normalized: bool) -> Tensor:
    """(B, C, N, *S): the N derivatives of an image or volume (B, C, *S), with a replicated border."""
    axes = x.dim() - 2
    reach = 2 if (mode, order) == ("sobel", 2) else 1
    padded = pad(x, ((reach, reach),) * axes, "replicate")
    channels = []
    for rows, unit in derivative_rows(mode, order, axes):
        y = padded
        for axis, row in enumerate(rows, 1):  # rows are along x, y, z
            y = _along(y, -axis, row)
        channels.append(y / unit if normalized else y)
    return torch.stack(channels, 2)


def _reference(x: Tensor, mode: int, order: int, normalized: bool) -> Tensor:
    return derivatives(x, DERIVATIVE_MODE_NAMES[mode], order, normalized)


def _transposed(grad: Tensor, mode: str, order: int, normalized: bool) -> Tensor:
    x = grad.new_zeros(grad.shape[:2] + grad.shape[3:])
    _, vjp_fn = torch.func.vjp(lambda x: derivatives(x, mode, order, normalized), x)
    return vjp_fn(grad)[0]


def _backward_reference(grad: Tensor, mode: int, order: int, normalized: bool) -> Tensor:
    return _transposed(grad, DERIVATIVE_MODE_NAMES[mode], order, normalized)


_spatial_gradient = register(
    "spatial_gradient",
    _reference,
    fake=lambda x, mode, order, normalized: (*x.shape[:2], order + 1, *x.shape[2:]),
    gradients="input: spatial_gradient_backward",
    linear=True,
    bytes=True,
    float_results=True,
)
register(
    "spatial_gradient_backward",
    _backward_reference,
    fake=lambda grad, mode, order, normalized: (*grad.shape[:2], *grad.shape[3:]),
    gradients="grad: spatial_gradient(input=grad_grad)",
    linear=True,
)


def spatial_gradient(input: Tensor, mode: DerivativeMode = "sobel", order: int = 1, normalized: bool = True) -> Tensor:
    """Derivatives of an image, with a replicated border.

    Args:
        input: image (B, C, H, W); integers give float32.
        mode: 'sobel' also smooths across the derivative, 'diff' is the central difference.
        order: 1 or 2.
        normalized: give true derivatives: 1 on a ramp of slope 1 and, for order 2, on x^2 / 2 and on x y. Otherwise the
            kernels are whole numbers, see :func:`get_spatial_gradient_kernel2d`.

    Returns:
        (B, C, 2, H, W), derivatives (x, y), or for order 2 (B, C, 3, H, W), derivatives (xx, xy, yy).

    Raises:
        TypeCheckError: input is not a real tensor.
        ShapeError: input is not (B, C, H, W).
        ValueCheckError: an unknown mode or order.

    Example:
        >>> import torch, kvision as K
        >>> ramp = torch.arange(4.0).expand(1, 1, 3, 4)
        >>> K.filters.spatial_gradient(ramp)[0, 0, 0, 1]
        tensor([0.5000, 1.0000, 1.0000, 0.5000])
    """
    _check.images("spatial_gradient", "input", input)
    order = check_derivative("spatial_gradient", mode, order)
    _check.flag("spatial_gradient", "normalized", normalized)
    return _spatial_gradient(pixels(input), DERIVATIVE_MODE[mode], order, normalized)


class SpatialGradient(FunctionModule):
    """Module form of :func:`spatial_gradient`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.SpatialGradient(order=2)(torch.rand(2, 1, 8, 8)).shape
        torch.Size([2, 1, 3, 8, 8])
    """

    def __init__(self, mode: DerivativeMode = "sobel", order: int = 1, normalized: bool = True) -> None:
        super().__init__(mode=mode, order=order, normalized=normalized)

    def forward(self, input: Tensor) -> Tensor:
        return spatial_gradient(input, self.mode, self.order, self.normalized)


_spatial_gradient3d = register(
    "spatial_gradient3d",
    lambda x, order: derivatives(x, "diff", order, True),
    fake=lambda x, order: (*x.shape[:2], 3 * order, *x.shape[2:]),
    gradients="input: spatial_gradient3d_backward",
    linear=True,
)
register(
    "spatial_gradient3d_backward",
    lambda grad, order: _transposed(grad, "diff", order, True),
    fake=lambda grad, order: (*grad.shape[:2], *grad.shape[3:]),
    gradients="grad: spatial_gradient3d(input=grad_grad)",
    linear=True,
)


def spatial_gradient3d(input: Tensor, mode: DerivativeMode = "diff", order: int = 1) -> Tensor:
    """Derivatives of a volume by central differences, with a replicated border.

    Args:
        input: volume (B, C, D, H, W); integers give float32.
        mode: 'diff'.
        order: 1 or 2.

    Returns:
        (B, C, 3, D, H, W), derivatives (x, y, z), or for order 2 (B, C, 6, D, H, W), derivatives
        (xx, yy, zz, xy, yz, xz); 1 on a ramp of slope 1, on x^2 / 2 and on x y.

    Raises:
        TypeCheckError: input is not a real tensor.
        ShapeError: input is not (B, C, D, H, W).
        ValueCheckError: an unknown mode or order.
        NotImplementedError: mode 'sobel'.

    Example:
        >>> import torch, kvision as K
        >>> ramp = torch.arange(4.0).expand(1, 1, 2, 3, 4)
        >>> K.filters.spatial_gradient3d(ramp)[0, 0, 0, 0, 0]
        tensor([0.5000, 1.0000, 1.0000, 0.5000])
    """
    _check.volumes("spatial_gradient3d", "input", input)
    order = check_derivative("spatial_gradient3d", mode, order, axes=3)
    return _spatial_gradient3d(floats(input), order)


class SpatialGradient3d(FunctionModule):
    """Module form of :func:`spatial_gradient3d`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.SpatialGradient3d(order=2)(torch.rand(1, 1, 4, 4, 4)).shape
        torch.Size([1, 1, 6, 4, 4, 4])
    """

    samples = (VOLUME,)

    def __init__(self, mode: DerivativeMode = "diff", order: int = 1) -> None:
        super().__init__(mode=mode, order=order)

    def forward(self, input: Tensor) -> Tensor:
        return spatial_gradient3d(input, self.mode, self.order)
