"""Functions of pixels' values, by the arguments of torchvision.transforms.v2.functional.

v2 truncates integers after each function, steps of color programs round: bytes are shifted by half a level first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from kvision._leading import apply_on_batch
from kvision.color import grayscale_to_rgb as repeated
from kvision.color.gray import luma_u8, weighted_sum
from kvision.color.matrix import affine_numbers
from kvision.color.program import arguments, run
from kvision.color.scale_shift import scale_shift
from kvision.color.steps import STEPS
from kvision.core.exceptions import TypeCheckError
from kvision.enhance import equalize as equalized
from kvision.enhance import sharpness
from kvision.enhance import solarize as solarized
from kvision.enhance.batch import as_batch, shaped
from kvision.enhance.normalize import standardize_rgb
from kvision.filters import gaussian_blur2d
from kvision.tv.functional.dispatch import functional, on_device
from kvision.tv.functional.values import HALF_A_LEVEL_DOWN, largest, of_all_types, tensors_only, to_dtype, truncated
from kvision.tv.inputs import one_or_two

LUMA = (0.2989, 0.587, 0.114)  # torchvision's weights


def _program(x: Tensor, *steps: tuple[str, Sequence[Any]]) -> Tensor:
    numbers = [STEPS[name].number for name, _ in steps]
    return shaped(run(as_batch(x), numbers, arguments([p for _, values in steps for p in values])), x)


def _each(kernel: Callable[..., Tensor], name: str, low: float = 0.0, high: float = math.inf) -> Callable[..., Tensor]:
    """`kernel` of images (B, C, H, W) with a factor of each, (B, 1, 1)."""

    def each(x: Tensor, rows: list[dict[str, Any]]) -> Tensor:
        factors = [float(row[name]) for row in rows]
        for factor in factors:
            _check_factor(name, factor, low, high)
        return kernel(x, on_device(factors, x.device)[:, None, None])

    return each


def _of_colors(kernel: Callable[..., Tensor]) -> Callable[..., Tensor]:
    return lambda x, factor: kernel(x, factor) if x.shape[-3] == 3 else x


def _check_factor(op: str, factor: float, low: float = 0.0, high: float = math.inf) -> None:
    if not low <= factor <= high:
        raise ValueError(f"{op}: expected a factor of {low} to {high}, got {factor}")


def _is_rgb(op: str, x: Tensor) -> bool:
    """Whether there are three channels; one is gray."""
    if x.dim() < 3 or x.shape[-3] not in (1, 3):
        raise TypeCheckError(f"{op}: expected an image (*, 1 or 3, H, W), got {tuple(x.shape)}")
    return x.shape[-3] == 3


def _gray(x: Tensor) -> Tensor:
    """v2's gray of images (B, 3, H, W) before it is stored; of integers the whole levels."""
    r, g, b = x.unbind(-3)
    gray = r.mul(LUMA[0]).add_(g, alpha=LUMA[1]).add_(b, alpha=LUMA[2])[..., None, :, :]
    return gray if x.is_floating_point() else gray.floor_()


def _grayscale_pil(image: Any, num_output_channels: int = 1) -> Any:
    colors = {"1": "L", "LA": "L", "RGBA": "RGB", "P": "RGB"}.get(image.mode)
    return NotImplemented if colors is None else rgb_to_grayscale(image.convert(colors), num_output_channels)


@functional(pil=_grayscale_pil)
def rgb_to_grayscale(inpt: Tensor, num_output_channels: int = 1) -> Tensor:
    """Make gray of RGB images (*, 3, H, W), as .2989 R + .587 G + .114 B.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        num_output_channels: 1, or 3 for three equal ones.

    Returns:
        (*, num_output_channels, H, W) of the same type.

    Raises:
        TypeCheckError, ValueError: not 1 or 3 channels, in `inpt` or asked for.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.rgb_to_grayscale(torch.tensor([1.0, 0.5, 0.0]).reshape(3, 1, 1))
        tensor([[[0.5924]]])
    """
    if num_output_channels not in (1, 3):
        raise ValueError(f"rgb_to_grayscale: expected num_output_channels of 1 or 3, got {num_output_channels}")
    if not _is_rgb("rgb_to_grayscale", inpt):
        return inpt.clone() if num_output_channels == 1 else repeated(inpt)
    if inpt.is_floating_point() or inpt.dtype == torch.uint8:
        gray = apply_on_batch(luma_u8 if inpt.dtype == torch.uint8 else weighted_sum, inpt, *LUMA)
    else:
        gray = _gray(inpt).to(inpt.dtype)
    return gray if num_output_channels == 1 else gray.expand(inpt.shape)


