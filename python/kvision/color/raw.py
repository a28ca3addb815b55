"""Bayer mosaics, the raw images of sensors: one color a pixel, in a pattern of 2 x 2 pixels."""

from __future__ import annotations

from enum import Enum
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import pixels
from kvision._leading import apply_on_batch
from kvision._limits import RED_POSITIONS
from kvision._modules import PLANE, FunctionModule
from kvision._ops import register, with_kernel_casts
from kvision.core.border import pad
from kvision.core.exceptions import ShapeError, TypeCheckError


class CFA(Enum):
    """Color filter array: how a sensor's colors repeat, named as in OpenCV by the second row's second and third pixel.

        BG: R G R G    GB: G R G R    RG: B G B G    GR: G B G B
            G B G B        B G B G        G R G R        R G R G

    Example:
        >>> import kvision as K
        >>> [cfa.name for cfa in K.color.CFA]
        ['BG', 'GB', 'RG', 'GR']
    """

    BG = 0
    GB = 1
    RG = 2
    GR = 3


# (row, column) of red in a cell; blue is diagonal to it, green at the two other pixels.
_RED = dict(zip(CFA, RED_POSITIONS))


def _sites(x: Tensor, row: int, column: int) -> Tensor:
    """Where `x` (..., H, W) has the pixel of this row and column in every cell."""
    h, w = x.shape[-2:]
    rows, columns = torch.arange(h, device=x.device) % 2, torch.arange(w, device=x.device) % 2
    return (rows == row)[:, None] & (columns == column)


def _mosaic(x: Tensor, row: int, column: int) -> Tensor:
    mosaic = x[:, 1:2].clone(memory_format=torch.contiguous_format)
    mosaic[..., row::2, column::2] = x[:, :1, row::2, column::2]
    mosaic[..., 1 - row :: 2, 1 - column :: 2] = x[:, 2:, 1 - row :: 2, 1 - column :: 2]
    return mosaic


def _reference(x: Tensor, cfa: int) -> Tensor:
    row, column = _RED[CFA(cfa)]
    red, blue = _sites(x, row, column), _sites(x, 1 - row, 1 - column)
    # A reflected border of the mosaic repeats the outermost row and column of each color.
    r, b = (pad(torch.where(own, x, 0), ((1, 1), (1, 1)), "reflect") for own in (red, blue))
    g = pad(torch.where(red | blue, 0, x), ((1, 1), (1, 1)), "reflect")
    green = g[..., 1:-1, 1:-1] + (g[..., :-2, 1:-1] + g[..., 2:, 1:-1] + g[..., 1:-1, :-2] + g[..., 1:-1, 2:]) / 4
    return torch.cat([_between(r), green, _between(b)], 1)


def _between(p: Tensor) -> Tensor:
    """Interpolate linearly between every second row and column of the padded plane `p`, which is 0 elsewhere."""
    p = p[..., 1:-1, :] + (p[..., :-2, :] + p[..., 2:, :]) / 2
    return p[..., 1:-1] + (p[..., :-2] + p[..., 2:]) / 2


def _binned(x: Tensor, row: int, column: int) -> Tensor:
    def site(i: int, j: int) -> Tensor:
        return x[..., i::2, j::2]

    green = (site(row, 1 - column) + site(1 - row, column)) / 2
    return torch.cat([site(row, column), green, site(1 - row, 1 - column)], 1)


def _transposed(grad: Tensor, cfa: int) -> Tensor:
    vjp_fn = torch.func.vjp(lambda x: _reference(x, cfa), torch.zeros_like(grad[:, :1]))[1]
    return vjp_fn(grad)[0]


_raw_to_rgb = register(
    "raw_to_rgb",
    _reference,
    fake=lambda x, cfa: (x.shape[0], 3, *x.shape[2:]),
    gradients="input: raw_to_rgb_backward",
    linear=True,
    bytes=True,
)
register(
    "raw_to_rgb_backward",
    _transposed,
    fake=lambda grad, cfa: (grad.shape[0], 1, *grad.shape[2:]),
    gradients="grad: raw_to_rgb(input=grad_grad)",
    linear=True,
)
_raw_to_rgb_2x2_downscaled = with_kernel_casts(_binned)


def rgb_to_raw(image: Tensor, cfa: CFA) -> Tensor:
    """Make Bayer mosaics of RGB images: keep the one color of every pixel that passes the sensor's filter.

    Args:
        image: RGB images (*, 3, H, W) of any type.
        cfa: the filter.

    Returns:
        Mosaics (*, 1, H, W) of the same type.

    Raises:
        TypeCheckError: image is not a tensor, cfa is not a CFA.
        ShapeError: image is not (*, 3, H, W).

    Example:
        >>> import torch, kvision as K
        >>> red = torch.tensor([1.0, 0.0, 0.0]).view(3, 1, 1).expand(3, 2, 4)
        >>> K.color.rgb_to_raw(red, K.color.CFA.BG)
        tensor([[[1., 0., 1., 0.],
                 [0., 0., 0., 0.]]])
    """
    _check.channels("rgb_to_raw", "image", image, 3)
    _check_cfa("rgb_to_raw", cfa)
    return apply_on_batch(_mosaic, image, *_RED[cfa])


