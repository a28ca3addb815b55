"""The kernels filters are made of: Gaussian, box, Laplacian, derivatives, windows. Motion kernels are in motion.py."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import DerivativeMode
from kvision._torch_compat import in_onnx_export
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

_MODES = get_args(DerivativeMode)

# ---------------------------------------------------------------------------------------------------- Gaussian


def gaussian(
    window_size: int,
    sigma: Tensor | float,
    *,
    mean: Tensor | float | None = None,
    device: torch.device | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """Sample a Gaussian at whole pixels and divide by its sum.

    Args:
        window_size: number of samples, at least 1.
        sigma: standard deviation in pixels, a number or a tensor (B, 1); 0 gives an impulse.
        mean: where the peak is, in samples from the first, a number or (B, 1); by default window_size // 2. For an even
            window the peak is half a sample further left.
        device: of the result; by default that of sigma, or of mean where only that is a tensor.
        dtype: of the result, floating point; by default that of sigma.

    Returns:
        (B, window_size), differentiable in sigma and mean.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError: sigma is not a number or (B, 1) tensor, is negative or NaN; a
            window_size below 1; an integer dtype.
        DeviceError: a mean on another device than sigma; one in CPU memory is moved.

    Example:
        >>> import kvision as K
        >>> K.filters.gaussian(3, 1.0)
        tensor([[0.2741, 0.4519, 0.2741]])
    """
    (window_size,) = _check.ints("gaussian", "window_size", window_size, 1)
    if device is None and isinstance(mean, Tensor) and not isinstance(sigma, Tensor):
        device = mean.device
    (sigma,), dtype = _sigma_columns("gaussian", sigma, 1, device, dtype)
    if isinstance(mean, Tensor):
        mean = mean.reshape(1, 1) if mean.dim() == 0 else mean
        _check.shape("gaussian", "mean", mean, "B or 1", 1)
        if mean.shape[0] != sigma.shape[0] and 1 not in (mean.shape[0], sigma.shape[0]):
            raise ShapeError(
                f"gaussian: expected mean with a batch size of 1 or {sigma.shape[0]}, got {tuple(mean.shape)}",
                actual_shape=mean.shape,
            )
        mean = _check.to_device_of("gaussian", sigma, "mean", mean, of="sigma").to(sigma)
    elif mean is not None:
        mean = _check.number("gaussian", "mean", mean)
    return _sampled(window_size, sigma, mean).to(dtype)


def get_gaussian_kernel1d(
    kernel_size: int,
    sigma: Tensor | float,
    force_even: bool = False,
    *,
    device: torch.device | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """Sample a Gaussian at whole pixels and divide by its sum.

    Args:
        kernel_size: number of samples, odd unless force_even.
        sigma: standard deviation in pixels, a number or a tensor (B, 1); 0 gives an impulse.
        force_even: allow even sizes.
        device: of the result; by default that of sigma.
        dtype: of the result, floating point; by default that of sigma.

    Returns:
        (B, kernel_size) of sum 1, differentiable in sigma.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError: as :func:`gaussian`, or an even size.

    Example:
        >>> import kvision as K
        >>> K.filters.get_gaussian_kernel1d(5, 1.5)
        tensor([[0.1201, 0.2339, 0.2921, 0.2339, 0.1201]])
    """
    return _gaussian_product("get_gaussian_kernel1d", 1, kernel_size, sigma, force_even, device, dtype)


def get_gaussian_kernel2d(
    kernel_size: tuple[int, int] | int,
    sigma: Tensor | tuple[float, float] | float,
    force_even: bool = False,
    *,
    device: torch.device | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """Multiply the Gaussian kernels of both axes.

    Args:
        kernel_size: an int or (y, x), odd unless force_even.
        sigma: standard deviation in pixels, a number, (y, x), or a tensor (B, 2).
        force_even: allow even sizes.
        device: of the result; by default that of sigma.
        dtype: of the result, floating point; by default that of sigma.

    Returns:
        (B, kH, kW) of sum 1.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError: as `gaussian`, or an even size.

    Example:
        >>> import kvision as K
        >>> K.filters.get_gaussian_kernel2d((1, 3), (1.0, 1.0))
        tensor([[[0.2741, 0.4519, 0.2741]]])
    """
    return _gaussian_product("get_gaussian_kernel2d", 2, kernel_size, sigma, force_even, device, dtype)


def get_gaussian_kernel3d(
    kernel_size: tuple[int, int, int] | int,
    sigma: Tensor | tuple[float, float, float] | float,
    force_even: bool = False,
    *,
    device: torch.device | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """Multiply the Gaussian kernels of three axes.

    Args:
        kernel_size: an int or (z, y, x), odd unless force_even.
        sigma: standard deviation in pixels, a number, (z, y, x), or a tensor (B, 3).
        force_even: allow even sizes.
        device: of the result; by default that of sigma.
        dtype: of the result, floating point; by default that of sigma.

    Returns:
        (B, kD, kH, kW) of sum 1, differentiable in sigma.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError: as :func:`gaussian`, or an even size.

    Example:
        >>> import kvision as K
        >>> K.filters.get_gaussian_kernel3d((1, 1, 3), (1.0, 1.0, 1.0))
        tensor([[[[0.2741, 0.4519, 0.2741]]]])
    """
    return _gaussian_product("get_gaussian_kernel3d", 3, kernel_size, sigma, force_even, device, dtype)


def get_gaussian_discrete_kernel1d(
    kernel_size: int,
    sigma: Tensor | float,
    force_even: bool = False,
    *,
    device: torch.device | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """The discrete analogue of the Gaussian: weights exp(-t) I_n(t), t = sigma^2 and I_n the modified Bessel functions.

    Blurs with sigmas a and b make exactly one with sqrt(a^2 + b^2), which sampled Gaussians miss where sigma is small.

    Args:
        kernel_size: odd.
        sigma: standard deviation in pixels, a number or a tensor (B, 1); 0 gives an impulse.
        force_even: without effect, the kernel exists for odd sizes only.
        device: of the result; by default that of sigma.
        dtype: of the result, floating point; by default that of sigma.

    Returns:
        (B, kernel_size) of sum 1.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError: as `gaussian`, or an even size.

    Source: T. Lindeberg, "Scale-space for discrete signals" (1990).

    Example:
        >>> import kvision as K
        >>> K.filters.get_gaussian_discrete_kernel1d(3, 1.0)
        tensor([[0.2358, 0.5283, 0.2358]])
    """
    (size,) = _sizes("get_gaussian_discrete_kernel1d", kernel_size, 1)
    (sigma,), dtype = _sigma_columns("get_gaussian_discrete_kernel1d", sigma, 1, device, dtype)
    # The kernel's Fourier transform is exp(-2 t sin^2(w / 2)): transform back by the midpoint rule. In float64 nothing
    # is left of it beyond w = 14 / sigma, and this many nodes resolve the rest.
    sigma = sigma.double()
    nodes = size + 40
    reach = (14 / sigma.detach()).clamp(max=math.pi)
    w = reach * (torch.arange(nodes, device=sigma.device, dtype=sigma.dtype) + 0.5) / nodes
    spectrum = torch.exp(-2 * (sigma * torch.sin(w / 2)) ** 2)
    n = torch.arange(size, device=sigma.device, dtype=sigma.dtype) - size // 2
    kernel = (spectrum[:, None] * torch.cos(n[:, None] * w[:, None])).sum(-1)
    return (kernel / kernel.sum(-1, keepdim=True)).to(dtype)


def get_gaussian_erf_kernel1d(
    kernel_size: int,
    sigma: Tensor | float,
    force_even: bool = False,
    *,
    device: torch.device | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """Integrate a Gaussian over every pixel and divide by the sum.

    Args:
        kernel_size: number of pixels, odd unless force_even.
        sigma: standard deviation in pixels, a positive number or a tensor (B, 1).
        force_even: allow even sizes.
        device: of the result; by default that of sigma.
        dtype: of the result, floating point; by default that of sigma.

    Returns:
        (B, kernel_size) of sum 1, differentiable in sigma.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError: as :func:`gaussian`, or an even size, or a sigma of 0.

    Example:
        >>> import kvision as K
        >>> K.filters.get_gaussian_erf_kernel1d(3, 1.0)
        tensor([[0.2790, 0.4420, 0.2790]])
    """
    (size,) = _sizes("get_gaussian_erf_kernel1d", kernel_size, 1, force_even)
    (sigma,), dtype = _sigma_columns("get_gaussian_erf_kernel1d", sigma, 1, device, dtype, zero=False)
    edges = (torch.arange(size + 1, device=sigma.device, dtype=sigma.dtype) - size / 2) / (math.sqrt(2) * sigma)
    kernel = torch.erf(edges).diff()
    return (kernel / kernel.sum(-1, keepdim=True)).to(dtype)


def sigmas(op: str, name: str, value: object, count: int, *, zero: bool = False) -> Tensor | tuple[float, ...]:
    """`value` checked: a tensor (B, count) as it is, its values unread; numbers as `count` positive floats."""
    if isinstance(value, Tensor):
        value = value.expand(1, count) if value.dim() == 0 else value
        _check.shape(op, name, value, "B", count)
        return value
    numbers = _check.scalars(op, name, value)
    numbers = (numbers,) * count if isinstance(numbers, (int, float)) else numbers
    if not isinstance(numbers, (tuple, list)):
        raise TypeCheckError(_refused(op, name, value, count, zero), actual_type=type(value))
    fits = len(numbers) == count
    for v in numbers:
        if not isinstance(v, (int, float)):
            raise TypeCheckError(_refused(op, name, value, count, zero), actual_type=type(value))
        # Also refuses NaN.
        fits = fits and (v > 0 or (zero and v == 0)) and (v <= _check.LARGEST_FLOAT or v == math.inf)
    if not fits:
        raise ValueCheckError(_refused(op, name, value, count, zero), actual_value=value)
    return tuple(map(float, numbers))


def _refused(op: str, name: str, value: object, count: int, zero: bool) -> str:
    kind = "non-negative" if zero else "positive"
    numbers = f"a {kind} number" if count == 1 else f"{count} {kind} numbers"
    return f"{op}: expected {name} to be {numbers} or a Tensor (B, {count}), got {value!r}"


def _sigma_columns(
    op: str,
    sigma: Tensor | tuple[float, ...] | float,
    count: int,
    device: torch.device | None,
    dtype: torch.dtype | None,
    zero: bool = True,
) -> tuple[tuple[Tensor, ...], torch.dtype]:
    """The sigma of each axis as (B, 1) in float32 or wider, and the type the kernel shall have."""
    checked = sigmas(op, "sigma", sigma, count, zero=zero)
    if dtype is None:
        dtype = torch.get_default_dtype()
        if isinstance(checked, Tensor) and checked.is_floating_point():
            dtype = checked.dtype
    _fractions(op, dtype)
    promoted, device = torch.promote_types(dtype, torch.float32), _check.device(op, device)
    if isinstance(checked, Tensor):
        return checked.to(device, promoted)[:, :, None].unbind(1), dtype
    return tuple(torch.full((1, 1), value, device=device, dtype=promoted) for value in checked), dtype


def _sampled(size: int, sigma: Tensor, mean: Tensor | float | None = None) -> Tensor:
    """(B, size): exp(-d^2 / (2 sigma^2)) at distance d from the mean, divided by its sum."""
    mean = size // 2 if mean is None else mean
    shift = 0.5 if size % 2 == 0 else 0.0
    squared = (torch.arange(size, device=sigma.device, dtype=sigma.dtype) + (shift - mean)) ** 2
    squared = squared - squared.amin(-1, keepdim=True)  # the nearest sample weighs 1, whatever underflows
    variance = (sigma**2).clamp(min=torch.finfo(sigma.dtype).tiny)  # of an impulse, whose gradient is 0
    return torch.softmax(squared / (-2 * variance), -1)


def _gaussian_product(
    op: str,
    axes: int,
    kernel_size: tuple[int, ...] | int,
    sigma: Tensor | tuple[float, ...] | float,
    force_even: bool,
    device: torch.device | None,
    dtype: torch.dtype | None,
) -> Tensor:
    sizes = _sizes(op, kernel_size, axes, force_even)
    columns, dtype = _sigma_columns(op, sigma, axes, device, dtype)
    kernel = _sampled(sizes[0], columns[0])
    for size, column in zip(sizes[1:], columns[1:]):
        weights = _sampled(size, column)
        kernel = kernel[..., None] * weights.reshape(weights.numel() // size, *(1,) * (kernel.dim() - 1), size)
    return kernel.to(dtype)


# ------------------------------------------------------------------------------------------- box and Laplacian


def get_box_kernel1d(
    kernel_size: int, *, device: torch.device | None = None, dtype: torch.dtype | None = None
) -> Tensor:
    """A mean of kernel_size pixels.

    Args:
        kernel_size: number of pixels, at least 1.
        device: of the result; by default torch's default device.
        dtype: of the result, floating point; by default torch's default dtype.

    Returns:
        (1, kernel_size) of 1 / kernel_size.

    Raises:
        TypeCheckError, ValueCheckError: a kernel_size that is not an int of at least 1, an integer dtype.

    Example:
        >>> import kvision as K
        >>> K.filters.get_box_kernel1d(4)
        tensor([[0.2500, 0.2500, 0.2500, 0.2500]])
    """
    (size,) = _check.ints("get_box_kernel1d", "kernel_size", kernel_size, 1)
    _fractions("get_box_kernel1d", dtype)
    return torch.full((1, size), 1 / size, device=_check.device("get_box_kernel1d", device), dtype=dtype)


def get_box_kernel2d(
    kernel_size: tuple[int, int] | int, *, device: torch.device | None = None, dtype: torch.dtype | None = None
) -> Tensor:
    """A mean of a window of pixels.

    Args:
        kernel_size: size of the window, an int or (y, x), at least 1.
        device: of the result; by default torch's default device.
        dtype: of the result, floating point; by default torch's default dtype.

    Returns:
        (1, kH, kW) of 1 / (kH * kW).

    Raises:
        TypeCheckError, ValueCheckError: a kernel_size that is not of ints of at least 1, an integer dtype.

    Example:
        >>> import kvision as K
        >>> K.filters.get_box_kernel2d((1, 2))
        tensor([[[0.5000, 0.5000]]])
    """
    ky, kx = _check.pair("get_box_kernel2d", "kernel_size", kernel_size)
    _fractions("get_box_kernel2d", dtype)
    return torch.full((1, ky, kx), 1 / (ky * kx), device=_check.device("get_box_kernel2d", device), dtype=dtype)


def laplacian_1d(window_size: int, *, device: torch.device | None = None, dtype: torch.dtype = torch.float32) -> Tensor:
    """Ones around a center of 1 - window_size.

    Args:
        window_size: number of weights, at least 1.
        device: of the result; by default torch's default device.
        dtype: of the result, a type that holds the center.

    Returns:
        (window_size,) of sum 0.

    Raises:
        TypeCheckError, ValueCheckError: a window_size that is not an int of at least 1, a dtype too small for the center.

    Example:
        >>> import kvision as K
        >>> K.filters.laplacian_1d(5)
        tensor([ 1.,  1., -4.,  1.,  1.])
    """
    (size,) = _check.ints("laplacian_1d", "window_size", window_size, 1)
    return _ones_around("laplacian_1d", (size,), device, dtype)


def get_laplacian_kernel1d(
    kernel_size: int, *, device: torch.device | None = None, dtype: torch.dtype = torch.float32
) -> Tensor:
    """Ones around a center of 1 - kernel_size.

    Args:
        kernel_size: number of weights, odd and at least 3.
        device: of the result; by default torch's default device.
        dtype: of the result, a type that holds the center.

    Returns:
        (kernel_size,) of sum 0.

    Raises:
        TypeCheckError, ValueCheckError: a kernel_size that is not an odd int of at least 3, a dtype that cannot hold the
            center.

    Example:
        >>> import kvision as K
        >>> K.filters.get_laplacian_kernel1d(3)
        tensor([ 1., -2.,  1.])
    """
    sizes = laplacian_sizes("get_laplacian_kernel1d", kernel_size, 1)
    return _ones_around("get_laplacian_kernel1d", sizes, device, dtype)


def get_laplacian_kernel2d(
    kernel_size: tuple[int, int] | int, *, device: torch.device | None = None, dtype: torch.dtype = torch.float32
) -> Tensor:
    """Ones around a center of 1 - kH * kW.

    Args:
        kernel_size: an odd int or (y, x), at least 3 along one axis.
        device: of the result; by default torch's default device.
        dtype: of the result, a type that holds the center.

    Returns:
        (kH, kW) of sum 0.

    Raises:
        TypeCheckError, ValueCheckError: sizes that are not odd or all 1, a dtype that cannot hold the center.

    Example:
        >>> import kvision as K
        >>> K.filters.get_laplacian_kernel2d(3)
        tensor([[ 1.,  1.,  1.],
                [ 1., -8.,  1.],
                [ 1.,  1.,  1.]])
    """
    sizes = laplacian_sizes("get_laplacian_kernel2d", kernel_size, 2)
    return _ones_around("get_laplacian_kernel2d", sizes, device, dtype)


def laplacian_sizes(op: str, kernel_size: tuple[int, ...] | int, axes: int) -> tuple[int, ...]:
    """The size of a Laplacian kernel along each axis: odd, and not 1 everywhere as that kernel is all zeros."""
    sizes = _sizes(op, kernel_size, axes)
    if max(sizes) == 1:
        raise ValueCheckError(f"{op}: expected kernel_size of at least 3 along an axis, got {kernel_size}")
    return sizes


def _ones_around(op: str, sizes: tuple[int, ...], device: torch.device | None, dtype: torch.dtype) -> Tensor:
    center = 1 - math.prod(sizes)
    _real(op, dtype)
    dtype = dtype or torch.get_default_dtype()
    if not dtype.is_floating_point and (dtype == torch.bool or torch.iinfo(dtype).min > center):
        raise ValueCheckError(f"{op}: expected a dtype that holds {center}, got {dtype}", actual_value=dtype)
    kernel = torch.ones(sizes, device=_check.device(op, device), dtype=dtype)
    kernel[tuple([n // 2 for n in sizes])] = center
    return kernel


# ------------------------------------------------------------------------------------------------- derivatives

# A derivative kernel is a product of rows, one for every axis, which smooth (0) or differentiate (1, 2) along it.
# Divided by its unit, a row gives the true derivative: 1 -> 1, x -> 1, x^2 / 2 -> 1.
# (mode, order of the whole derivative): for order 0, 1, 2 along the axis, the row and its unit
_ROWS = {
    ("sobel", 1): (((1, 2, 1), 4), ((-1, 0, 1), 2)),
    ("sobel", 2): (((1, 4, 6, 4, 1), 16), ((-1, -2, 0, 2, 1), 8), ((1, 0, -2, 0, 1), 4)),
    ("diff", 1): (((0, 1, 0), 1), ((-1, 0, 1), 2)),
    ("diff", 2): (((0, 1, 0), 1), ((-1, 0, 1), 2), ((1, -2, 1), 1)),
}

# (axes, order): for every channel of the gradient the order along x, y, z
_CHANNELS = {
    (2, 1): ((1, 0), (0, 1)),
    (2, 2): ((2, 0), (1, 1), (0, 2)),
    (3, 1): ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    (3, 2): ((2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (0, 1, 1), (1, 0, 1)),
}


def derivative_rows(mode: str, order: int, axes: int) -> list[tuple[tuple[tuple[int, ...], ...], int]]:
    """For every channel of the gradient, the rows along x, y, z and the unit of their product."""
    rows = _ROWS[mode, order]
    channels = [[rows[n] for n in orders] for orders in _CHANNELS[axes, order]]
    return [(tuple(row for row, _ in channel), math.prod([unit for _, unit in channel])) for channel in channels]


def _product(rows: Sequence[Sequence[int]], unit: float, factor: int = 1) -> Any:
    """The product of rows, those of x first, divided by `unit`, as nested lists: integers first, as 0 is never -0 there."""
    if not rows:
        return factor / unit
    return [_product(rows[:-1], unit, factor * n) for n in rows[-1]]


_KERNELS = {
    (mode, order, axes, normalized): [
        _product(rows, unit if normalized else 1) for rows, unit in derivative_rows(mode, order, axes)
    ]
    for mode, order in _ROWS
    for axes in (2, 3)
    for normalized in (False, True)
}


def get_sobel_kernel2d(*, device: torch.device | None = None, dtype: torch.dtype | None = None) -> Tensor:
    """The 3x3 Sobel kernels, not normalized.

    Args:
        device: of the result; by default torch's default device.
        dtype: of the result; by default torch's default dtype.

    Returns:
        (2, 3, 3): the derivative along x, then along y.

    Raises:
        TypeCheckError: a dtype that is not of real numbers.

    Example:
        >>> import kvision as K
        >>> K.filters.get_sobel_kernel2d()[0]
        tensor([[-1.,  0.,  1.],
                [-2.,  0.,  2.],
                [-1.,  0.,  1.]])
    """
    _real("get_sobel_kernel2d", dtype)
    return _derivative_kernels("sobel", 1, 2, device, dtype)


def get_diff_kernel2d(*, device: torch.device | None = None, dtype: torch.dtype | None = None) -> Tensor:
    """The kernels of central differences, not normalized.

    Args:
        device: of the result; by default torch's default device.
        dtype: of the result; by default torch's default dtype.

    Returns:
        (2, 3, 3): the derivative along x, then along y.

    Raises:
        TypeCheckError: a dtype that is not of real numbers.

    Example:
        >>> import kvision as K
        >>> K.filters.get_diff_kernel2d()[1]
        tensor([[ 0., -1.,  0.],
                [ 0.,  0.,  0.],
                [ 0.,  1.,  0.]])
    """
    _real("get_diff_kernel2d", dtype)
    return _derivative_kernels("diff", 1, 2, device, dtype)


def get_spatial_gradient_kernel2d(
    mode: DerivativeMode, order: int, *, device: torch.device | None = None, dtype: torch.dtype | None = None
) -> Tensor:
    """The kernels of `spatial_gradient`, not normalized.

    Args:
        mode: 'sobel' or 'diff'.
        order: 1 for derivatives (x, y), 2 for (xx, xy, yy).
        device: of the result.
        dtype: of the result.

    Returns:
        (2, 3, 3) for order 1, (3, 5, 5) for 'sobel' of order 2, (3, 3, 3) for 'diff' of order 2.

    Raises:
        ValueCheckError: an unknown mode or order.

    Example:
        >>> import kvision as K
        >>> K.filters.get_spatial_gradient_kernel2d("diff", 2)[0]
        tensor([[ 0.,  0.,  0.],
                [ 1., -2.,  1.],
                [ 0.,  0.,  0.]])
    """
    order = check_derivative("get_spatial_gradient_kernel2d", mode, order)
    _real("get_spatial_gradient_kernel2d", dtype)
    return _derivative_kernels(mode, order, 2, device, dtype)


def get_spatial_gradient_kernel3d(
    mode: DerivativeMode, order: int, device: torch.device | None = None, dtype: torch.dtype | None = None
) -> Tensor:
    """The kernels of `spatial_gradient3d`, normalized.

    Args:
        mode: 'diff'.
        order: 1 for derivatives (x, y, z), 2 for (xx, yy, zz, xy, yz, xz).
        device: of the result.
        dtype: of the result, floating point.

    Returns:
        (3, 1, 3, 3, 3) or (6, 1, 3, 3, 3).

    Raises:
        ValueCheckError: an unknown mode or order.
        NotImplementedError: mode 'sobel'.
        TypeCheckError: an integer dtype.

    Example:
        >>> import kvision as K
        >>> K.filters.get_spatial_gradient_kernel3d("diff", 1)[0, 0, 1]
        tensor([[ 0.0000,  0.0000,  0.0000],
                [-0.5000,  0.0000,  0.5000],
                [ 0.0000,  0.0000,  0.0000]])
    """
    order = check_derivative("get_spatial_gradient_kernel3d", mode, order, axes=3)
    _fractions("get_spatial_gradient_kernel3d", dtype)
    return _derivative_kernels(mode, order, 3, device, dtype, normalized=True)[:, None]


def check_derivative(op: str, mode: DerivativeMode, order: int, axes: int = 2) -> int:
    """`order` as an int; raise unless there are kernels of this mode and order."""
    _check.choice(op, "mode", mode, _MODES)
    order = _check.scalar(op, "order", order)
    _check.choice(op, "order", order, (1, 2))
    if axes == 3 and mode == "sobel":
        raise NotImplementedError(f"{op}: mode 'sobel' is not implemented in 3-D, use 'diff'")
    return order


def _derivative_kernels(
    mode: DerivativeMode,
    order: int,
    axes: int,
    device: torch.device | None,
    dtype: torch.dtype | None,
    normalized: bool = False,
) -> Tensor:
    kernels = _KERNELS[mode, order, axes, normalized]
    return torch.tensor(
        kernels, device=_check.device(f"get_{mode}_kernel{axes}d", device), dtype=dtype or torch.get_default_dtype()
    )


# ------------------------------------------------------------------------------------------------ other kernels


def get_binary_kernel2d(
    window_size: tuple[int, int] | int, *, device: torch.device | None = None, dtype: torch.dtype = torch.float32
) -> Tensor:
    """One kernel for each pixel of a window, 1 there and 0 elsewhere: a convolution with them unfolds the windows.

    Args:
        window_size: an int or (y, x).
        device: of the result.
        dtype: of the result.

    Returns:
        (kH * kW, 1, kH, kW), pixels row by row.

    Raises:
        TypeCheckError, ValueCheckError: a window_size that is not of ints of at least 1.

    Example:
        >>> import kvision as K
        >>> K.filters.get_binary_kernel2d((1, 2))
        tensor([[[[1., 0.]]],
        <BLANKLINE>
        <BLANKLINE>
                [[[0., 1.]]]])
    """
    ky, kx = _check.pair("get_binary_kernel2d", "window_size", window_size)
    _real("get_binary_kernel2d", dtype)
    return torch.eye(ky * kx, device=_check.device("get_binary_kernel2d", device), dtype=dtype).reshape(
        ky * kx, 1, ky, kx
    )


def get_hanning_kernel1d(
    kernel_size: int, device: torch.device | None = None, dtype: torch.dtype | None = None
) -> Tensor:
    """The symmetric Hann window 0.5 - 0.5 cos(2 pi i / (kernel_size - 1)).

    Args:
        kernel_size: number of weights, at least 3.
        device: of the result; by default torch's default device.
        dtype: of the result, floating point; by default torch's default dtype.

    Returns:
        (kernel_size,), 0 at both ends.

    Raises:
        TypeCheckError, ValueCheckError: a kernel_size that is not an int of at least 3, an integer dtype.

    Example:
        >>> import kvision as K
        >>> K.filters.get_hanning_kernel1d(5)
        tensor([0.0000, 0.5000, 1.0000, 0.5000, 0.0000])
    """
    (size,) = _check.ints("get_hanning_kernel1d", "kernel_size", kernel_size, 1, minimum=3)
    _fractions("get_hanning_kernel1d", dtype)
    return torch.hann_window(size, periodic=False, device=_check.device("get_hanning_kernel1d", device), dtype=dtype)


def get_hanning_kernel2d(
    kernel_size: tuple[int, int] | int, device: torch.device | None = None, dtype: torch.dtype | None = None
) -> Tensor:
    """The product of the Hann windows of both axes.

    Args:
        kernel_size: an int or (y, x), at least 3.
        device: of the result; by default torch's default device.
        dtype: of the result, floating point; by default torch's default dtype.

    Returns:
        (kH, kW), 0 at the border.

    Raises:
        TypeCheckError, ValueCheckError: a kernel_size that is not of ints of at least 3, an integer dtype.

    Example:
        >>> import kvision as K
        >>> K.filters.get_hanning_kernel2d((3, 5))
        tensor([[0.0000, 0.0000, 0.0000, 0.0000, 0.0000],
                [0.0000, 0.5000, 1.0000, 0.5000, 0.0000],
                [0.0000, 0.0000, 0.0000, 0.0000, 0.0000]])
    """
    ky, kx = _check.pair("get_hanning_kernel2d", "kernel_size", kernel_size, minimum=3)
    _fractions("get_hanning_kernel2d", dtype)
    return get_hanning_kernel1d(ky, device, dtype)[:, None] * get_hanning_kernel1d(kx, device, dtype)


def binomial(size: int, device: torch.device, dtype: torch.dtype) -> Tensor:
    """(1, size): a row of Pascal's triangle divided by its sum, made on the device from no host data."""
    if in_onnx_export():  # which has no cumprod
        return torch.tensor(
            [[math.comb(size - 1, i) / 2 ** (size - 1) for i in range(size)]], device=device, dtype=dtype
        )
    i = torch.arange(size, device=device, dtype=torch.float64)
    row = torch.where(i == 0, 1.0, (size - i) / i).cumprod(0)  # each entry is its neighbor times (size - i) / i
    return (row / row.sum()).to(dtype)[None]


def _sizes(op: str, kernel_size: tuple[int, ...] | int, axes: int, even: bool = False) -> tuple[int, ...]:
    maximum = _check.LARGEST_INT if axes == 1 else _check.LARGEST_WINDOW
    sizes = _check.ints(op, "kernel_size", kernel_size, axes, maximum=maximum)
    _check.flag(op, "force_even", even)
    if not even:
        _check.odd(op, "kernel_size", sizes)
    return sizes


def _real(op: str, dtype: torch.dtype | None) -> None:
    """Raise unless `dtype` is a type of real numbers or None."""
    if dtype is not None and (not isinstance(dtype, torch.dtype) or dtype.is_complex):
        raise TypeCheckError(f"{op}: expected dtype to be a real torch.dtype, got {dtype!r}", actual_type=dtype)


def _fractions(op: str, dtype: torch.dtype | None) -> None:
    """Raise unless a kernel of this type can hold fractions."""
    _real(op, dtype)
    if dtype is not None and not dtype.is_floating_point:
        raise TypeCheckError(f"{op}: expected a floating-point dtype, got {dtype}", actual_type=dtype)
