"""Cross-correlation and convolution of volumes with any small kernel."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._choices import Behaviour, Border
from kvision._dtype import floats
from kvision._modes import BORDER
from kvision.filters.filter2d import check_padding, prepare_kernel, register_filter

_filter3d, _, _ = register_filter("filter3d")


def filter3d(
    input: Tensor,
    kernel: Tensor,
    border_type: Border = "replicate",
    normalized: bool = False,
    behaviour: Behaviour = "corr",
) -> Tensor:
    """Filter every channel of a volume with one kernel.

    Args:
        input: volume (B, C, D, H, W); integers give float32.
        kernel: (1, kD, kH, kW), or (B, kD, kH, kW) with a kernel for every volume; sizes may be even.
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.
        normalized: divide the kernel by the sum of its absolute values.
        behaviour: 'corr' for cross-correlation, 'conv' to flip the kernel first (convolution).

    Returns:
        The filtered volume, of the input's size; differentiable in volume and kernel.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as `filter2d`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([1., 2., 4.]).reshape(1, 1, 3, 1, 1)
        >>> K.filters.filter3d(x, torch.ones(1, 3, 1, 1)).flatten()
        tensor([ 4.,  7., 10.])
    """
    return filter_volumes("filter3d", input, kernel, border_type, normalized, behaviour)


def correlate3d(input: Tensor, kernel: Tensor, border_type: Border = "replicate", normalized: bool = False) -> Tensor:
    """Cross-correlate every channel of a volume with one kernel: :func:`filter3d` with behaviour 'corr'.

    Args:
        input: volume (B, C, D, H, W); integers give float32.
        kernel: (1, kD, kH, kW), or (B, kD, kH, kW) with a kernel for every volume; sizes may be even.
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.
        normalized: divide the kernel by the sum of its absolute values.

    Returns:
        The filtered volume; differentiable in volume and kernel.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`filter3d`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([0., 1., 0.]).reshape(1, 1, 3, 1, 1)
        >>> K.filters.correlate3d(x, torch.tensor([1., 2., 3.]).reshape(1, 3, 1, 1)).flatten()
        tensor([3., 2., 1.])
    """
    return filter_volumes("correlate3d", input, kernel, border_type, normalized, "corr")


def convolve3d(input: Tensor, kernel: Tensor, border_type: Border = "replicate", normalized: bool = False) -> Tensor:
    """Convolve every channel of a volume with one kernel: :func:`filter3d` with behaviour 'conv'.

    Args:
        input: volume (B, C, D, H, W); integers give float32.
        kernel: (1, kD, kH, kW), or (B, kD, kH, kW) with a kernel for every volume; sizes may be even.
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.
        normalized: divide the kernel by the sum of its absolute values.

    Returns:
        The filtered volume; differentiable in volume and kernel.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`filter3d`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([0., 1., 0.]).reshape(1, 1, 3, 1, 1)
        >>> K.filters.convolve3d(x, torch.tensor([1., 2., 3.]).reshape(1, 3, 1, 1)).flatten()
        tensor([1., 2., 3.])
    """
    return filter_volumes("convolve3d", input, kernel, border_type, normalized, "conv")


def filter_volumes(
    op: str, input: Tensor, kernel: Tensor, border_type: Border, normalized: bool, behaviour: Behaviour
) -> Tensor:
    """:func:`filter3d`, under the name of the function that was called."""
    _check.volumes(op, "input", input)
    _check.shape(op, "kernel", kernel, "B or 1", "kD", "kH", "kW")
    kernel = prepare_kernel(op, input, kernel, normalized, behaviour)
    check_padding(op, input, kernel.shape[1:], border_type, "same")
    return _filter3d(floats(input), kernel, BORDER[border_type], True)