@functional(pil=lambda image: image.convert("RGB"))
def grayscale_to_rgb(inpt: Tensor) -> Tensor:
    """Repeat the channel of gray images (*, 1, H, W) three times.

    Args:
        inpt: a tensor, tv_tensor or PIL image.

    Returns:
        (*, 3, H, W); images of three channels as they are.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.grayscale_to_rgb(torch.ones(1, 4, 5)).shape
        torch.Size([3, 4, 5])
    """
    return inpt if inpt.shape[-3] >= 3 else repeated(inpt)


@of_all_types
def _scaled(x: Tensor, factor: float) -> Tensor:
    return shaped(scale_shift(as_batch(x), factor, truncated(x), True), x)


@functional(
    keeps_alpha=True,
    each=_each(_scaled, "brightness_factor"),
    steps=lambda brightness_factor: [("scale_shift", brightness_factor, HALF_A_LEVEL_DOWN, 1.0)],
)
def adjust_brightness(inpt: Tensor, brightness_factor: float) -> Tensor:
    """Multiply an image by a factor, clamped to black and white.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        brightness_factor: 0 gives black, 1 the image.

    Returns:
        What is given, of the same type and size.

    Raises:
        ValueError: the factor is below 0.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.adjust_brightness(torch.full((3, 1, 1), 0.75), 0.5).flatten()
        tensor([0.3750, 0.3750, 0.3750])
    """
    _check_factor("adjust_brightness", brightness_factor)
    return _scaled(inpt, brightness_factor)


def _around_whole_levels(factor: Any) -> tuple[str, float, Any, float]:
    """The step behind a change of the distance from v2's gray of bytes, which has whole levels, on average half a level less."""
    return "scale_shift", 1.0, HALF_A_LEVEL_DOWN - (1 - factor) * 0.5 / 255, 1.0


@of_all_types
def _saturated(x: Tensor, factor: float) -> Tensor:
    rows = [tuple((1 - factor) * w + factor * (i == j) for j, w in enumerate(LUMA)) for i in range(3)]
    shift = _around_whole_levels(factor)[2] if x.dtype == torch.uint8 else 0.0
    numbers = affine_numbers((rows[0], rows[1], rows[2]), (shift, shift, shift), True)  # type: ignore[arg-type]
    return _program(x, ("affine", numbers))


def _blended(x: Tensor, factor: Tensor) -> Tensor:
    """`_saturated` with a factor of each: v2's arithmetic, as no step of a program has matrices of each image."""
    factor = factor[..., None].to(torch.promote_types(x.dtype, torch.float32))
    return (x * factor + _gray(x) * (1 - factor)).clamp_(0, largest(x.dtype)).to(x.dtype)


@functional(
    keeps_alpha=True,
    each=_each(_of_colors(_blended), "saturation_factor"),
    steps=lambda saturation_factor: [("saturation_gray", saturation_factor), _around_whole_levels(saturation_factor)],
)
def adjust_saturation(inpt: Tensor, saturation_factor: float) -> Tensor:
    """Interpolate between an image and its gray, or extrapolate.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        saturation_factor: 0 gives gray, 1 the image.

    Returns:
        What is given, of the same type and size.

    Raises:
        TypeCheckError, ValueError: not 1 or 3 channels; the factor is below 0.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.adjust_saturation(torch.tensor([1.0, 0.5, 0.0]).reshape(3, 1, 1), 0.0).flatten()
        tensor([0.5924, 0.5924, 0.5924])
    """
    _check_factor("adjust_saturation", saturation_factor)
    return _saturated(inpt, saturation_factor) if _is_rgb("adjust_saturation", inpt) else inpt


@of_all_types
def _around_mean(x: Tensor, factor: float) -> Tensor:
    batch = as_batch(x)
    gray = _gray(batch) if batch.shape[1] == 3 else batch.to(torch.float32) if x.dtype == torch.uint8 else batch
    mean = gray.mean((1, 2, 3)).reshape(-1, 1, 1)
    return shaped(scale_shift(batch, factor, mean * ((1 - factor) / largest(x.dtype)) + truncated(x), True), x)