def raw_to_rgb(image: Tensor, cfa: CFA) -> Tensor:
    """Demosaic images of a Bayer sensor: interpolate the two missing colors of every pixel bilinearly.

    Red and blue are means of 2 or 4 neighbors, green of 4. The border mirrors the mosaic. What was measured is kept.

    Args:
        image: mosaics (*, 1, H, W), H and W even. uint8 gives uint8 (rounded half to even), other integers float32.
        cfa: the filter.

    Returns:
        RGB images (*, 3, H, W).

    Raises:
        TypeCheckError: image is not a tensor, cfa is not a CFA.
        ShapeError: image is not (*, 1, H, W), or H or W is odd.

    Example:
        >>> import torch, kvision as K
        >>> mosaic = torch.tensor([[[1.0, 0.2, 0.0, 0.2], [0.2, 0.4, 0.2, 0.4]]])
        >>> K.color.raw_to_rgb(mosaic, K.color.CFA.BG)[:, 0]
        tensor([[1.0000, 0.5000, 0.0000, 0.0000],
                [0.2000, 0.2000, 0.2000, 0.2000],
                [0.4000, 0.4000, 0.4000, 0.4000]])
    """
    _check_mosaic("raw_to_rgb", image)
    _check_cfa("raw_to_rgb", cfa)
    if 0 in image.shape[-2:]:
        return pixels(image).expand(*image.shape[:-3], 3, *image.shape[-2:])
    return apply_on_batch(_raw_to_rgb, pixels(image), cfa.value)


def raw_to_rgb_2x2_downscaled(image: Tensor, cfa: CFA) -> Tensor:
    """Demosaic images of a Bayer sensor to half their size: each 2 x 2 pixels give one color, with the mean of their greens.

    Args:
        image: mosaics (*, 1, H, W), H and W even. uint8 gives uint8 (rounded half to even), other integers float32.
        cfa: the filter.

    Returns:
        RGB images (*, 3, H / 2, W / 2).

    Raises:
        TypeCheckError: image is not a tensor, cfa is not a CFA.
        ShapeError: image is not (*, 1, H, W), or H or W is odd.

    Example:
        >>> import torch, kvision as K
        >>> K.color.raw_to_rgb_2x2_downscaled(torch.tensor([[[1.0, 0.2], [0.4, 0.8]]]), K.color.CFA.BG).flatten()
        tensor([1.0000, 0.3000, 0.8000])
    """
    _check_mosaic("raw_to_rgb_2x2_downscaled", image)
    _check_cfa("raw_to_rgb_2x2_downscaled", cfa)
    return apply_on_batch(_raw_to_rgb_2x2_downscaled, pixels(image), *_RED[cfa])


def _check_mosaic(op: str, image: Any) -> None:
    _check.channels(op, "image", image, 1)
    h, w = image.shape[-2:]
    if h % 2 or w % 2:
        raise ShapeError(f"{op}: expected image with even H and W, got {tuple(image.shape)}")


def _check_cfa(op: str, cfa: Any) -> None:
    if not isinstance(cfa, CFA):
        raise TypeCheckError(f"{op}: expected cfa to be a CFA, got {cfa!r}", actual_type=type(cfa))


class RgbToRaw(FunctionModule):
    """Module form of :func:`rgb_to_raw`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToRaw(K.color.CFA.RG)(torch.rand(2, 3, 4, 6)).shape
        torch.Size([2, 1, 4, 6])
    """

    def __init__(self, cfa: CFA) -> None:
        super().__init__(cfa=cfa)

    def forward(self, image: Tensor) -> Tensor:
        return rgb_to_raw(image, self.cfa)


class RawToRgb(FunctionModule):
    """Module form of :func:`raw_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RawToRgb(K.color.CFA.RG)(torch.rand(2, 1, 4, 6)).shape
        torch.Size([2, 3, 4, 6])
    """

    samples = (PLANE,)

    def __init__(self, cfa: CFA) -> None:
        super().__init__(cfa=cfa)

    def forward(self, image: Tensor) -> Tensor:
        return raw_to_rgb(image, self.cfa)


class RawToRgb2x2Downscaled(FunctionModule):
    """Module form of :func:`raw_to_rgb_2x2_downscaled`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RawToRgb2x2Downscaled(K.color.CFA.RG)(torch.rand(2, 1, 4, 6)).shape
        torch.Size([2, 3, 2, 3])
    """

    samples = (PLANE,)

    def __init__(self, cfa: CFA) -> None:
        super().__init__(cfa=cfa)

    def forward(self, image: Tensor) -> Tensor:
        return raw_to_rgb_2x2_downscaled(image, self.cfa)
