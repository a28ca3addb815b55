"""Images at other sizes."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype, pixels
from kvision._modules import FunctionModule
from kvision._ops import saturate_to_byte
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.filters import gaussian_blur2d
from kvision.geometry.transform import sampling

__all__ = ["Rescale", "Resize", "rescale", "resize", "resize_to_be_divisible"]

_INTERPOLATIONS = ("bilinear", "nearest", "nearest-exact", "bicubic", "area")
_SIDES = ("short", "long", "vert", "horz")


def resize(
    input: Tensor,
    size: int | tuple[int, int],
    interpolation: str = "bilinear",
    align_corners: bool | None = None,
    side: str = "short",
    antialias: bool | str = False,
) -> Tensor:
    """Resample images to a size.

    Args:
        input: images (*, H, W), floating point or uint8. Other integers are computed in float32.
        size: height and width, or one side; the other one then keeps the image's proportions, rounded down.
        interpolation: 'bilinear', 'bicubic', 'nearest', 'nearest-exact' (of the nearest middle, as OpenCV's INTER_NEAREST_EXACT)
            or 'area' (means).
        align_corners: keep the middles of the corner pixels where they are, for 'bilinear' and 'bicubic'. None or False
            keeps the image's edges.
        side: which one an int is: 'short', 'long', 'vert' (height) or 'horz' (width).
        antialias: where the image shrinks, widen the window of 'bilinear' and 'bicubic' as much, as torch and Pillow do;
            'gaussian' blurs the image first instead, with sigma (factor - 1) / 2.

    Returns:
        (*, h, w), of the type of `input`; uint8 is rounded half to even and saturated.

    Raises:
        TypeError: an argument is of another kind.
        ValueError: a shape, size or name is not as above.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.resize(torch.arange(4.0).reshape(1, 4), (1, 2))
        tensor([[0.5000, 2.5000]])
        >>> K.geometry.resize(torch.rand(3, 20, 30), 10).shape
        torch.Size([3, 10, 15])
    """
    return _resize("resize", input, size, interpolation, align_corners, side, antialias)


def _resize(op, input, size, interpolation, align_corners, side, antialias):
    _check_images(op, input)
    _check.choice(op, "interpolation", interpolation, _INTERPOLATIONS)
    _check.choice(op, "side", side, _SIDES)
    if antialias != "gaussian":
        _check.flag(op, "antialias", antialias)
    if align_corners is not None:
        _check.flag(op, "align_corners", align_corners)
    h, w = input.shape[-2:]
    if type(size) is int:
        height, width = _from_side(_check.ints(op, "size", size, 1)[0], h, w, side)
    else:
        height, width = _check.ints(op, "size", size, 2)
    images = input.reshape(-1, *input.shape[-3:]) if input.dim() > 2 else input[None, None]
    shrinks = height < h or width < w
    if antialias == "gaussian" and shrinks:
        images = _blurred(images.to(compute_dtype(images)), h / height, w / width)
    smooth = interpolation in ("bilinear", "bicubic")
    if smooth and not (antialias is True and shrinks) and not (align_corners and 1 in (height, width)):
        found = _sampled(images, height, width, interpolation, bool(align_corners))
        return _stored(found, input).reshape(*input.shape[:-2], height, width)
    wide = images.to(compute_dtype(images))
    found = F.interpolate(
        wide,
        (height, width),
        mode=interpolation,
        align_corners=align_corners if smooth else None,
        antialias=antialias is True and shrinks and smooth,
    )
    return _stored(found, input).reshape(*input.shape[:-2], height, width)


def _sampled(images: Tensor, height: int, width: int, interpolation: str, align_corners: bool) -> Tensor:
    """The identity in [-1, 1], by the kernels of warps."""
    images = pixels(images)
    eye = torch.eye(3, dtype=compute_dtype(images), device=images.device)[None]
    return sampling.warp(images, eye, None, [height, width], interpolation, "border", align_corners, False, True)


def _stored(found: Tensor, input: Tensor) -> Tensor:
    if input.dtype == torch.uint8:
        return found if found.dtype == torch.uint8 else saturate_to_byte(found)
    return found.to(input.dtype) if input.is_floating_point() else found


def _check_images(op: str, input: Tensor) -> None:
    _check.numbers(op, "input", input)
    if input.dim() < 2 or 0 in input.shape[-2:]:
        raise ShapeError(
            f"{op}: expected input of shape (*, H, W) with H, W of at least 1, got {tuple(input.shape)}",
            actual_shape=input.shape,
        )


def _from_side(size: int, h: int, w: int, side: str) -> tuple[int, int]:
    vertical = side == "vert" or (side == "short" and h <= w) or (side == "long" and h > w)
    # In floats, as Kornia has it: the product with the ratio is rounded down.
    return (size, max(1, int(size * (w / h)))) if vertical else (max(1, int(size / (w / h))), size)


def _blurred(x: Tensor, *factors: float) -> Tensor:
    sigmas = [max((factor - 1) / 2, 0.001) for factor in factors]
    sizes = [int(max(4 * sigma, 3)) // 2 * 2 + 1 if n > 1 else 1 for sigma, n in zip(sigmas, x.shape[2:])]
    return gaussian_blur2d(x, (sizes[0], sizes[1]), (sigmas[0], sigmas[1]))


def rescale(
    input: Tensor,
    factor: float | tuple[float, float],
    interpolation: str = "bilinear",
    align_corners: bool | None = None,
    antialias: bool | str = False,
) -> Tensor:
    """Resample images to a multiple of their size, rounded down; else as :func:`resize`.

    Args:
        input: images (*, H, W).
        factor: of both sides, or of (height, width).
        interpolation: see :func:`resize`.
        align_corners: see :func:`resize`.
        antialias: see :func:`resize`.

    Returns:
        (*, h, w), of the type of `input`.

    Raises:
        TypeError: an argument is of another kind.
        ValueError: a side would be 0, or a shape or name is not as above.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.rescale(torch.rand(1, 3, 5, 8), (0.5, 2.0)).shape
        torch.Size([1, 3, 2, 16])
    """
    return _rescale(input, factor, interpolation, align_corners, antialias)


def _rescale(input, factor, interpolation, align_corners, antialias):
    _check_images("rescale", input)
    factors = factor if isinstance(factor, (tuple, list)) else (factor, factor)
    if len(factors) != 2:
        raise TypeCheckError(f"rescale: expected factor to be a number or two, got {factor!r}")
    y, x = (_check.number("rescale", "factor", f, minimum=0) for f in factors)
    size = (int(input.shape[-2] * y), int(input.shape[-1] * x))
    if 0 in size:
        raise ValueCheckError(f"rescale: expected factor to leave a pixel of {tuple(input.shape[-2:])}, got {factor!r}")
    return _resize("rescale", input, size, interpolation, align_corners, "short", antialias)


def resize_to_be_divisible(
    input: Tensor,
    divisible_factor: int,
    interpolation: str = "bilinear",
    align_corners: bool | None = None,
    side: str = "short",
    antialias: bool | str = False,
) -> Tensor:
    """Resample images so that both sides are the nearest multiples of a number, at least one; else as :func:`resize`.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.resize_to_be_divisible(torch.rand(1, 3, 37, 50), 16).shape
        torch.Size([1, 3, 32, 48])
    """
    op = "resize_to_be_divisible"
    _check_images(op, input)
    (n,) = _check.ints(op, "divisible_factor", divisible_factor, 1)
    h, w = (max(1, round(side / n)) * n for side in input.shape[-2:])
    return _resize(op, input, (h, w), interpolation, align_corners, side, antialias)


class Resize(FunctionModule):
    """Module form of :func:`resize`.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.Resize((4, 6))(torch.rand(1, 3, 8, 8)).shape
        torch.Size([1, 3, 4, 6])
    """

    def __init__(
        self,
        size: int | tuple[int, int],
        interpolation: str = "bilinear",
        align_corners: bool | None = None,
        side: str = "short",
        antialias: bool | str = False,
    ) -> None:
        super().__init__(
            size=size, interpolation=interpolation, align_corners=align_corners, side=side, antialias=antialias
        )

    def forward(self, input: Tensor) -> Tensor:
        return resize(input, self.size, self.interpolation, self.align_corners, self.side, self.antialias)


class Rescale(FunctionModule):
    """Module form of :func:`rescale`; here `align_corners` is True unless told otherwise.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.Rescale(0.5)(torch.rand(1, 3, 8, 8)).shape
        torch.Size([1, 3, 4, 4])
    """

    def __init__(
        self,
        factor: float | tuple[float, float],
        interpolation: str = "bilinear",
        align_corners: bool = True,
        antialias: bool | str = False,
    ) -> None:
        super().__init__(factor=factor, interpolation=interpolation, align_corners=align_corners, antialias=antialias)

    def forward(self, input: Tensor) -> Tensor:
        return rescale(input, self.factor, self.interpolation, self.align_corners, self.antialias)