@functional(
    keeps_alpha=True,
    each=_each(_around_mean, "contrast_factor"),
    steps=lambda contrast_factor: [("contrast", contrast_factor, 0.0), _around_whole_levels(contrast_factor)],
)
def adjust_contrast(inpt: Tensor, contrast_factor: float) -> Tensor:
    """Interpolate between an image and the mean of its gray, or extrapolate.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        contrast_factor: 0 gives the mean, 1 the image.

    Returns:
        What is given, of the same type and size.

    Raises:
        TypeCheckError, ValueError: not 1 or 3 channels; the factor is below 0.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.adjust_contrast(torch.tensor([[[0.25, 0.75]]]), 0.5)
        tensor([[[0.3750, 0.6250]]])
    """
    _check_factor("adjust_contrast", contrast_factor)
    _is_rgb("adjust_contrast", inpt)
    return _around_mean(inpt, contrast_factor)


# v2 converts the unit interval to bytes by a factor just below 256.
_TO_LEVELS = ((255 + 1 - 1e-3) / 255, HALF_A_LEVEL_DOWN, True)


@of_all_types
def _rotated_hue(x: Tensor, turns: float) -> Tensor:
    steps: list[tuple[str, Sequence[Any]]] = [("hue", (2 * math.pi * turns,))]
    return _program(x, *steps, *([("scale_shift", _TO_LEVELS)] if x.dtype == torch.uint8 else []))


@functional(
    keeps_alpha=True,
    each=_each(_of_colors(_rotated_hue), "hue_factor", -0.5, 0.5),
    steps=lambda hue_factor: [("hue", 2 * math.pi * hue_factor), ("scale_shift", *_TO_LEVELS)],
)
def adjust_hue(inpt: Tensor, hue_factor: float) -> Tensor:
    """Rotate the hue of an RGB image; gray images stay.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        hue_factor: in turns, -.5 to .5.

    Returns:
        What is given, of the same type and size.

    Raises:
        TypeCheckError, ValueError: not 1 or 3 channels; the turn is not within -.5 and .5.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.adjust_hue(torch.tensor([1.0, 0.0, 0.0]).reshape(3, 1, 1), 1 / 3).flatten()
        tensor([0., 1., 0.])
    """
    _check_factor("adjust_hue", hue_factor, -0.5, 0.5)
    return _rotated_hue(inpt, hue_factor) if _is_rgb("adjust_hue", inpt) and inpt.numel() else inpt


@of_all_types
def _power(x: Tensor, gamma: float, gain: float) -> Tensor:
    return _program(x, ("gamma", (gamma, gain)), *([("scale_shift", _TO_LEVELS)] if x.dtype == torch.uint8 else []))


@functional(keeps_alpha=True)
def adjust_gamma(inpt: Tensor, gamma: float, gain: float = 1) -> Tensor:
    """Raise an image, as a fraction of white, to a power.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        gamma: the exponent, at least 0.
        gain: a factor of the result.

    Returns:
        What is given, of the same type and size.

    Raises:
        ValueError: gamma is below 0.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.adjust_gamma(torch.tensor([[[0.25, 0.5]]]), 2.0)
        tensor([[[0.0625, 0.2500]]])
    """
    _check_factor("adjust_gamma", gamma)
    return _power(inpt, gamma, gain)


_sharpened = of_all_types(sharpness)


@functional(keeps_alpha=True, each=_each(lambda x, factor: _sharpened(x, factor[:, 0, 0]), "sharpness_factor"))
def adjust_sharpness(inpt: Tensor, sharpness_factor: float) -> Tensor:
    """Interpolate between an image and its smoothed copy, or extrapolate; the border stays.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        sharpness_factor: 0 gives the smoothed image, 1 the image, more sharpens.

    Returns:
        What is given, of the same type and size.

    Raises:
        TypeCheckError, ValueError: not 1 or 3 channels; the factor is below 0.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.adjust_sharpness(torch.ones(3, 8, 6), 2.0).shape
        torch.Size([3, 8, 6])
    """
    _check_factor("adjust_sharpness", sharpness_factor)
    _is_rgb("adjust_sharpness", inpt)
    return inpt if min(inpt.shape[-2:]) <= 2 else _sharpened(inpt, sharpness_factor)


