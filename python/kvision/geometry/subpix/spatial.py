"""Heat maps and their coordinates: softmax, expectation, and rendered Gaussians.

Source: A. Nibali et al., "Numerical coordinate regression with convolutional neural networks" (2018).
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._leading import broadcast_shapes, expand_to_batch
from kvision._modules import FunctionModule
from kvision._ops import register, vjp
from kvision._torch_compat import linspace
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.geometry._formula import batch_of

__all__ = [
    "SpatialSoftArgmax2d",
    "render_gaussian2d",
    "spatial_expectation2d",
    "spatial_soft_argmax2d",
    "spatial_softmax2d",
]


def positive(op: str, x: Tensor, temperature: Any) -> Tensor | float:
    """A temperature as a number, or as a tensor without axes, in the dtype of the computation and on the device of `x`."""
    if not isinstance(temperature, Tensor):
        value = _check.number(op, "temperature", temperature)
        if not 0 < value < math.inf:
            raise ValueCheckError(
                f"{op}: expected temperature to be positive and finite, got {value}", actual_value=value
            )
        return value
    _check.numbers(op, "temperature", temperature)
    if temperature.numel() != 1:
        raise ShapeError(
            f"{op}: expected temperature of one number, got {tuple(temperature.shape)}",
            actual_shape=temperature.shape,
        )
    return temperature.reshape(()).to(x.device, compute_dtype(x))


def spatial_softmax2d(input: Tensor, temperature: Tensor | float | None = None) -> Tensor:
    """Compute the softmax over the pixels of each channel.

    Args:
        input: heat maps (B, C, H, W). Integers are computed in float32.
        temperature: divisor of the values: a positive number, or a tensor of one number, whose sign is not checked;
            None for 1.

    Returns:
        (B, C, H, W); each channel adds up to 1.

    Raises:
        TypeError: `input` is not a tensor of real numbers; `temperature` is not a number or tensor.
        ValueError: `input` is not (B, C, H, W); `temperature` is not positive or not one number.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.spatial_softmax2d(torch.zeros(1, 1, 2, 2))
        tensor([[[[0.2500, 0.2500],
                  [0.2500, 0.2500]]]])
    """
    _check.images("spatial_softmax2d", "input", input)
    return _softmax("spatial_softmax2d", input, temperature).to(floats(input).dtype)


def _softmax(op: str, input: Tensor, temperature: Tensor | float | None) -> Tensor:
    promoted = as_dtype(input, compute_dtype(input))
    if temperature is not None:
        promoted = promoted / positive(op, input, temperature)
    if _has_long_rows(promoted):
        exponentials = (promoted - promoted.detach().amax((2, 3), keepdim=True)).exp()
        return exponentials / exponentials.sum((2, 3), keepdim=True)
    return promoted.flatten(2).softmax(-1).view(input.shape)


def _has_long_rows(x: Tensor) -> bool:
    """Whether sums over planes take less time than torch's softmax, of which one block of a GPU computes a whole plane."""
    if not x.is_cuda or torch.compiler.is_compiling():
        return False
    return x.shape[0] * x.shape[1] <= 16 and x.shape[2] * x.shape[3] >= 1 << 17


def spatial_expectation2d(input: Tensor, normalized_coordinates: bool = True) -> Tensor:
    """Compute the expected coordinates of each channel, weighted by its values.

    The values are not normalized: a channel whose sum is s gives s times the mean coordinates.

    Args:
        input: probabilities (B, C, H, W). Integers are computed in float32.
        normalized_coordinates: coordinates from -1 to 1, the centers of the outermost pixels; else pixels.

    Returns:
        (B, C, 2), x before y.

    Raises:
        TypeError: `input` is not a tensor of real numbers; `normalized_coordinates` is not a bool.
        ValueError: `input` is not (B, C, H, W).

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 0., 0.], [0., 0., 1.]]]])
        >>> K.geometry.spatial_expectation2d(x, normalized_coordinates=False)
        tensor([[[2., 1.]]])
    """
    _check.images("spatial_expectation2d", "input", input)
    _check.flag("spatial_expectation2d", "normalized_coordinates", normalized_coordinates)
    x = floats(input)
    return as_dtype(_expectation(x, False, 1.0, normalized_coordinates)[0], x.dtype)


