"""Box blur: the mean of every window."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._choices import Border
from kvision._dtype import pixels
from kvision._modes import BORDER, BORDER_NAMES
from kvision._modules import FunctionModule
from kvision._ops import register, transpose
from kvision.filters.separable import filter_separably


def window_sum(x: Tensor, ky: int, kx: int, border: int) -> Tensor:
    """The sum of the ky x kx window around every pixel; exact for integers below 2^24."""
    return filter_separably(x, x.new_ones(1, kx), x.new_ones(1, ky), BORDER_NAMES[border])


def divide_exactly(x: Tensor, n: int) -> Tensor:
    """x / n, correctly rounded: on CUDA torch multiplies by the reciprocal of a number, which may miss a tie of bytes."""
    return x / x.new_full((), n)


def _reference(x: Tensor, ky: int, kx: int, border: int) -> Tensor:
    return divide_exactly(window_sum(x, ky, kx, border), ky * kx)


_box_blur = register("box_blur", _reference, gradients="input: box_blur_backward", linear=True, bytes=True)
_transposed = register(
    "box_blur_backward", transpose(_reference), gradients="grad: box_blur(input=grad_grad)", linear=True
)


def box_blur(
    input: Tensor, kernel_size: tuple[int, int] | int, border_type: Border = "reflect", separable: bool = True
) -> Tensor:
    """Replace every pixel by the mean of its window.

    Args:
        input: image (B, C, H, W). uint8 gives uint8 (rounded half to even), other integers give float32.
        kernel_size: size of the window, an int or (y, x). An even one reaches one pixel further right and down.
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.
        separable: for compatibility; the result is the same.

    Returns:
        The blurred image.

    Raises:
        TypeCheckError: input is not a real tensor; kernel_size is not of ints.
        ShapeError: input is not (B, C, H, W); a border wider than the image.
        ValueCheckError: a kernel_size below 1, an unknown border_type.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 3., 6., 0.]]]])
        >>> K.filters.box_blur(x, (1, 3), "replicate")
        tensor([[[[1., 3., 3., 2.]]]])
    """
    return _box_blur(*box_arguments("box_blur", input, kernel_size, border_type))


class BoxBlur(FunctionModule):
    """Module form of :func:`box_blur`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.BoxBlur(5)(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self, kernel_size: tuple[int, int] | int, border_type: Border = "reflect", separable: bool = True
    ) -> None:
        super().__init__(kernel_size=kernel_size, border_type=border_type, separable=separable)

    def forward(self, input: Tensor) -> Tensor:
        return box_blur(input, self.kernel_size, self.border_type, self.separable)


def box_arguments(
    op: str, input: Tensor, kernel_size: tuple[int, int] | int, border_type: Border
) -> tuple[Tensor, int, int, int]:
    """The checked arguments of a box blur as its operator takes them."""
    _check.images(op, "input", input)
    ky, kx = _check.pair(op, "kernel_size", kernel_size)
    _check.border(op, border_type)
    _check.reflectable(op, input, (ky // 2, kx // 2), border_type)
    return pixels(input), ky, kx, BORDER[border_type]
