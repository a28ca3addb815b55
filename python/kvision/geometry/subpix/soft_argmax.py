"""The soft argmax of every window of an image or a volume."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._modules import VOLUME, FunctionModule
from kvision._ops import register, vjp
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.geometry.subpix.spatial import positive

__all__ = ["ConvSoftArgmax2d", "ConvSoftArgmax3d", "conv_soft_argmax2d", "conv_soft_argmax3d"]


def _reference(x, window, stride, padding, temperature, normalized, scale_too, with_values):
    reach = [side for pad in reversed(padding) for side in (pad, pad)]

    def windows(outside):
        windows = F.pad(x, reach, value=outside)
        for axis, (size, step) in enumerate(zip(window, stride), 2):  # Tensor.unfold has no rule of vmap of no elements
            count = (windows.shape[axis] - size) // step + 1
            index = torch.arange(size, device=x.device) + step * torch.arange(count, device=x.device)[:, None]
            windows = windows.index_select(axis, index.flatten()).unflatten(axis, (count, size)).movedim(axis + 1, -1)
        return windows.flatten(-3)

    weights = (windows(-torch.inf) / temperature).softmax(-1)
    like = {"dtype": x.dtype, "device": x.device}
    within = torch.meshgrid([torch.arange(n, **like) for n in window], indexing="ij")
    numbers = []
    for axis in (0, 2, 1) if scale_too else (2, 1):
        size, count = x.shape[2 + axis], weights.shape[2 + axis]
        start = torch.arange(count, **like) * stride[axis] - padding[axis]
        index = (weights * within[axis].flatten()).sum(-1) + start.view([-1 if i == axis else 1 for i in range(3)])
        numbers.append(index * (2 / (size - 1) if size > 1 else 0) - 1 if normalized else index)
    values = (
        (weights * windows(0.0)).sum(-1) if with_values else weights.new_zeros(*x.shape[:2], 0, *weights.shape[3:5])
    )
    return torch.stack(numbers, 2), values


def _outputs(x, window, stride, padding, temperature, normalized, scale_too, with_values):
    d, h, w = ((n + 2 * p - k) // s + 1 for n, k, s, p in zip(x.shape[2:], window, stride, padding))
    return [(*x.shape[:2], 3 if scale_too else 2, d, h, w), (*x.shape[:2], d if with_values else 0, h, w)]


def _gradient(grad_coords, grad_values, x, *options):
    return vjp(_reference)((grad_coords, grad_values), x, *options)


_soft_argmax = register("soft_argmax", _reference, fake=_outputs, gradients="input: soft_argmax_backward")
register("soft_argmax_backward", _gradient, fake=lambda grad, values, x, *options: x.shape)


def conv_soft_argmax2d(
    input: Tensor,
    kernel_size: tuple[int, int] = (3, 3),
    stride: tuple[int, int] = (1, 1),
    padding: tuple[int, int] = (1, 1),
    temperature: Tensor | float = 1.0,
    normalized_coordinates: bool = True,
    eps: float = 1e-8,
    output_value: bool = False,
) -> Tensor | tuple[Tensor, Tensor]:
    """Compute the expected coordinates in every window of an image under the softmax of its values.

    Pixels out of bounds have no weight.

    Args:
        input: images (B, C, H, W). Integers are computed in float32.
        kernel_size: height and width of a window.
        stride: step between windows along each axis.
        padding: how far windows reach out of the image along each axis, at most half of `kernel_size`.
        temperature: divisor of the values: a positive number, or a tensor of one number, whose sign is not checked.
        normalized_coordinates: coordinates from -1 to 1, the centers of the outermost pixels; else pixels.
        eps: no effect, kept for compatibility.
        output_value: also return the expected values.

    Returns:
        Coordinates (B, C, 2, H', W'), x before y, and with `output_value` the expected values (B, C, H', W').

    Raises:
        TypeError: `input` is not a tensor of real numbers; `kernel_size`, `stride` or `padding` is not two ints;
            `temperature` is not a number or tensor; `eps` is not a number; a flag is not a bool.
        ValueError: `input` is not (B, C, H, W); an entry of `kernel_size` or `stride` is below 1; `padding` is negative
            or more than half of `kernel_size`; the padded image is smaller than a window; `temperature` is not positive
            or not one number.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 0., 0.], [0., 9., 9.], [0., 0., 0.]]]])
        >>> K.geometry.conv_soft_argmax2d(x, normalized_coordinates=False)[0, 0, :, 1, 1].round(decimals=2)
        tensor([1.5000, 1.0000])
    """
    op = "conv_soft_argmax2d"
    _check.images(op, "input", input)
    results = _of_windows(
        op,
        input[:, :, None],
        [1, *_check.ints(op, "kernel_size", kernel_size, 2, maximum=_check.LARGEST_WINDOW)],
        [1, *_check.ints(op, "stride", stride, 2)],
        [0, *_check.ints(op, "padding", padding, 2, minimum=0)],
        temperature,
        normalized_coordinates,
        eps,
        False,
        output_value,
    )
    coords: Tensor = results[0].squeeze(3)
    return (coords, results[1].squeeze(2)) if output_value else coords


def conv_soft_argmax3d(
    input: Tensor,
    kernel_size: tuple[int, int, int] = (3, 3, 3),
    stride: tuple[int, int, int] = (1, 1, 1),
    padding: tuple[int, int, int] = (1, 1, 1),
    temperature: Tensor | float = 1.0,
    normalized_coordinates: bool = False,
    eps: float = 1e-8,
    output_value: bool = True,
    strict_maxima_bonus: float | None = None,
) -> Tensor | tuple[Tensor, Tensor]:
    """Compute the expected coordinates in every window of a volume under the softmax of its values.

    Voxels out of bounds have no weight.

    Args:
        input: volumes (B, C, D, H, W). Integers are computed in float32.
        kernel_size: depth, height and width of a window.
        stride: step between windows along each axis.
        padding: how far windows reach out of the volume along each axis, at most half of `kernel_size`.
        temperature: divisor of the values: a positive number, or a tensor of one number, whose sign is not checked.
        normalized_coordinates: coordinates from -1 to 1, the centers of the outermost voxels; else voxels.
        eps: no effect, kept for compatibility.
        output_value: also return the expected values.
        strict_maxima_bonus: no effect, kept for compatibility; a value other than None gives a DeprecationWarning.

    Returns:
        Coordinates (B, C, 3, D', H', W') in the order scale (depth), x, y, and with `output_value` the expected values
        (B, C, D', H', W').

    Raises:
        TypeError: `input` is not a tensor of real numbers; `kernel_size`, `stride` or `padding` is not three ints;
            `temperature` is not a number or tensor; `eps` is not a number; a flag is not a bool.
        ValueError: `input` is not (B, C, D, H, W); an entry of `kernel_size` or `stride` is below 1; `padding` is
            negative or more than half of `kernel_size`; the padded volume is smaller than a window; `temperature` is
            not positive or not one number.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.zeros(1, 1, 3, 3, 4)
        >>> x[0, 0, 1, 1, 2] = 20
        >>> coords, values = K.geometry.conv_soft_argmax3d(x)
        >>> coords[0, 0, :, 1, 1, 1].round(decimals=2), values[0, 0, 1, 1, 1].round()
        (tensor([1., 2., 1.]), tensor(20.))
    """
    op = "conv_soft_argmax3d"
    _check.volumes(op, "input", input)
    warn_of_bonus(op, strict_maxima_bonus)
    results = _of_windows(
        op,
        input,
        [*_check.ints(op, "kernel_size", kernel_size, 3, maximum=_check.LARGEST_WINDOW)],
        [*_check.ints(op, "stride", stride, 3)],
        [*_check.ints(op, "padding", padding, 3, minimum=0)],
        temperature,
        normalized_coordinates,
        eps,
        True,
        output_value,
    )
    return (results[0], results[1]) if output_value else results[0]


def warn_of_bonus(op: str, strict_maxima_bonus: Any, stacklevel: int = 3) -> None:
    """Warn if `strict_maxima_bonus`, which Kornia 0.4 added to strict maxima, is not None."""
    if strict_maxima_bonus is not None:
        _check.number(op, "strict_maxima_bonus", strict_maxima_bonus)
        message = f"{op}: strict_maxima_bonus has no effect; nms3d tells where the strict maxima are"
        warnings.warn(message, DeprecationWarning, stacklevel=stacklevel)


def _of_windows(
    op: str,
    x: Tensor,
    window: list[int],
    stride: list[int],
    padding: list[int],
    temperature: Tensor | float,
    normalized: bool,
    eps: float,
    scale_too: bool,
    with_values: bool,
) -> Any:
    _check.flag(op, "normalized_coordinates", normalized)
    _check.flag(op, "output_value", with_values)
    _check.number(op, "eps", eps)
    axes = 3 if scale_too else 2
    _fit(op, window[-axes:], padding[-axes:], x.shape[-axes:])
    x = floats(x)
    divisor = positive(op, x, temperature)
    if not isinstance(divisor, Tensor):
        return _soft_argmax(x, window, stride, padding, divisor, normalized, scale_too, with_values)
    coords, values = _soft_argmax(x / divisor, window, stride, padding, 1.0, normalized, scale_too, with_values)
    return coords, values * divisor


def _fit(op: str, window: Sequence[int], padding: Sequence[int], size: Sequence[int]) -> None:
    if any(2 * p > k for p, k in zip(padding, window)):
        raise ValueCheckError(
            f"{op}: expected padding of at most half of kernel_size {(*window,)}, got {(*padding,)}",
            actual_value=(*padding,),
        )
    if any(k > n + 2 * p for k, n, p in zip(window, size, padding)):
        raise ShapeError(f"{op}: expected input of at least a window, got {(*size,)}", actual_shape=size)


class ConvSoftArgmax2d(FunctionModule):
    """Module form of :func:`conv_soft_argmax2d`.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.ConvSoftArgmax2d((5, 5), padding=(2, 2))(torch.rand(1, 3, 8, 9)).shape
        torch.Size([1, 3, 2, 8, 9])
    """

    def __init__(
        self,
        kernel_size: tuple[int, int] = (3, 3),
        stride: tuple[int, int] = (1, 1),
        padding: tuple[int, int] = (1, 1),
        temperature: Tensor | float = 1.0,
        normalized_coordinates: bool = True,
        eps: float = 1e-8,
        output_value: bool = False,
    ) -> None:
        super().__init__(
            kernel_size=kernel_size,
            stride=stride,
            padding=padding,
            temperature=temperature,
            normalized_coordinates=normalized_coordinates,
            eps=eps,
            output_value=output_value,
        )

    def forward(self, x: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        return conv_soft_argmax2d(
            x,
            self.kernel_size,
            self.stride,
            self.padding,
            self.temperature,
            self.normalized_coordinates,
            self.eps,
            self.output_value,
        )


class ConvSoftArgmax3d(FunctionModule):
    """Module form of :func:`conv_soft_argmax3d`.

    Example:
        >>> import torch, kvision as K
        >>> coords, values = K.geometry.ConvSoftArgmax3d()(torch.rand(1, 1, 3, 8, 9))
        >>> coords.shape, values.shape
        (torch.Size([1, 1, 3, 3, 8, 9]), torch.Size([1, 1, 3, 8, 9]))
    """

    samples = (VOLUME,)

    def __init__(
        self,
        kernel_size: tuple[int, int, int] = (3, 3, 3),
        stride: tuple[int, int, int] = (1, 1, 1),
        padding: tuple[int, int, int] = (1, 1, 1),
        temperature: Tensor | float = 1.0,
        normalized_coordinates: bool = False,
        eps: float = 1e-8,
        output_value: bool = True,
        strict_maxima_bonus: float | None = None,
    ) -> None:
        warn_of_bonus("ConvSoftArgmax3d", strict_maxima_bonus)
        super().__init__(
            kernel_size=kernel_size,
            stride=stride,
            padding=padding,
            temperature=temperature,
            normalized_coordinates=normalized_coordinates,
            eps=eps,
            output_value=output_value,
        )

    def forward(self, x: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        return conv_soft_argmax3d(
            x,
            self.kernel_size,
            self.stride,
            self.padding,
            self.temperature,
            self.normalized_coordinates,
            self.eps,
            self.output_value,
        )