def _expectation_reference(input: Tensor, softmax: bool, scale: float, normalized: bool) -> tuple[Tensor, Tensor]:
    """The expected coordinates (B, C, 2) of images (B, C, H, W), weighted by their values or by the softmax of
    `scale` times the values. Also (B, C, 2): the maximum, and the sum of exponentials relative to it, for the softmax."""
    p = input.to(compute_dtype(input))
    parts = p.new_zeros(*p.shape[:2], 2)
    if softmax:
        most = p.detach().amax((2, 3), keepdim=True)
        parts = torch.stack([most[:, :, 0, 0], ((p.detach() - most) * scale).exp().sum((2, 3))], -1)
        p = (p * scale).flatten(2).softmax(-1).view(p.shape)
    x, y = (_axis(n, normalized, p) for n in (p.shape[3], p.shape[2]))
    return torch.stack([(p.sum(2) * x).sum(-1), (p.sum(3) * y).sum(-1)], -1), parts


def _fake(input: Tensor, *_: Any) -> list[Tensor]:
    return [input.new_empty(*input.shape[:2], 2, dtype=compute_dtype(input)) for _ in range(2)]


def _backward_reference(grad: Tensor, coords: Tensor, parts: Tensor, input: Tensor, *args: Any) -> Tensor:
    return vjp(lambda x: _expectation_reference(x, *args)[0])(grad, input)


register(
    "spatial_expectation_backward",
    _backward_reference,
    fake=lambda grad, coords, parts, input, *_: torch.empty_like(input, memory_format=torch.contiguous_format),
    casts_outputs=True,
)
_expectation = register(
    "spatial_expectation",
    _expectation_reference,
    fake=_fake,
    gradients="input: spatial_expectation_backward(coords=result0, parts=result1)",
    non_differentiable=(1,),
    casts_outputs=True,
)


def _axis(n: int, normalized: bool, like: Tensor) -> Tensor:
    first, last = (-1.0, 1.0) if normalized else (0.0, n - 1.0)
    return linspace(first, last, n, like)


def spatial_soft_argmax2d(
    input: Tensor, temperature: Tensor | float | None = None, normalized_coordinates: bool = True
) -> Tensor:
    """Compute the expected coordinates of each channel under the softmax of its pixels: a differentiable argmax.

    Args:
        input: heat maps (B, C, H, W). Integers are computed in float32.
        temperature: divisor of the values: a positive number, or a tensor of one number, whose sign is not checked;
            None for 1.
        normalized_coordinates: coordinates from -1 to 1, the centers of the outermost pixels; else pixels.

    Returns:
        (B, C, 2), x before y.

    Raises:
        TypeError: `input` is not a tensor of real numbers; `temperature` is not a number or tensor; `normalized_coordinates`
            is not a bool.
        ValueError: `input` is not (B, C, H, W); `temperature` is not positive or not one number.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.zeros(1, 1, 3, 4)
        >>> x[0, 0, 1, 2] = 30
        >>> K.geometry.spatial_soft_argmax2d(x, normalized_coordinates=False)
        tensor([[[2., 1.]]])
    """
    op = "spatial_soft_argmax2d"
    _check.images(op, "input", input)
    _check.flag(op, "normalized_coordinates", normalized_coordinates)
    x, scale = floats(input), 1.0
    divisor = None if temperature is None else positive(op, input, temperature)
    if isinstance(divisor, Tensor):
        x = as_dtype(x, compute_dtype(x)) / divisor
    elif divisor is not None:
        scale = 1 / divisor
    return as_dtype(_expectation(x, True, scale, normalized_coordinates)[0], floats(input).dtype)


