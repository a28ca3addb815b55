"""Structural similarity.

With the Gaussian means of a window, E, the two factors of the similarity are written such that neither exceeds 1
despite rounding, and that equal images have exactly 1:

    luminance   1 - (E x - E y)^2 / (E x^2 + E y^2 + c1), with squares of the means
    structure   1 - var(x - y) / (var x + var y + c2)

This form takes four means, of x, y, x^2 + y^2 and (x - y)^2; the textbook's takes five.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, get_args

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._choices import WindowPadding
from kvision._clamp import clamp
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._modes import SSIM_PADDING
from kvision._modules import IMAGE, VOLUME, FunctionModule
from kvision._ops import Operator, register, vjp
from kvision.core.exceptions import ShapeError
from kvision.filters.kernels import gaussian
from kvision.filters.separable import filter_separably

_PADDINGS = get_args(WindowPadding)

SIGMA = 1.5  # of the window, in pixels

REFLECT, CONSTANT, VALID = (SSIM_PADDING[name] for name in ("reflect", "constant", "valid"))


def _similarity(
    mean: Callable[[Tensor], Tensor], x: Tensor, y: Tensor, c1: float, c2: float, eps: float, luminance: bool
) -> Tensor:
    mx, my = mean(x), mean(y)
    squares, apart = mx**2 + my**2, (mx - my) ** 2
    variance = clamp(mean(x**2 + y**2) - squares, 0) + c2
    different = clamp(mean((x - y) ** 2) - apart, 0)
    if not luminance:
        return (variance - different + eps) / (variance + eps)
    squares = squares + c1
    return ((squares - apart) * (variance - different) + eps) / (squares * variance + eps)


def _reference(
    x: Tensor, y: Tensor, size: int, sigma: float, c1: float, c2: float, eps: float, padding: int, luminance: bool
) -> Tensor:
    """The similarity of images (B, C, H, W) or volumes (B, C, D, H, W); `padding` is REFLECT, CONSTANT or VALID."""
    kernel = gaussian(size, sigma, device=x.device, dtype=x.dtype)
    rule = ("reflect", False) if padding == VALID else (("reflect", "constant")[padding], True)

    def mean(z: Tensor) -> Tensor:
        if z.dim() == 4:
            return filter_separably(z, kernel, kernel, *rule)
        b, c, d, _, _ = z.shape
        z = filter_separably(z.flatten(1, 2), kernel, kernel, *rule)
        h, w = z.shape[2:]
        z = z.reshape(b, c, d, h * w)  # slices become rows, so that the column filters across them
        return filter_separably(z, torch.ones_like(kernel[:, :1]), kernel, *rule).unflatten(3, (h, w))

    return _similarity(mean, x, y, c1, c2, eps, luminance)


def _both_gradients(reference: Callable[..., Tensor]) -> Callable[..., tuple[Tensor, Tensor]]:
    """The reference of a backward operator: the gradients of `reference` with respect to both images."""

    def gradients(grad: Tensor, x: Tensor, y: Tensor, *plain: Any) -> tuple[Tensor, Tensor]:
        vjp_fn = torch.func.vjp(lambda x, y: reference(x, y, *plain), x, y.expand_as(x))[1]
        grad_x, grad_y = vjp_fn(grad)
        return grad_x, grad_y

    return gradients


def _backward(one: Operator, both: Operator) -> Callable[..., list[Tensor | None]]:
    """The backward rule, from the operators for the gradient of the first image and for the gradients of both."""

    def backward(needs, grad, x, y, *plain):
        grad_x = grad_y = None
        if needs[0] and needs[1]:
            grad_x, grad_y = both(grad, x, y, *plain)
        elif needs[0]:
            grad_x = one(grad, x, y, *plain)
        else:
            grad_y = one(grad, y.expand_as(x), x, *plain)  # it is symmetric
        if grad_y is not None and y.shape != x.shape:  # y is broadcast
            grad_y = grad_y.sum(0, keepdim=True)
        return [grad_x, grad_y]

    return backward


def _size(
    x: Tensor, y: Tensor, size: int, sigma: float, c1: float, c2: float, eps: float, padding: int, _: bool
) -> Any:
    return (*x.shape[:2], *(n - size + 1 for n in x.shape[2:])) if padding == VALID else x.shape


_ssim = register(
    "ssim",
    _reference,
    fake=_size,
    backward=_backward(
        register("ssim_backward", vjp(_reference), fake=lambda grad, x, *_: x.shape, layout_of=1),
        register(
            "ssim_backward_both", _both_gradients(_reference), fake=lambda grad, x, *_: [x.shape, x.shape], layout_of=1
        ),
    ),
)


def _loss_reference(
    x: Tensor,
    y: Tensor,
    size: int,
    sigma: float,
    c1: float,
    c2: float,
    eps: float,
    padding: int,
    structure: float,
    absolute: float,
) -> Tensor:
    """(B,): the weighted sum of 1 - similarity and of abs(x - y) for every sample."""
    dtype = compute_dtype(x)
    x, y = x.to(dtype), y.to(dtype)
    similar = _reference(x, y, size, sigma, c1, c2, eps, padding, True)
    axes = tuple(range(1, x.dim()))
    return structure * (1 - similar).sum(axes) + absolute * (x - y).abs().sum(axes)


def _like(x: Tensor) -> Tensor:
    return torch.empty_like(x, memory_format=torch.contiguous_format)


_ssim_loss = register(
    "ssim_loss",
    _loss_reference,
    fake=lambda x, *_: x.new_empty(x.shape[:1], dtype=compute_dtype(x)),
    backward=_backward(
        register("ssim_loss_backward", vjp(_loss_reference), fake=lambda grad, x, *_: _like(x), casts_outputs=True),
        register(
            "ssim_loss_backward_both",
            _both_gradients(_loss_reference),
            fake=lambda grad, x, *_: [_like(x), _like(x)],
            casts_outputs=True,
        ),
    ),
    casts_outputs=True,
)


def dissimilarity(
    x: Tensor,
    y: Tensor,
    size: int,
    c1: float,
    c2: float,
    eps: float,
    padding: int,
    structure: float,
    absolute: float,
    factor: float,
) -> Tensor:
    """`factor` times the weighted sum of 1 - similarity and of abs(x - y) over all pixels of images or volumes."""
    b, c, *axes = x.shape
    if b == 0 or c == 0:
        nothing = factor * x.sum()[None]  # vmap of no elements multiplies no single numbers
        return nothing[0]
    dtype = x.dtype
    y = as_dtype(y, dtype)
    if b > 1:
        x, y = x.reshape(1, -1, *axes), y.reshape(1, -1, *axes)
    if is_compiling():  # numbers of operators are constants of a program, and the factor depends on symbolic sizes
        return as_dtype(_ssim_loss(x, y, size, SIGMA, c1, c2, eps, padding, structure, absolute)[0] * factor, dtype)
    weights = factor * structure, factor * absolute
    return as_dtype(_ssim_loss(x, y, size, SIGMA, c1, c2, eps, padding, *weights)[0], dtype)


def similarity(
    x: Tensor, y: Tensor, size: int, sigma: float, c1: float, c2: float, eps: float, padding: int, luminance: bool
) -> Tensor:
    """The similarity of floating-point images or volumes; see `_reference`."""
    return _ssim(x, as_dtype(y, x.dtype), size, sigma, c1, c2, eps, padding, luminance)


def ssim(
    img1: Tensor,
    img2: Tensor,
    window_size: int,
    max_val: float = 1.0,
    eps: float = 1e-12,
    padding: WindowPadding = "same",
) -> Tensor:
    """Compute the structural similarity of two images around every pixel.

    The window is a Gaussian of 1.5 pixels, the constants are (0.01 max_val)^2 and (0.03 max_val)^2, variances are those of
    the population.

    Args:
        img1: image (B, C, H, W); integers are computed in float32.
        img2: image of the same shape, computed in the type of img1.
        window_size: size of the window, odd.
        max_val: largest value that there can be.
        eps: added to both sides of the fraction, so that it is 1 for equal images of any brightness.
        padding: 'same' reflects the images at their border; 'valid' leaves out pixels whose window passes it.

    Returns:
        (B, C, H, W), for 'valid' window_size - 1 pixels less along both axes; from -1 to 1, which equal images have.

    Raises:
        TypeCheckError: not two real tensors.
        ShapeError: not (B, C, H, W), different shapes, images too small for the window.
        ValueCheckError: an even window_size, a negative eps, an unknown padding.
        DeviceError: the tensors are on different devices.

    Source: Z. Wang et al., "Image quality assessment: from error visibility to structural similarity" (2004).

    Example:
        >>> import torch, kvision as K
        >>> x = torch.rand(1, 1, 8, 8)
        >>> K.metrics.ssim(x, x, 5).min()
        tensor(1.)
    """
    return ssim_map("ssim", img1, img2, window_size, max_val, eps, padding)


def ssim_map(
    op: str, img1: Tensor, img2: Tensor, window_size: int, max_val: float, eps: float, padding: WindowPadding
) -> Tensor:
    arguments = checked(op, img1, img2, window_size, max_val, eps, padding)
    return similarity(floats(img1), floats(img2), window_size, SIGMA, *arguments, True)


def ssim3d(
    img1: Tensor,
    img2: Tensor,
    window_size: int,
    max_val: float = 1.0,
    eps: float = 1e-12,
    padding: WindowPadding = "same",
) -> Tensor:
    """Compute the structural similarity of two volumes around every voxel; see :func:`ssim`.

    Args:
        img1: volume (B, C, D, H, W); integers are computed in float32.
        img2: volume of the same shape.
        window_size: size of the window, odd.
        max_val: largest value that there can be.
        eps: added to both sides of the fraction.
        padding: 'same' or 'valid'. 'same' replicates the border of volumes that are too thin to be reflected.

    Returns:
        (B, C, D, H, W), for 'valid' window_size - 1 voxels less along each axis.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`ssim`.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.ssim3d(torch.rand(1, 1, 6, 7, 8), torch.rand(1, 1, 6, 7, 8), 5, padding="valid").shape
        torch.Size([1, 1, 2, 3, 4])
    """
    return ssim3d_map("ssim3d", img1, img2, window_size, max_val, eps, padding)


def ssim3d_map(
    op: str, img1: Tensor, img2: Tensor, window_size: int, max_val: float, eps: float, padding: WindowPadding
) -> Tensor:
    img1, img2, arguments = checked_volumes(op, img1, img2, window_size, max_val, eps, padding)
    return similarity(img1, img2, window_size, SIGMA, *arguments, True)


def checked(
    op: str, img1: Tensor, img2: Tensor, size: int, max_val: float, eps: float, padding: WindowPadding
) -> tuple[float, float, float, int]:
    """Check two images; return c1, c2, eps and the number of the padding."""
    _check.images(op, "img1", img1)
    return _arguments(op, img1, img2, size, max_val, eps, padding)


def checked_volumes(
    op: str, img1: Tensor, img2: Tensor, size: int, max_val: float, eps: float, padding: WindowPadding
) -> tuple[Tensor, Tensor, tuple[float, float, float, int]]:
    """Check two volumes; return them as floats, and c1, c2, eps and the number of the padding.

    Volumes that are too thin to be reflected come with a replicated border instead.
    """
    _check.volumes(op, "img1", img1)
    c1, c2, eps, number = _arguments(op, img1, img2, size, max_val, eps, padding)
    img1, img2 = floats(img1), floats(img2)
    if padding == "same" and min(img1.shape[2:]) <= size // 2:
        border = (size // 2,) * 6
        img1, img2 = (torch.nn.functional.pad(x, border, mode="replicate") for x in (img1, img2))
        number = VALID
    return img1, img2, (c1, c2, eps, number)


def _arguments(
    op: str, img1: Tensor, img2: Tensor, size: int, max_val: float, eps: float, padding: WindowPadding
) -> tuple[float, float, float, int]:
    """c1, c2, eps and the number of the padding."""
    _check.numbers(op, "img2", img2)
    if img1.shape != img2.shape:
        _check.same_shape(op, img1=img1, img2=img2)
    _check.same_device(op, img1=img1, img2=img2)
    _check.odd(op, "window_size", _check.ints(op, "window_size", size, 1))
    max_val = _check.number(op, "max_val", max_val)
    eps = _check.number(op, "eps", eps, minimum=0)
    _check.choice(op, "padding", padding, _PADDINGS)
    smallest = min(img1.shape[2:])
    if padding == "same" and smallest <= size // 2 and img1.dim() == 4:
        _check.reflectable(op, img1, (size // 2,) * 2, "reflect", "use a smaller window_size")
    elif padding == "valid" and smallest < size:
        raise ShapeError(
            f"{op}: expected images no smaller than the window of {size}, got {tuple(img1.shape)}",
            actual_shape=img1.shape,
        )
    return (0.01 * max_val) ** 2, (0.03 * max_val) ** 2, eps, VALID if padding == "valid" else REFLECT


class SSIM(FunctionModule):
    """Module form of :func:`ssim`.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.SSIM(5)(torch.rand(1, 3, 8, 8), torch.rand(1, 3, 8, 8)).shape
        torch.Size([1, 3, 8, 8])
    """

    samples = IMAGE, IMAGE

    def __init__(
        self, window_size: int, max_val: float = 1.0, eps: float = 1e-12, padding: WindowPadding = "same"
    ) -> None:
        super().__init__(window_size=window_size, max_val=max_val, eps=eps, padding=padding)

    def forward(self, img1: Tensor, img2: Tensor) -> Tensor:
        return ssim(img1, img2, self.window_size, self.max_val, self.eps, self.padding)


class SSIM3D(FunctionModule):
    """Module form of :func:`ssim3d`.

    Example:
        >>> import torch, kvision as K
        >>> K.metrics.SSIM3D(3)(torch.rand(1, 1, 4, 5, 6), torch.rand(1, 1, 4, 5, 6)).shape
        torch.Size([1, 1, 4, 5, 6])
    """

    samples = VOLUME, VOLUME

    def __init__(
        self, window_size: int, max_val: float = 1.0, eps: float = 1e-12, padding: WindowPadding = "same"
    ) -> None:
        super().__init__(window_size=window_size, max_val=max_val, eps=eps, padding=padding)

    def forward(self, img1: Tensor, img2: Tensor) -> Tensor:
        return ssim3d(img1, img2, self.window_size, self.max_val, self.eps, self.padding)
