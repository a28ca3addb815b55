"""Bilateral blur, plain and guided by a second image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Border
from kvision._dtype import as_dtype, compute_dtype, pixels
from kvision._modes import BORDER, BORDER_NAMES, COLOR_DISTANCE
from kvision._modules import IMAGE, FunctionModule
from kvision._ops import register
from kvision.core.border import windows
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.filters.smoothing.gaussian import axis_kernels, batch_of, positive, sigma_arguments

ColorDistance: TypeAlias = Literal["l1", "l2"]
_DISTANCES = get_args(ColorDistance)


def _reference(x: Tensor, *args: Any) -> tuple[Tensor, Tensor]:
    """Also return the sums of the weights (B, 1, H, W), which the gradient reads, or (B, 0, H, W) if they are not to be kept."""
    *plain, keeps_totals = args
    weights, taps, _ = _weights(x, *plain)
    totals = weights.sum(0).expand(x.shape[0], -1, *x.shape[2:])
    return (weights * taps).sum(0) / totals, totals[:, : int(keeps_totals)]


def _weights(
    x: Tensor,
    guidance: Tensor | None,
    sigma_color: Tensor | None,
    sigma_space: Tensor | None,
    ky: int,
    kx: int,
    color: float,
    sigma_y: float,
    sigma_x: float,
    border: int,
    distance: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """For each tap of the windows its weight, its pixel of `x` and its squared distance in color."""
    guide = x if guidance is None else guidance
    taps = windows(x, ky, kx, BORDER_NAMES[border])
    difference = (taps if guidance is None else windows(guide, ky, kx, BORDER_NAMES[border])) - guide
    if distance == COLOR_DISTANCE["l1"]:
        squared = difference.abs().sum(2, keepdim=True) ** 2
    else:
        squared = (difference**2).sum(2, keepdim=True)
    width: Any = color if sigma_color is None else positive(sigma_color)[:, None, None, None]
    kernel_y, kernel_x = axis_kernels(x, sigma_space, ky, kx, sigma_y, sigma_x)
    space = (kernel_y[:, :, None] * kernel_x[:, None, :]).flatten(1).t()[:, :, None, None, None]
    return space * torch.exp(squared / width / width / -2), taps, squared  # the square of a small width may be 0


def _reference_backward(grad: Tensor, x: Tensor, guidance: Tensor | None, *args: Any) -> tuple[Tensor, Tensor]:
    """The gradients to image and guidance; one that is not requested has no channels."""
    color, space, _, _, *numbers, wants_x, wants_guidance = args  # output and totals follow from the others
    rest = (color, space, *numbers, False)
    nothing = grad.new_empty(grad.shape[0], 0, *grad.shape[2:])
    if guidance is None:
        _, vjp_fn = torch.func.vjp(lambda x: _reference(x, None, *rest)[0], x)
        return vjp_fn(grad)[0] if wants_x else nothing, nothing
    guidance = guidance.expand(x.shape[0], -1, -1, -1)
    _, vjp_fn = torch.func.vjp(lambda x, guidance: _reference(x, guidance, *rest)[0], x, guidance)
    grad_x, grad_guidance = vjp_fn(grad)
    return grad_x if wants_x else nothing, grad_guidance if wants_guidance else nothing


def _backward_sizes(grad: Tensor, x: Tensor, guidance: Tensor | None, *args: Any) -> list[tuple[int, ...]]:
    *_, wants_x, wants_guidance = args
    channels = (x.shape[1] if wants_x else 0, guidance.shape[1] if wants_guidance and guidance is not None else 0)
    return [(x.shape[0], c, *x.shape[2:]) for c in channels]


def _reference_sigma_sums(grad: Tensor, x: Tensor, *args: Any) -> Tensor:
    """(B, 3, H): the gradients to (sigma_color, sigma_y, sigma_x) times sigma^3, row by row."""
    weights, taps, squared = _weights(x, *args)
    _, _, _, ky, kx, *_ = args
    total = weights.sum(0)
    weight_grads = (grad / total * (taps - (weights * taps).sum(0) / total)).sum(2, keepdim=True) * weights
    dy, dx = (torch.arange(k, device=x.device, dtype=x.dtype) - k // 2 for k in (ky, kx))
    dy, dx = (d.flatten()[:, None, None, None, None] for d in torch.meshgrid(dy, dx, indexing="ij"))
    return torch.stack([(weight_grads * square).sum((0, 2, 4)) for square in (squared, dy**2, dx**2)], 1)


def _backward(
    needs: Sequence[bool], grad: Tensor, of_totals: None, output: Tensor, totals: Tensor, *args: Any
) -> list[Tensor | None]:
    x, _, sigma_color, sigma_space, *numbers, keeps_totals = args
    grads: list[Any] = [None] * 4
    if needs[0] or needs[1]:
        kept = (output.detach(), totals) if keeps_totals else (None, None)
        grads[:2] = _bilateral_blur_backward(grad, *args[:4], *kept, *numbers, needs[0], needs[1])
    if needs[2] or needs[3]:
        promoted = compute_dtype(x)  # sums of many products
        sums = _bilateral_blur_sigma_sums(grad.to(promoted), x.to(promoted), *args[1:-1]).sum(2)
        grads[2] = sums[:, 0] / sigma_color**3 if needs[2] else None
        grads[3] = sums[:, 1:] / sigma_space**3 if needs[3] else None
    # One guidance or sigma may have served the whole batch.
    return [g.sum_to_size(a.shape) if need else None for g, a, need in zip(grads, args[:4], needs[:4], strict=True)]


_bilateral_blur = register(
    "bilateral_blur",
    _reference,
    fake=lambda x, *args: [x.shape, (x.shape[0], int(args[-1]), *x.shape[2:])],
    backward=_backward,
    saves_results=True,
    non_differentiable=(1,),
    bytes=True,
)
_bilateral_blur_backward = register("bilateral_blur_backward", _reference_backward, fake=_backward_sizes)
_bilateral_blur_sigma_sums = register(
    "bilateral_blur_sigma_sums", _reference_sigma_sums, fake=lambda grad, *_: (grad.shape[0], 3, grad.shape[2])
)


def bilateral_blur(
    input: Tensor,
    kernel_size: tuple[int, int] | int,
    sigma_color: Tensor | float,
    sigma_space: tuple[float, float] | Tensor | float,
    border_type: Border = "reflect",
    color_distance_type: ColorDistance = "l1",
) -> Tensor:
    """Blur an image with weights that fall with the distance in space and in color, which keeps edges.

    A pixel of the window at distance d in space and c in color weighs
    exp(-d^2 / (2 sigma_space^2)) exp(-c^2 / (2 sigma_color^2)); the weights are divided by their sum.

    Args:
        input: image (B, C, H, W). uint8 gives uint8 (rounded half to even), other integers give float32.
        kernel_size: size of the window, an odd int or (y, x).
        sigma_color: standard deviation in color, in units of the input; a number or a tensor (1,) or (B,).
        sigma_space: standard deviation in pixels; a number, (y, x), or a tensor (1, 2) or (B, 2). Tensors may carry
            gradients; where one is not positive the result is NaN, as its values are not read on the host.
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.
        color_distance_type: 'l1', the sum of |difference| over the channels, or 'l2', the Euclidean distance.

    Returns:
        The blurred image; differentiable in image and sigmas.

    Raises:
        TypeCheckError: input is not a real tensor; an argument of the wrong type.
        ShapeError: wrong ranks or batch sizes; a border wider than the image.
        ValueCheckError: an even kernel size, a sigma that is not positive, an unknown border_type or distance.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Source: C. Tomasi and R. Manduchi, "Bilateral filtering for gray and color images" (1998).

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 0.1, 1., 0.9]]]])
        >>> K.filters.bilateral_blur(x, (1, 3), 0.1, (1.0, 1.0))
        tensor([[[[0.0424, 0.0731, 0.9731, 0.9424]]]])
    """
    return _checked(
        "bilateral_blur", input, None, kernel_size, sigma_color, sigma_space, border_type, color_distance_type
    )


def joint_bilateral_blur(
    input: Tensor,
    guidance: Tensor,
    kernel_size: tuple[int, int] | int,
    sigma_color: Tensor | float,
    sigma_space: tuple[float, float] | Tensor | float,
    border_type: Border = "reflect",
    color_distance_type: ColorDistance = "l1",
) -> Tensor:
    """Blur an image with weights that fall with the distance in space and in the colors of a second image.

    Args:
        input: image (B, C, H, W). uint8 gives uint8 (rounded half to even), other integers give float32.
        guidance: image (B, any channels, H, W) whose colors are compared, in units of its own.
        kernel_size, sigma_color, sigma_space, border_type, color_distance_type: as :func:`bilateral_blur`.

    Returns:
        The blurred image; differentiable in both images and the sigmas.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`bilateral_blur`; also where guidance differs
            from input in batch, height or width.

    Example:
        >>> import torch, kvision as K
        >>> x, flat = torch.tensor([[[[0., 1., 0., 1.]]]]), torch.zeros(1, 1, 1, 4)
        >>> K.filters.joint_bilateral_blur(x, flat, (1, 3), 0.1, (1.0, 1.0))
        tensor([[[[0.5481, 0.4519, 0.5481, 0.4519]]]])
    """
    _check.images("joint_bilateral_blur", "guidance", guidance)
    return _checked(
        "joint_bilateral_blur", input, guidance, kernel_size, sigma_color, sigma_space, border_type, color_distance_type
    )


def _checked(
    op: str,
    input: Tensor,
    guidance: Tensor | None,
    kernel_size: tuple[int, int] | int,
    sigma_color: Tensor | float,
    sigma_space: tuple[float, float] | Tensor | float,
    border_type: Border,
    color_distance_type: ColorDistance,
) -> Tensor:
    _check.images(op, "input", input)
    if guidance is not None:
        b, _, h, w = input.shape
        if (guidance.shape[0], *guidance.shape[2:]) != (b, h, w):
            raise ShapeError(
                f"{op}: expected guidance of shape ({b}, C, {h}, {w}), got {tuple(guidance.shape)}",
                actual_shape=guidance.shape,
            )
        _check.same_device(op, input=input, guidance=guidance)
        guidance = as_dtype(guidance, compute_dtype(input))
    ky, kx = _check.pair(op, "kernel_size", kernel_size)
    _check.odd(op, "kernel_size", (ky, kx))
    color, number = _sigma_color(op, input, sigma_color)
    space, sigma_y, sigma_x = sigma_arguments(op, "sigma_space", input, sigma_space)
    _check.border(op, border_type)
    _check.reflectable(op, input, (ky // 2, kx // 2), border_type)
    _check.choice(op, "color_distance_type", color_distance_type, _DISTANCES)
    border, distance = BORDER[border_type], COLOR_DISTANCE[color_distance_type]
    # The kernels that read the totals are those of float32 images on a GPU.
    keeps_totals = (
        input.is_cuda
        and input.dtype == torch.float32
        and guidance is None
        and input.requires_grad
        and torch.is_grad_enabled()
    )
    numbers = (ky, kx, number, sigma_y, sigma_x, border, distance)
    return _bilateral_blur(pixels(input), guidance, color, space, *numbers, keeps_totals)[0]


def _sigma_color(op: str, x: Tensor, value: Tensor | float) -> tuple[Tensor | None, float]:
    """sigma_color for images `x`: (tensor (B or 1,), 0) or (None, number)."""
    if isinstance(value, Tensor):
        value = value.reshape(1) if value.dim() == 0 else value
        _check.shape(op, "sigma_color", value, "B")
        return batch_of(op, "sigma_color", x, value), 0.0
    value = _check.scalar(op, "sigma_color", value)
    if not isinstance(value, (int, float)):
        raise TypeCheckError(
            f"{op}: expected sigma_color to be a number or a Tensor (B,), got {value!r}", actual_type=type(value)
        )
    if not value > 0 or not _check.fits_float(value):  # also refuses NaN
        raise ValueCheckError(f"{op}: expected sigma_color to be a positive number, got {value!r}", actual_value=value)
    return None, float(value)


class _Bilateral(FunctionModule):
    def __init__(
        self,
        kernel_size: tuple[int, int] | int,
        sigma_color: Tensor | float,
        sigma_space: tuple[float, float] | Tensor | float,
        border_type: Border = "reflect",
        color_distance_type: ColorDistance = "l1",
    ) -> None:
        super().__init__(
            kernel_size=kernel_size,
            sigma_color=sigma_color,
            sigma_space=sigma_space,
            border_type=border_type,
            color_distance_type=color_distance_type,
        )


class BilateralBlur(_Bilateral):
    """Module form of :func:`bilateral_blur`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.BilateralBlur(3, 0.1, (1.5, 1.5))(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def forward(self, input: Tensor) -> Tensor:
        return bilateral_blur(
            input, self.kernel_size, self.sigma_color, self.sigma_space, self.border_type, self.color_distance_type
        )


class JointBilateralBlur(_Bilateral):
    """Module form of :func:`joint_bilateral_blur`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.JointBilateralBlur(3, 0.1, (1.5, 1.5))(torch.rand(2, 3, 8, 8), torch.rand(2, 1, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    samples = IMAGE, IMAGE

    def forward(self, input: Tensor, guidance: Tensor) -> Tensor:
        return joint_bilateral_blur(
            input,
            guidance,
            self.kernel_size,
            self.sigma_color,
            self.sigma_space,
            self.border_type,
            self.color_distance_type,
        )
