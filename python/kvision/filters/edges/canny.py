"""Canny edges: blur, gradient, thinning, two thresholds, and hysteresis between them."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._modules import FunctionModule
from kvision._ops import register
from kvision.color.gray import LUMA
from kvision.color.program import arguments, run
from kvision.color.steps import STEPS
from kvision.core.exceptions import ImageError, ValueCheckError
from kvision.filters.edges.sobel import _sobel_backward, root
from kvision.filters.edges.spatial_gradient import derivatives
from kvision.filters.smoothing.gaussian import _gaussian_blur2d, blur_arguments

_TAN_22_5 = math.sqrt(2) - 1


def _reference_suppress(x: Tensor, low: float, high: float, eps: float) -> tuple[Tensor, Tensor]:
    """From a smooth gray image (B, 1, H, W) its gradient magnitude, 0 where that is no ridge, and edges 0, 0.5 or 1.

    A pixel is on a ridge when neither neighbor along its gradient, rounded to 45 degrees, is stronger. Along x and y
    the first of two equal neighbors stays, on a diagonal none.
    """
    h, w = x.shape[-2:]
    gx, gy = derivatives(x, "sobel", 1, normalized=False).unbind(2)
    padded = root(F.pad(gx**2 + gy**2, (1, 1, 1, 1)) + eps)

    def at(dy: int, dx: int) -> Tensor:
        return padded[..., 1 + dy : 1 + dy + h, 1 + dx : 1 + dx + w]

    magnitude = at(0, 0)
    along_x = (magnitude > at(0, -1)) & (magnitude >= at(0, 1))
    along_y = (magnitude > at(-1, 0)) & (magnitude >= at(1, 0))
    falling = (magnitude > at(-1, -1)) & (magnitude > at(1, 1))
    rising = (magnitude > at(1, -1)) & (magnitude > at(-1, 1))
    falls = (gx > 0) == (gy > 0)
    diagonal = (falls & falling) | (~falls & rising)
    mostly_y = gx.abs() < _TAN_22_5 * gy.abs()
    mostly_x = gy.abs() <= _TAN_22_5 * gx.abs()
    ridge = (mostly_x & along_x) | (~mostly_x & ((mostly_y & along_y) | (~mostly_y & diagonal)))
    ridge = ridge & (magnitude > padded[..., :1, :1])  # the corner is outside of the image: no gradient
    magnitude = magnitude * ridge
    edges = 0.5 * ((magnitude > low).to(x.dtype) + (magnitude > high).to(x.dtype))
    return magnitude, edges


def _suppress_backward(needs, grad, _, magnitude, edges, x, low, high, eps):
    """Where the magnitude was kept, its gradient is that of the Sobel magnitude."""
    return [_sobel_backward(grad * (magnitude > 0), x, False, eps)]


_canny_suppress = register(
    "canny_suppress",
    _reference_suppress,
    fake=lambda x, *_: [x.shape, x.shape],
    backward=_suppress_backward,
    saves_results=True,
    non_differentiable=(1,),
)


def _reference_hysteresis(edges: Tensor) -> Tensor:
    """1 on strong edges (1) and on weak ones (0.5) that touch them in 8 directions, also through each other; else 0.

    How long it takes depends on the edges, so vmap, which hides them, needs the kernels.
    """
    candidates, strong = (edges > 0).to(edges.dtype), (edges == 1).to(edges.dtype)

    def grow(strong: Tensor, _: Tensor) -> tuple[Tensor, Tensor]:
        grown = candidates * F.max_pool2d(strong, 3, stride=1, padding=1)
        return grown, (grown != strong).any()

    changed = torch.ones((), dtype=torch.bool, device=edges.device)
    if is_compiling():  # a graph has loops of its own
        return torch.while_loop(lambda _, changed: changed.clone(), grow, (strong, changed))[0]
    while changed:
        strong, changed = grow(strong, changed)
    return strong


_canny_hysteresis = register("canny_hysteresis", _reference_hysteresis, non_differentiable=(0,))


def canny(
    input: Tensor,
    low_threshold: float = 0.1,
    high_threshold: float = 0.2,
    kernel_size: tuple[int, int] | int = (5, 5),
    sigma: tuple[float, float] | Tensor = (1, 1),
    hysteresis: bool = True,
    eps: float = 1e-6,
) -> tuple[Tensor, Tensor]:
    """Find edges: thin lines along the ridges of the gradient magnitude.

    The image, made gray, is blurred with a Gaussian. Its unnormalized Sobel gradient has the magnitude
    sqrt(gx^2 + gy^2 + eps), which becomes 0 where it is no maximum along the gradient. What is above high_threshold is
    a strong edge, what is above low_threshold a weak one.

    Args:
        input: image (B, C, H, W) with 1 or 3 (RGB) channels; integers are computed in float32, keeping their range.
        low_threshold: above 0, in units of the magnitude. Of uint8 images a threshold of at most 1 is a fraction of 255.
        high_threshold: at least low_threshold.
        kernel_size: size of the blur's window, an odd int or (y, x).
        sigma: standard deviation of the blur in pixels, (y, x) or a tensor (1, 2) or (B, 2).
        hysteresis: keep weak edges that are connected to strong ones as edges, and drop the others.
        eps: added under the root, which keeps the gradient finite on flat images.

    Returns:
        magnitude (B, 1, H, W), differentiable, and edges (B, 1, H, W), which carry no gradient: 1 on edges and 0
        elsewhere, or, without hysteresis, 1 on strong and 0.5 on weak edges.

    Raises:
        TypeCheckError, ShapeError, DeviceError: as :func:`gaussian_blur2d`.
        ImageError: input has neither 1 nor 3 channels.
        ValueCheckError: as :func:`gaussian_blur2d`; thresholds that are not 0 < low_threshold <= high_threshold, a
            negative eps.

    Source: J. Canny, "A computational approach to edge detection" (1986).

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([0, 0, 0, 0.5, 1, 1, 1]).expand(1, 1, 5, 7)
        >>> K.filters.canny(x)[1][0, 0, 2]
        tensor([0., 0., 0., 1., 0., 0., 0.])
    """
    _check.images("canny", "input", input)
    if input.shape[1] not in (1, 3):
        raise ImageError(
            f"canny: expected input with 1 or 3 channels, got {tuple(input.shape)}{_check.channels_advice(input.shape)}"
        )
    low_threshold = _check.number("canny", "low_threshold", low_threshold)
    high_threshold = _check.number("canny", "high_threshold", high_threshold)
    if input.dtype == torch.uint8:
        low_threshold, high_threshold = (255 * t if t <= 1 else t for t in (low_threshold, high_threshold))
    if not 0 < low_threshold <= high_threshold:
        raise ValueCheckError(
            f"canny: expected low_threshold above 0 and up to high_threshold, got {low_threshold} and {high_threshold}"
        )
    _check.flag("canny", "hysteresis", hysteresis)
    eps = _check.number("canny", "eps", eps, minimum=0)
    ky, kx = _check.pair("canny", "kernel_size", kernel_size)
    _check.reflectable("canny", input, (ky // 2, kx // 2), "reflect", "use a smaller kernel_size")
    x, computed = floats(input), compute_dtype(input)
    dtype = x.dtype
    if x.shape[1] == 3:
        x = run(x, [STEPS["weighted_sum"].number], arguments(LUMA), dtype=computed)
    x = as_dtype(x, computed)
    x = _gaussian_blur2d(*blur_arguments("canny", x, kernel_size, sigma, "reflect"))
    magnitude, edges = _canny_suppress(x, low_threshold, high_threshold, eps)
    if hysteresis:
        edges = _canny_hysteresis(edges)
    return as_dtype(magnitude, dtype), as_dtype(edges, dtype)


class Canny(FunctionModule):
    """Module form of :func:`canny`.

    Example:
        >>> import torch, kvision as K
        >>> magnitude, edges = K.filters.Canny()(torch.rand(2, 3, 8, 8))
        >>> edges.shape
        torch.Size([2, 1, 8, 8])
    """

    def __init__(
        self,
        low_threshold: float = 0.1,
        high_threshold: float = 0.2,
        kernel_size: tuple[int, int] | int = (5, 5),
        sigma: tuple[float, float] | Tensor = (1, 1),
        hysteresis: bool = True,
        eps: float = 1e-6,
    ) -> None:
        super().__init__(
            low_threshold=low_threshold,
            high_threshold=high_threshold,
            kernel_size=kernel_size,
            sigma=sigma,
            hysteresis=hysteresis,
            eps=eps,
        )

    def forward(self, input: Tensor) -> tuple[Tensor, Tensor]:
        return canny(
            input,
            self.low_threshold,
            self.high_threshold,
            self.kernel_size,
            self.sigma,
            self.hysteresis,
            self.eps,
        )
