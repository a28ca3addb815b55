"""Unsharp mask."""

from __future__ import annotations

from torch import Tensor

from kvision._choices import Border
from kvision._modules import FunctionModule
from kvision._ops import register, transpose
from kvision.filters.smoothing.gaussian import _reference as blur
from kvision.filters.smoothing.gaussian import blur_arguments, sigma_gradient


def _reference(
    x: Tensor, sigma: Tensor | None, ky: int, kx: int, sigma_y: float, sigma_x: float, border: int
) -> Tensor:
    return 2 * x - blur(x, sigma, ky, kx, sigma_y, sigma_x, border)


_unsharp_mask = register(
    "unsharp_mask",
    _reference,
    gradients="input: unsharp_mask_backward; sigma: by_hand",
    backward=lambda needs, grad, x, *blur: [None, -sigma_gradient(grad, x, *blur)],
    linear=True,
    bytes=True,
)
register(
    "unsharp_mask_backward",
    transpose(_reference),
    gradients="grad: unsharp_mask(input=grad_grad); sigma: by_hand",
    backward=lambda needs, grad_grad, grad, *blur: [None, -sigma_gradient(grad, grad_grad, *blur)],
    linear=True,
)


def unsharp_mask(
    input: Tensor,
    kernel_size: tuple[int, int] | int,
    sigma: tuple[float, float] | Tensor | float,
    border_type: Border = "reflect",
) -> Tensor:
    """Sharpen an image by adding its difference from a Gaussian blur: 2 * input - gaussian_blur2d(input).

    Args:
        input: image (B, C, H, W). uint8 gives uint8 (rounded half to even, saturated), other integers give float32.
        kernel_size: size of the blur's window, an odd int or (y, x).
        sigma: standard deviation of the blur in pixels, a number, (y, x), or a tensor (1, 2) or (B, 2).
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.

    Returns:
        The sharpened image, not clamped; differentiable in image and sigma.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`gaussian_blur2d`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 0., 1., 0., 0.]]]])
        >>> K.filters.unsharp_mask(x, (1, 3), (1.0, 1.0))
        tensor([[[[ 0.0000, -0.2741,  1.5481, -0.2741,  0.0000]]]])
    """
    return _unsharp_mask(*blur_arguments("unsharp_mask", input, kernel_size, sigma, border_type))


class UnsharpMask(FunctionModule):
    """Module form of :func:`unsharp_mask`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.UnsharpMask(5, (1.5, 1.5))(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        kernel_size: tuple[int, int] | int,
        sigma: tuple[float, float] | Tensor | float,
        border_type: Border = "reflect",
    ) -> None:
        super().__init__(kernel_size=kernel_size, sigma=sigma, border_type=border_type)

    def forward(self, input: Tensor) -> Tensor:
        return unsharp_mask(input, self.kernel_size, self.sigma, self.border_type)