def render_gaussian2d(mean: Tensor, std: Tensor, size: tuple[int, int], normalized_coordinates: bool = True) -> Tensor:
    """Render heat maps of Gaussians, each with a sum of 1.

    If the mean is far out of the map, all of the weight is on the pixels that are nearest to it.

    Args:
        mean: (*, 2), x before y.
        std: (*, 2) standard deviations along x and y, of the type and device of `mean`, to which it is broadcast.
        size: height and width of the maps.
        normalized_coordinates: `mean` and `std` are in coordinates from -1 to 1, the centers of the outermost pixels;
            else in pixels.

    Returns:
        (*, H, W), of the dtype of `mean`.

    Raises:
        TypeError: `mean` or `std` is not a floating-point tensor; `std` does not have the dtype of `mean`; `size` is not
            two ints; `normalized_coordinates` is not a bool.
        ValueError: `mean` or `std` is not (*, 2); an entry of `size` is below 1;
            the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.render_gaussian2d(torch.zeros(1, 2), torch.ones(1, 2), (3, 3)).sum().round(decimals=4)
        tensor(1.)
    """
    op = "render_gaussian2d"
    for name, x in (("mean", mean), ("std", std)):
        _check.numbers(op, name, x)
        _check.floating(op, name, x)
        if x.dim() == 0 or x.shape[-1] != 2:
            raise ShapeError(f"{op}: expected {name} of shape (*, 2), got {tuple(x.shape)}", actual_shape=x.shape)
    if std.dtype != mean.dtype:
        raise TypeCheckError(f"{op}: expected std of type {mean.dtype}, got {std.dtype}", actual_type=std.dtype)
    _check.same_device(op, mean=mean, std=std)
    _check.leading_axes(op, 1, mean=mean, std=std)
    _check.flag(op, "normalized_coordinates", normalized_coordinates)
    height, width = _check.ints(op, "size", size, 2)
    leading = broadcast_shapes(mean.shape[:-1], std.shape[:-1])
    args = (expand_to_batch(x, leading, 1) for x in (mean, std))
    return _gaussian_maps(*args, height, width, normalized_coordinates).reshape(*leading, height, width)


def _gaussian_reference(mean: Tensor, std: Tensor, height: int, width: int, normalized: bool) -> Tensor:
    """Gaussian maps (P, H, W) with means and standard deviations (P, 2)."""
    axes = []
    for i, n in enumerate((width, height)):
        distance = (_axis(n, normalized, mean) - mean[:, i, None]) / std[:, i, None]
        axes.append((-0.5 * distance * distance).softmax(-1))
    x, y = axes
    return y[:, :, None] * x[:, None, :]


def _gaussian_backward_reference(grad: Tensor, mean: Tensor, std: Tensor, normalized: bool) -> tuple[Tensor, ...]:
    def maps(mean: Tensor, std: Tensor) -> Tensor:
        return _gaussian_reference(mean, std, grad.shape[1], grad.shape[2], normalized)

    return torch.func.vjp(maps, *(x.expand(grad.shape[0], 2) for x in (mean, std)))[1](grad)


_gaussian_maps = register(
    "render_gaussian2d",
    _gaussian_reference,
    fake=lambda mean, std, height, width, _: (batch_of(mean, std), height, width),
    gradients="mean, std: render_gaussian2d_backward",
)
register("render_gaussian2d_backward", _gaussian_backward_reference, fake=lambda grad, *_: [(grad.shape[0], 2)] * 2)


class SpatialSoftArgmax2d(FunctionModule):
    """Module form of :func:`spatial_soft_argmax2d`.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.SpatialSoftArgmax2d()(torch.rand(2, 3, 5, 6)).shape
        torch.Size([2, 3, 2])
    """

    def __init__(self, temperature: Tensor | float | None = None, normalized_coordinates: bool = True) -> None:
        super().__init__(temperature=temperature, normalized_coordinates=normalized_coordinates)

    def forward(self, input: Tensor) -> Tensor:
        return spatial_soft_argmax2d(input, self.temperature, self.normalized_coordinates)
