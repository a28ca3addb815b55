"""Errors of disparity maps."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._choices import Reduction
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError


def mean_absolute_disparity_error(
    input: Tensor, target: Tensor, valid_mask: Tensor | None = None, reduction: Reduction = "mean"
) -> Tensor:
    """Compute the absolute error of a disparity map.

    Args:
        input: disparities of any shape, floating point.
        target: true disparities in the same shape.
        valid_mask: which pixels count, of a shape that broadcasts to theirs; None for all.
        reduction: 'mean' and 'sum' over the valid pixels; 'none'.

    Returns:
        A number, NaN for the mean of no pixels; or for 'none' a map that is 0 where pixels are not valid.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: different shapes, or a valid_mask that does not broadcast.
        ValueCheckError: an unknown reduction, which is a NotImplementedError, too.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.mean_absolute_disparity_error(torch.tensor([1.0, 5.0]), torch.tensor([2.0, 2.0]))
        tensor(2.)
    """
    mask = _checked("mean_absolute_disparity_error", input, target, valid_mask, reduction)
    return _absolute(input, target, mask, reduction)


def root_mean_squared_disparity_error(
    input: Tensor, target: Tensor, valid_mask: Tensor | None = None, reduction: Reduction = "mean"
) -> Tensor:
    """Compute the root of the mean squared error of a disparity map.

    Args:
        input: disparities of any shape, floating point.
        target: true disparities in the same shape.
        valid_mask: which pixels count; None for all.
        reduction: 'mean', or 'sum' and 'none' for the root of the sum and of each square.

    Returns:
        A number, or for 'none' a map.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`mean_absolute_disparity_error`.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.root_mean_squared_disparity_error(torch.tensor([1.0, 9.0]), torch.tensor([2.0, 2.0]))
        tensor(5.)
    """
    mask = _checked("root_mean_squared_disparity_error", input, target, valid_mask, reduction)
    return _root_mean_squared(input, target, mask, reduction)


def mean_bad_pixel_error(
    input: Tensor,
    target: Tensor,
    threshold: float = 3.0,
    valid_mask: Tensor | None = None,
    reduction: Reduction = "mean",
) -> Tensor:
    """Compute the fraction of pixels whose disparity error exceeds a threshold.

    Args:
        input: disparities of any shape, floating point.
        target: true disparities in the same shape.
        threshold: largest good error, in pixels.
        valid_mask: which pixels count; None for all.
        reduction: 'mean', 'sum' for how many they are, 'none'.

    Returns:
        A number, or for 'none' a map of 0 and 1.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`mean_absolute_disparity_error`.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.mean_bad_pixel_error(torch.tensor([1.0, 6.0]), torch.tensor([2.0, 2.0]))
        tensor(0.5000)
    """
    mask = _checked("mean_bad_pixel_error", input, target, valid_mask, reduction)
    threshold = _check.number("mean_bad_pixel_error", "threshold", threshold)
    return _fraction_of_bad(input, target, mask, threshold, 0.0, reduction)


def kitti_d1_error(
    input: Tensor,
    target: Tensor,
    abs_threshold: float = 3.0,
    rel_threshold: float = 0.05,
    valid_mask: Tensor | None = None,
    reduction: Reduction = "mean",
) -> Tensor:
    """Compute the fraction of pixels whose disparity error exceeds both an absolute and a relative threshold.

    Args:
        input: disparities of any shape, floating point.
        target: true disparities in the same shape.
        abs_threshold: largest good error, in pixels.
        rel_threshold: largest good error, as a fraction of the absolute true disparity.
        valid_mask: which pixels count; None for all.
        reduction: 'mean', 'sum' for how many they are, 'none'.

    Returns:
        A number, or for 'none' a map of 0 and 1.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`mean_absolute_disparity_error`.

    Source: M. Menze, A. Geiger, "Object scene flow for autonomous vehicles" (2015).

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.kitti_d1_error(torch.tensor([95.5, 6.0]), torch.tensor([100.0, 2.0]))
        tensor(0.5000)
    """
    mask = _checked("kitti_d1_error", input, target, valid_mask, reduction)
    absolute = _check.number("kitti_d1_error", "abs_threshold", abs_threshold)
    relative = _check.number("kitti_d1_error", "rel_threshold", rel_threshold)
    return _fraction_of_bad(input, target, mask, absolute, relative, reduction)


def _checked(op: str, input: Tensor, target: Tensor, mask: Tensor | None, reduction: Reduction) -> Tensor | None:
    for name, x in (("input", input), ("target", target)):
        _check.numbers(op, name, x)
        _check.floating(op, name, x)
    _check.same_shape(op, input=input, target=target)
    _check.same_device(op, input=input, target=target)
    _check.reduction(op, reduction)
    if mask is None:
        return None
    _check.numbers(op, "valid_mask", mask)
    _check.same_device(op, input=input, valid_mask=mask)
    missing = input.dim() - mask.dim()
    if missing < 0 or any(m not in (1, n) for m, n in zip(mask.shape, input.shape[missing:])):
        raise ShapeError(
            f"{op}: expected a valid_mask that broadcasts to {tuple(input.shape)}, got {tuple(mask.shape)}",
            actual_shape=mask.shape,
        )
    return mask.bool().expand(input.shape)


def _reduced(error: Tensor, mask: Tensor | None, reduction: Reduction) -> Tensor:
    if mask is not None:
        error = error.masked_fill(~mask, 0)
    if reduction == "mean":
        return _over(error.sum(), error.numel() if mask is None else mask.sum())
    return error.sum() if reduction == "sum" else error


@with_kernel_casts
def _absolute(input: Tensor, target: Tensor, mask: Tensor | None, reduction: Reduction) -> Tensor:
    return _reduced((input - target).abs(), mask, reduction)


@with_kernel_casts
def _root_mean_squared(input: Tensor, target: Tensor, mask: Tensor | None, reduction: Reduction) -> Tensor:
    error = input - target
    if mask is not None:
        error = error.masked_fill(~mask, 0)
    if reduction == "none":
        return error.abs()
    flat = error.flatten()
    # The gradient of torch's norm takes one more pass. Of no pixels, vmap has no tangents of dot and of single numbers.
    square = (flat.dot(flat) if flat.shape[0] else flat.sum())[None]
    is_zero = square == 0
    length = square.masked_fill(is_zero, 1).sqrt().masked_fill(is_zero, 0)[0]  # whose gradient at 0 is 0
    if reduction == "sum":
        return length
    return _over(length, error.numel() ** 0.5 if mask is None else mask.sum().to(error.dtype).sqrt())


def _over(total: Tensor, count: Tensor | float) -> Tensor:
    """`total / count`, also where vmap has no elements, for which torch divides no single numbers (2.13)."""
    return (total[None] / count)[0]


@with_kernel_casts
def _fraction_of_bad(
    input: Tensor, target: Tensor, mask: Tensor | None, absolute: float, relative: float, reduction: Reduction
) -> Tensor:
    error = (input - target).abs()
    bad = error > absolute
    if relative != 0:
        bad = bad & (error > relative * target.abs())
    return _reduced(bad.to(error.dtype), mask, reduction)
