"""Integral images: sums from the first pixel to every pixel."""

from __future__ import annotations

from torch import Tensor, nn

from kvision import _check
from kvision._modules import FunctionModule
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError


def _reference(x: Tensor, dims: tuple[int, ...]) -> Tensor:
    for dim in dims:
        x = x.cumsum(dim)
    return x


_integral = with_kernel_casts(_reference)


def integral_tensor(input: Tensor, dim: tuple[int, ...] | None = None) -> Tensor:
    """Sum a tensor cumulatively along some of its axes.

    Args:
        input: a tensor with at least one axis.
        dim: the axes, all different; by default the last one.

    Returns:
        Sums of the input's shape, in its type for floating point and in int64 for integers.

    Raises:
        TypeCheckError: input is not a real tensor; dim is not a tuple of ints.
        ShapeError: input has no axes.
        ValueCheckError: dim is empty, repeats an axis, or names one that the input has not.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.integral_tensor(torch.tensor([[1, 2, 3]]))
        tensor([[1, 3, 6]])
    """
    _check.numbers("integral_tensor", "input", input)
    if input.dim() == 0:
        raise ShapeError("integral_tensor: expected input with at least one axis, got ()", actual_shape=input.shape)
    dims = (-1,) if dim is None else _check.scalars("integral_tensor", "dim", dim)
    if not isinstance(dims, (tuple, list)) or any(type(d) is not int for d in dims):
        raise TypeCheckError(f"integral_tensor: expected dim to be a tuple of ints, got {dim!r}", actual_type=type(dim))
    axes = {d % input.dim() for d in dims if -input.dim() <= d < input.dim()}
    if not dims or len(axes) != len(dims):
        raise ValueCheckError(
            f"integral_tensor: expected dim to name different axes of {input.dim()}, got {dim!r}", actual_value=dim
        )
    return _integral(input, tuple(dims)) if input.is_floating_point() else _reference(input, tuple(dims))


def integral_image(image: Tensor) -> Tensor:
    """Sum an image over the rectangle from its first pixel to every pixel, both included.

    Args:
        image: (*, H, W).

    Returns:
        Sums of the image's shape, in its type for floating point and in int64 for integers.

    Raises:
        TypeCheckError: image is not a real tensor.
        ShapeError: image has less than two axes.

    Source: F. C. Crow, "Summed-area tables for texture mapping" (1984).

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.integral_image(torch.ones(2, 3))
        tensor([[1., 2., 3.],
                [2., 4., 6.]])
    """
    _check.numbers("integral_image", "image", image)
    if image.dim() < 2:
        raise ShapeError(f"integral_image: expected image of shape (*, H, W), got {tuple(image.shape)}")
    return integral_tensor(image, (-2, -1))


class IntegralTensor(FunctionModule):
    """Module form of :func:`integral_tensor`.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.IntegralTensor((0,))(torch.ones(3))
        tensor([1., 2., 3.])
    """

    def __init__(self, dim: tuple[int, ...] | None = None) -> None:
        super().__init__(dim=dim)

    def forward(self, input: Tensor) -> Tensor:
        return integral_tensor(input, self.dim)


class IntegralImage(nn.Module):
    """Module form of :func:`integral_image`.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.IntegralImage()(torch.ones(1, 3))
        tensor([[1., 2., 3.]])
    """

    def forward(self, input: Tensor) -> Tensor:
        return integral_image(input)
