"""Differentiable approximation of JPEG compression."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._constants import constant
from kvision._dtype import as_dtype, compute_dtype
from kvision._limits import JPEG_HIGH_CHROMINANCE, JPEG_LOW_CHROMINANCE, JPEG_LUMINANCE
from kvision._modules import IMAGE, FunctionModule, Sample
from kvision._ops import match_layout, register
from kvision.color import rgb_to_ycbcr, ycbcr_to_rgb
from kvision.core.border import pad
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.enhance.batch import as_batch, colors

# The example tables of ISO/IEC 10918-1, annex K, which most encoders scale by their quality.
_LUMINANCE = tuple(JPEG_LUMINANCE[8 * i : 8 * i + 8] for i in range(8))
_CHROMINANCE = (
    *((*JPEG_LOW_CHROMINANCE[4 * i : 4 * i + 4], *(JPEG_HIGH_CHROMINANCE,) * 4) for i in range(4)),
    *((JPEG_HIGH_CHROMINANCE,) * 8,) * 4,
)


def _reference(
    x: Tensor, quality: Tensor | None, table_y: Tensor | None, table_c: Tensor | None, number: float
) -> Tensor:
    """Images (B, 3, H, W) with qualities (B or 1,), or a number if these are None, and tables (B or 1, 8, 8)."""
    h, w = x.shape[2:]
    if quality is None:
        quality = torch.full((1,), number, device=x.device, dtype=x.dtype)
    ycbcr = 255 * rgb_to_ycbcr(pad(x, ((0, -h % 16), (0, -w % 16)), "replicate"))
    percent = _percent(quality)
    y = _through_blocks(ycbcr[:, :1], _steps(percent, _table(_LUMINANCE, table_y, x)))
    chroma = _through_blocks(_halved(ycbcr[:, 1:]), _steps(percent, _table(_CHROMINANCE, table_c, x)))
    chroma = F.interpolate(chroma, scale_factor=2.0, mode="bilinear", align_corners=False)
    return ycbcr_to_rgb(torch.cat([y, chroma], 1) / 255)[..., :h, :w]


def _halved(x: Tensor) -> Tensor:
    """Downsample by 2 along both axes: a Gaussian of sigma 0.5, then the mean of 2 x 2 pixels."""
    side = math.exp(-2.0)
    x = pad(x, ((1, 1), (1, 1)), "reflect")
    x = (side * (x[..., :-2, :] + x[..., 2:, :]) + x[..., 1:-1, :]) / (1 + 2 * side)
    x = (side * (x[..., :-2] + x[..., 2:]) + x[..., 1:-1]) / (1 + 2 * side)
    return F.avg_pool2d(x, 2)


def _through_blocks(x: Tensor, steps: Tensor) -> Tensor:
    """Quantize the cosine transform of every 8 x 8 block of levels (B, C, H, W) with the steps (B, 8, 8)."""
    b, c, h, w = x.shape
    dct = _dct(x)
    steps = steps[:, None, None, None]
    blocks = x.reshape(b, c, h // 8, 8, w // 8, 8).transpose(3, 4) - 128
    coefficients = _soft_round(dct @ blocks @ dct.mT / steps) * steps
    return (dct.mT @ coefficients @ dct + 128).transpose(3, 4).reshape(b, c, h, w)


def _dct(like: Tensor) -> Tensor:
    """The orthonormal cosine transform of 8 values: one row per frequency."""
    i = torch.arange(8, device=like.device, dtype=like.dtype)
    rows = torch.cos((2 * i + 1) * i[:, None] * (math.pi / 16)) / 2
    return torch.where(i[:, None] == 0, math.sqrt(1 / 8), rows)


def _table(standard: tuple[tuple[int, ...], ...], table: Tensor | None, x: Tensor) -> Tensor:
    """A table (B, 8, 8), or the standard one (1, 8, 8)."""
    if table is not None:
        return table
    return constant(standard, x)[None]


def _percent(quality: Tensor) -> Tensor:
    """How libjpeg scales the tables, (B, 1, 1): 100% at quality 50, all ones at 100, and larger steps at lower qualities."""
    q = clamp(quality, 1, 100)
    return _soft_floor(torch.where(q < 50, 5000 / q, 200 - 2 * q))[:, None, None]


def _steps(percent: Tensor, table: Tensor) -> Tensor:
    return _soft_floor(_soft_clip((table * percent + 50) / 100, 1, 255))


def _soft_round(x: Tensor) -> Tensor:
    whole = x.round().detach()
    return whole + (x - whole) ** 3


def _soft_floor(x: Tensor) -> Tensor:
    whole = x.floor().detach()
    return whole + (x - whole - 0.5) ** 3


def _soft_clip(x: Tensor, low: float, high: float) -> Tensor:
    """Clip softly: values outside end at most 0.02 out of bounds and keep a nonzero gradient."""
    inside = clamp(x, low, high)
    return inside + 0.02 * (torch.sign(x - inside) * (1 - torch.exp(-(x - inside).abs())))


def _reference_backward(
    grad: Tensor,
    x: Tensor,
    quality: Tensor | None,
    table_y: Tensor | None,
    table_c: Tensor | None,
    number: float,
    of_image: bool,
    of_steps: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    b, dtype = x.shape[0], compute_dtype(x)
    if quality is None:
        quality = torch.full((1,), number, device=x.device, dtype=dtype)
    tables = (_table(_LUMINANCE, table_y, x), _table(_CHROMINANCE, table_c, x))
    each = (quality.expand(b), *(t.expand(b, 8, 8) for t in tables))
    none = x[:, :0, 0, 0]

    def f(x: Tensor, quality: Tensor, table_y: Tensor, table_c: Tensor) -> Tensor:
        return _reference(x, quality, table_y, table_c, number)

    if not of_steps:
        (of_x,) = torch.func.vjp(lambda x: f(x, *each), x)[1](grad)
        of_tables = (none.to(dtype)[..., None].expand(b, 0, 8).clone() for _ in tables)
        return of_x, none.to(dtype), *of_tables
    if of_image:
        of_x, of_quality, *of_tables = torch.func.vjp(f, x, *each)[1](grad)
    else:
        of_x, (of_quality, *of_tables) = none, torch.func.vjp(lambda *each: f(x, *each), *each)[1](grad)
    return of_x, of_quality[:, None], *of_tables


def _fake_backward(grad, x, quality, table_y, table_c, number, of_image, of_steps):
    b, n = x.shape[0], int(of_steps)
    of_x = match_layout(torch.empty_like(x), x) if of_image else x.new_empty((b, 0))
    return [of_x, *(x.new_empty((b, *inner), dtype=compute_dtype(x)) for inner in ((n,), (8 * n, 8), (8 * n, 8)))]


def _backward(needs, grad, x, quality, table_y, table_c, number):
    of_steps = any(needs[1:4])
    of_x, of_quality, *of_tables = _jpeg_backward(grad, x, quality, table_y, table_c, number, needs[0], of_steps)
    of_each, options = (of_quality.flatten(), *of_tables), (quality, table_y, table_c)
    return [
        of_x if needs[0] else None,
        *(e.sum_to_size(t.shape) if need else None for need, e, t in zip(needs[1:4], of_each, options)),
    ]


_jpeg = register("jpeg", _reference, backward=_backward, clamps=True)
_jpeg_backward = register("jpeg_backward", _reference_backward, fake=_fake_backward)


def jpeg_codec_differentiable(
    input: Tensor,
    jpeg_quality: float | Tensor,
    quantization_table_y: Tensor | None = None,
    quantization_table_c: Tensor | None = None,
) -> Tensor:
    """Approximate JPEG compression: 4:2:0 chroma subsampling, and quantized cosine coefficients of 8 x 8 blocks.

    Rounding is x -> round(x) + (x - round(x)) ** 3, and its like for the table, so that there is a gradient. The sides
    are continued to multiples of 16 by their last pixels.

    Args:
        input: (*, 3, H, W), floating point, RGB in [0, 1], or uint8, which gives uint8 (rounded half to even).
        jpeg_quality: 0 (coarsest) to 100, one for all images or one each: a number, or a tensor (1,) or (B,), B being
            the product of the axes in front. Below 1 counts as 1, as libjpeg has it.
        quantization_table_y: table for luminance at quality 50, (8, 8) or (B, 8, 8); by default that of the standard.
        quantization_table_c: table for chrominance.

    Returns:
        The decoded images, clamped to [0, 1]; differentiable in all four.

    Raises:
        TypeCheckError: input is not a tensor of floats or uint8; another argument is no real tensor or number.
        ImageError: input is not (*, 3, H, W).
        ShapeError: no pixels; a quality or table that does not fit.
        ValueCheckError: a number outside 0 to 100. Tensors are not checked by value; they are clamped.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Source: ISO/IEC 10918-1 (1994); C. Reich et al., "Differentiable JPEG: the devil is in the details" (2024).

    Example:
        >>> import torch, kvision as K
        >>> x = torch.full((1, 3, 16, 16), 0.5)
        >>> y = K.enhance.jpeg_codec_differentiable(x, torch.tensor([90.0]))
        >>> bool((x - y).abs().amax() < 0.01)
        True
    """
    op = "jpeg_codec_differentiable"
    colors(op, "input", input)
    if 0 in input.shape[-2:]:
        raise ShapeError(f"{op}: expected input with H, W of at least 1, got {tuple(input.shape)}")
    x = as_batch(input)
    number, options = 0.0, {}
    if isinstance(jpeg_quality, Tensor):
        _check.numbers(op, "jpeg_quality", jpeg_quality)
        options["jpeg_quality"] = jpeg_quality
    else:
        number = _check.number(op, "jpeg_quality", jpeg_quality, minimum=0)
        if number > 100:
            raise ValueCheckError(f"{op}: expected jpeg_quality in [0, 100], got {jpeg_quality!r}")
    for name, table in (("quantization_table_y", quantization_table_y), ("quantization_table_c", quantization_table_c)):
        if table is not None:
            _check.numbers(op, name, table)
            options[name] = table[None] if table.dim() == 2 else table
    for name, tensor in options.items():
        tensor = _check.to_device_of(op, x, name, tensor)
        inner = () if name == "jpeg_quality" else (8, 8)
        if tensor.dim() == 0 or not _check.is_one_or(tensor.shape[0], x.shape[0]) or tensor.shape[1:] != inner:
            want = ", ".join(map(str, ("B", *inner)))
            raise ShapeError(
                f"{op}: expected {name} of shape ({want},) for B = {x.shape[0]}, got {tuple(tensor.shape)}"
            )
        options[name] = as_dtype(tensor, compute_dtype(x))
    y = _jpeg(
        x, *(options.get(name) for name in ("jpeg_quality", "quantization_table_y", "quantization_table_c")), number
    )
    return y.reshape(input.shape)


class JPEGCodecDifferentiable(FunctionModule):
    """Module form of :func:`jpeg_codec_differentiable`; a table that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.JPEGCodecDifferentiable()(torch.rand(2, 3, 20, 30), torch.tensor([10.0, 90.0])).shape
        torch.Size([2, 3, 20, 30])
    """

    samples = IMAGE, Sample()

    def __init__(self, quantization_table_y: Tensor | None = None, quantization_table_c: Tensor | None = None) -> None:
        super().__init__(quantization_table_y=quantization_table_y, quantization_table_c=quantization_table_c)

    def forward(self, image_rgb: Tensor, jpeg_quality: float | Tensor) -> Tensor:
        return jpeg_codec_differentiable(image_rgb, jpeg_quality, self.quantization_table_y, self.quantization_table_c)
