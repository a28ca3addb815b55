"""Selecting pixels by the range of their values."""

from __future__ import annotations

import functools

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype
from kvision._modules import FunctionModule
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError


def in_range(
    input: Tensor,
    lower: tuple[float, ...] | Tensor,
    upper: tuple[float, ...] | Tensor,
    return_mask: bool = False,
) -> Tensor:
    """Keep the pixels with lower <= value <= upper in every channel, and set the others to 0.

    Args:
        input: image (B, C, H, W), (C, H, W) or (H, W), whose type the result has. Half types compare in float32.
        lower: smallest values, a tuple with one number a channel, or a tensor: (), (1,) or (C,), or 2 to 4 axes that
            broadcast to the input from the last.
        upper: largest values, of the same kind.
        return_mask: give the mask instead: 1 where kept and 0 elsewhere, in the input's type.

    Returns:
        The image, of the input's shape; or the mask, of the input's shape with one channel.

    Raises:
        TypeCheckError: input is not a real tensor; bounds that are not both tuples or both tensors; return_mask not a bool.
        ShapeError: a rank other than 2, 3 or 4; bounds that do not fit the input.
        ValueCheckError: tuples that do not have one number a channel.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[0.1, 0.5], [0.6, 0.9]]])
        >>> K.filters.in_range(x, (0.2,), (0.8,))
        tensor([[[0.0000, 0.5000],
                 [0.6000, 0.0000]]])
    """
    _check.numbers("in_range", "input", input)
    if not 2 <= input.dim() <= 4:
        raise ShapeError(f"in_range: expected input of shape (B, C, H, W), got {tuple(input.shape)}")
    _check.flag("in_range", "return_mask", return_mask)
    channels = input if input.dim() > 2 else input[None]
    if isinstance(lower, tuple) and isinstance(upper, tuple):
        inside = _between_numbers(channels, lower, upper)
    elif isinstance(lower, Tensor) and isinstance(upper, Tensor):
        lower, upper = (_bound(name, b, channels) for name, b in (("lower", lower), ("upper", upper)))
        fits = (channels >= lower) & (channels <= upper)
        if _check.is_symbolic(fits.shape[-3]):
            inside = fits.all(-3, keepdim=True)
        else:  # torch's `all` of an inner axis is slow
            inside = functools.reduce(torch.logical_and, fits.split(1, -3))
    else:
        raise TypeCheckError(
            f"in_range: expected lower and upper to be both tuples or both tensors, got {type(lower).__name__} and "
            f"{type(upper).__name__}"
        )
    if input.dim() == 2:
        inside = inside[0]
    return inside.to(input.dtype) if return_mask else torch.where(inside, input, 0)


def _between_numbers(channels: Tensor, lower: tuple[float, ...], upper: tuple[float, ...]) -> Tensor:
    """Channel by channel with plain numbers, so that none has to be sent to the device."""
    count = channels.shape[-3]
    if len(lower) != count or len(upper) != count:
        raise ValueCheckError(
            f"in_range: expected lower and upper of {count} numbers, one a channel, got {len(lower)} and {len(upper)}"
            f"{_check.channels_advice(channels.shape)}"
        )
    lower, upper = _check.scalars("in_range", "lower", lower), _check.scalars("in_range", "upper", upper)
    if not all(isinstance(bound, (int, float)) for bound in (*lower, *upper)):
        raise TypeCheckError(f"in_range: expected lower and upper to hold numbers, got {lower} and {upper}")
    # Half types compare in float32, integers in a type that has any bound.
    values = channels.to(compute_dtype(channels) if channels.is_floating_point() else torch.float64)
    inside = torch.ones_like(values[..., :1, :, :], dtype=torch.bool)
    for channel, low, high in zip(values.split(1, -3), lower, upper):
        inside = inside & (channel >= low) & (channel <= high)
    return inside


def _bound(name: str, bound: Tensor, channels: Tensor) -> Tensor:
    _check.numbers("in_range", name, bound)
    bound = _check.to_device_of("in_range", channels, name, bound)
    aligned = bound[:, None, None] if bound.dim() == 1 else bound
    if aligned.dim() > channels.dim() or any(
        b not in (1, n) for b, n in zip(reversed(aligned.shape), reversed(channels.shape))
    ):
        raise ShapeError(
            f"in_range: expected {name} to broadcast to {tuple(channels.shape)}, got {tuple(bound.shape)}",
            actual_shape=bound.shape,
        )
    if channels.is_floating_point():
        return aligned.to(compute_dtype(channels))
    return aligned.double() if bound.is_floating_point() else aligned


class InRange(FunctionModule):
    """Module form of :func:`in_range`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.InRange((0.2, 0.2, 0.2), (0.8, 0.8, 0.8), return_mask=True)(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 1, 8, 8])
    """

    def __init__(
        self, lower: tuple[float, ...] | Tensor, upper: tuple[float, ...] | Tensor, return_mask: bool = False
    ) -> None:
        super().__init__(lower=lower, upper=upper, return_mask=return_mask)

    def forward(self, input: Tensor) -> Tensor:
        return in_range(input, self.lower, self.upper, self.return_mask)