@functional(keeps_alpha=True, steps=lambda bits: [("posterize", bits, 1.0)])
def posterize(inpt: Tensor, bits: int) -> Tensor:
    """Keep the high bits of values, of floats those of 2^bits levels.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        bits: how many, 0 to 8.

    Returns:
        What is given, of the same type and size.

    Raises:
        TypeCheckError: `bits` is no int of 0 to 8.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.posterize(torch.tensor([[[100, 200]]], dtype=torch.uint8), 1)
        tensor([[[  0, 128]]], dtype=torch.uint8)
    """
    if not isinstance(bits, int) or not 0 <= bits <= 8:
        raise TypeCheckError(f"posterize: expected bits to be an int of 0 to 8, got {bits!r}")
    if inpt.is_floating_point():
        levels = 1 << bits
        return inpt.mul(levels).floor_().clamp_(0, levels - 1).mul_(1 / levels)
    lost = torch.iinfo(inpt.dtype).max.bit_length() - bits
    return inpt if lost <= 0 else inpt & (((1 << bits) - 1) << lost)


def _check_threshold(threshold: float, white: float) -> None:
    if threshold > white:
        raise TypeCheckError(f"solarize: expected a threshold of at most {white}, got {threshold}")


def _solarize_steps(threshold: Any) -> list[Any]:
    _check_threshold(threshold.max(), 255.0)
    return [("solarize", (np.ceil(threshold) - 0.5) / 255, 0.0, 0.0)]


@functional(keeps_alpha=True, steps=_solarize_steps)
def solarize(inpt: Tensor, threshold: float) -> Tensor:
    """Invert the values of at least a threshold.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        threshold: in the units of the image, up to white.

    Returns:
        What is given, of the same type and size.

    Raises:
        TypeCheckError: the threshold is above white.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.solarize(torch.tensor([[[0.25, 0.75]]]), 0.5)
        tensor([[[0.2500, 0.2500]]])
    """
    _check_threshold(threshold, largest(inpt.dtype))
    if inpt.dtype == torch.uint8:
        return solarized(inpt, (math.ceil(threshold) - 0.5) / 255)  # between two levels
    return solarized(inpt, threshold) if inpt.is_floating_point() else torch.where(inpt < threshold, inpt, invert(inpt))


@of_all_types
def _stretched(x: Tensor) -> Tensor:
    batch = as_batch(x)
    low, high = (
        extreme((2, 3))[..., None].to(torch.float32) / largest(x.dtype) for extreme in (batch.amin, batch.amax)
    )
    flat = low == high
    factor = torch.where(flat, 1.0, 1 / (high - low))
    return shaped(scale_shift(batch, factor, torch.where(flat, 0.0, -low * factor) + truncated(x), True), x)


@functional(keeps_alpha=True)
def autocontrast(inpt: Tensor) -> Tensor:
    """Stretch each channel of each image to black and white; constant ones stay.

    Args:
        inpt: a tensor, tv_tensor or PIL image.

    Returns:
        What is given, of the same type and size.

    Raises:
        TypeCheckError: not 1 or 3 channels.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.autocontrast(torch.tensor([[[0.25, 0.5]]]))
        tensor([[[0., 1.]]])
    """
    _is_rgb("autocontrast", inpt)
    return _stretched(inpt) if inpt.numel() else inpt


@functional(keeps_alpha=True)
def equalize(inpt: Tensor) -> Tensor:
    """Equalize the histogram of each channel of each image, of floats that of 256 levels.

    Args:
        inpt: a tensor, tv_tensor or PIL image.

    Returns:
        What is given, of the same type and size.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.equalize(torch.tensor([[[3, 3, 7, 9]]], dtype=torch.uint8))
        tensor([[[3, 3, 7, 9]]], dtype=torch.uint8)
    """
    if inpt.numel() == 0:
        return inpt
    levels = to_dtype(inpt, torch.uint8, scale=True)
    return to_dtype(equalized(levels), inpt.dtype, scale=True)


@functional(keeps_alpha=True, steps=lambda: [("scale_shift", -1.0, 1.0, 0.0)])
def invert(inpt: Tensor) -> Tensor:
    """Subtract an image from white.

    Args:
        inpt: a tensor, tv_tensor or PIL image.

    Returns:
        What is given, of the same type and size.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.invert(torch.tensor([[[0.25]]]))
        tensor([[[0.7500]]])
    """
    if inpt.is_floating_point():
        return 1.0 - inpt
    return ~inpt if inpt.dtype in (torch.uint8, torch.bool) else inpt ^ torch.iinfo(inpt.dtype).max


def _permute_each(x: Tensor, rows: list[dict[str, Any]]) -> Tensor:
    channels = on_device([list(row["permutation"]) for row in rows], x.device)
    return x[torch.arange(x.shape[0], device=x.device)[:, None], channels]


@functional(each=_permute_each)
def permute_channels(inpt: Tensor, permutation: Sequence[int] | Tensor) -> Tensor:
    """Put the channels of an image (*, C, H, W) in another order.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        permutation: the source of each channel.

    Returns:
        What is given, of the same type and size.

    Raises:
        ValueError: not an entry of each channel.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.permute_channels(torch.arange(3.0).reshape(3, 1, 1), [2, 0, 1]).flatten()
        tensor([2., 0., 1.])
    """
    if len(permutation) != inpt.shape[-3]:
        raise ValueError(
            f"permute_channels: expected a permutation of {inpt.shape[-3]} channels, got {len(permutation)}"
        )
    return inpt.index_select(-3, torch.as_tensor(permutation, device=inpt.device))


@functional(pil=tensors_only("normalize"))
def normalize(inpt: Tensor, mean: Sequence[float], std: Sequence[float], inplace: bool = False) -> Tensor:
    """Subtract means from the channels of a floating-point image (*, C, H, W) and divide by standard deviations.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        mean: one of each channel.
        std: one of each channel.
        inplace: write into the image.

    Returns:
        What is given, of the same type and size.

    Raises:
        TypeCheckError, ValueError: no tensor of floating point (*, C, H, W); a deviation of 0.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.normalize(torch.ones(1, 1, 1), [0.5], [0.25])
        tensor([[[2.]]])
    """
    if not inpt.is_floating_point():
        raise TypeCheckError(
            f"normalize: expected floating point, got {inpt.dtype}; put ToDtype(torch.float32, scale=True) before"
        )
    if inpt.dim() < 3:
        raise ValueError(f"normalize: expected an image (*, C, H, W), got {tuple(inpt.shape)}")
    if not all(std):
        raise ValueError(f"normalize: expected std other than 0, got {std}")
    if inpt.shape[-3] == len(mean) == len(std) == 3 and not inplace:
        return shaped(standardize_rgb(as_batch(inpt), *map(float, mean), *map(float, std)), inpt)
    center, scale = (
        torch.tensor(numbers, dtype=inpt.dtype, device=inpt.device)[:, None, None] for numbers in (mean, std)
    )
    return (inpt.sub_(center) if inplace else inpt.sub(center)).div_(scale)


def _blur_each(x: Tensor, rows: list[dict[str, Any]]) -> Any:
    if len({tuple(row["kernel_size"]) for row in rows}) > 1 or not (x.is_floating_point() or x.dtype == torch.uint8):
        return NotImplemented
    sigmas = on_device([list(row["sigma"])[::-1] for row in rows], x.device)
    kx, ky = rows[0]["kernel_size"]
    return gaussian_blur2d(x, (ky, kx), sigmas)


@functional(each=_blur_each)
def gaussian_blur(
    inpt: Tensor, kernel_size: int | Sequence[int], sigma: float | Sequence[float] | None = None
) -> Tensor:
    """Smooth an image with a Gaussian, reflected at the border.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        kernel_size: width and height of the window, odd, an int for both.
        sigma: standard deviations along x and y in pixels, a number for both; default: .15 kernel_size + .35.

    Returns:
        What is given, of the same type and size.

    Raises:
        ValueError: a size is not odd, a deviation not above 0.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.gaussian_blur(torch.ones(3, 8, 6), 3).shape
        torch.Size([3, 8, 6])
    """
    kx, ky = one_or_two("gaussian_blur", "kernel_size", kernel_size)
    if kx % 2 == 0 or ky % 2 == 0 or min(kx, ky) < 1:
        raise ValueError(f"gaussian_blur: expected odd kernel_size, got {kernel_size}")
    sx, sy = (0.15 * kx + 0.35, 0.15 * ky + 0.35) if sigma is None else one_or_two("gaussian_blur", "sigma", sigma)
    if min(sx, sy) <= 0:
        raise ValueError(f"gaussian_blur: expected sigma above 0, got {sigma}")
    if inpt.numel() == 0:
        return inpt
    x = inpt if inpt.is_floating_point() or inpt.dtype == torch.uint8 else inpt.float()
    output = shaped(gaussian_blur2d(as_batch(x), (ky, kx), (sy, sx)), inpt)
    return output if output.dtype == inpt.dtype else output.round_().to(inpt.dtype)


to_grayscale = rgb_to_grayscale
