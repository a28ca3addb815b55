"""v2's classes of colors, noise and erased parts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch

from kvision import _check
from kvision._constants import constant
from kvision.tv import argument, draw
from kvision.tv import functional as F
from kvision.tv.geometry import drawn_window
from kvision.tv.transform import Call, Chance, RandomTransform, Transform, channels_in, size_of

__all__ = [
    "JPEG", "RGB", "ColorJitter", "GaussianBlur", "GaussianNoise", "Grayscale", "RandomAdjustSharpness",
    "RandomAutocontrast", "RandomChannelPermutation", "RandomEqualize", "RandomErasing", "RandomGrayscale",
    "RandomInvert", "RandomPhotometricDistort", "RandomPosterize", "RandomSolarize",
]  # fmt: skip


class Grayscale(Transform, function=F.rgb_to_grayscale):
    """Make gray of colors.

    Args:
        num_output_channels: 1 or 3.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.Grayscale()(torch.zeros(3, 8, 6)).shape
        torch.Size([1, 8, 6])
    """

    num_output_channels: int = 1


class RandomGrayscale(Chance, function=F.rgb_to_grayscale):
    """Make gray of colors with a probability, in as many channels.

    Args:
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomGrayscale(p=1.0)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    p: float = 0.1

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"num_output_channels": channels_in(flat_inputs)}


class RGB(Transform, function=F.grayscale_to_rgb):
    """Repeat the one channel of gray images.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RGB()(torch.zeros(1, 8, 6)).shape
        torch.Size([3, 8, 6])
    """


def _factors(op: str, name: str, value: Any) -> tuple[float, float] | None:
    """The interval of a factor; None for one that changes nothing."""
    center, low, high = (0.0, -0.5, 0.5) if name == "hue" else (1.0, 0.0, math.inf)
    values = _check.scalars(op, name, value)
    if isinstance(values, (int, float)):
        if values < 0:
            raise ValueError(f"{op}: expected {name} of at least 0, got {value}")
        values = max(center - values, low) if low == 0 else center - values, center + values
    a, b = (center, center) if values is None else argument.ascending(op, name, values)
    if not low <= a <= b <= high:
        raise ValueError(f"{op}: expected {name} in [{low}, {high}], increasing, got {value}")
    return None if a == b == center else (float(a), float(b))


def _erased(op: str, name: str, value: Any) -> list[float] | None:
    """The color of what is erased, None for noise."""
    values = _check.scalars(op, name, value)
    if values == "random":
        return None
    if isinstance(values, str):
        raise ValueError(f"{op}: expected {name} to be a number, one of each channel or 'random', got {value!r}")
    return [float(v) for v in argument.several(op, name, values)]


class _Jitter(Transform, draws=True):
    functionals = {f"{n}_factor": getattr(F, f"adjust_{n}") for n in ("brightness", "contrast", "saturation", "hue")}

    def _calls(self, options: dict[str, Any], params: dict[str, Any]) -> list[Call]:
        names = tuple(self.functionals)
        factors = [(name := names[i], params[name]) for i in params["fn_idx"]]
        calls: list[Call] = [(self.functionals[name], {name: factor}) for name, factor in factors if factor is not None]
        channels = params.get("channel_permutation")
        return calls if channels is None else [*calls, (F.permute_channels, {"permutation": channels})]

    def _factors(self, p: float | None = None) -> dict[str, float | None]:
        """A factor of each function that changes something, drawn with a probability where there is one."""
        factors = dict.fromkeys(self.functionals)
        for name in factors:
            if (interval := getattr(self, name.removesuffix("_factor"))) and (p is None or draw.unit() < p):
                factors[name] = draw.uniform(interval)
        return factors


class ColorJitter(_Jitter):
    """Change brightness, contrast, saturation and hue by random factors, in a random order.

    Args:
        brightness: least and largest factor, or a for [1 - a, 1 + a].
        contrast: the same, of the distance from the mean gray.
        saturation: the same, of the distance from gray.
        hue: least and largest rotation in turns, at most half a one, or a for [-a, a].

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ColorJitter(0.2, 0.2, 0.2, 0.1)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    brightness: float | Sequence[float] | None = None
    contrast: float | Sequence[float] | None = None
    saturation: float | Sequence[float] | None = None
    hue: float | Sequence[float] | None = None

    checks = dict.fromkeys(("brightness", "contrast", "saturation", "hue"), _factors)

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"fn_idx": draw.permutation(4), **self._factors()}


class RandomPhotometricDistort(_Jitter):
    """Change brightness, contrast, saturation, hue and the order of channels, each with a probability.

    Args:
        brightness: least and largest factor.
        contrast: least and largest factor.
        saturation: least and largest factor.
        hue: least and largest rotation in turns.
        p: the probability of each.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomPhotometricDistort()(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    brightness: tuple[float, float] = (0.875, 1.125)
    contrast: tuple[float, float] = (0.5, 1.5)
    saturation: tuple[float, float] = (0.5, 1.5)
    hue: tuple[float, float] = (-0.05, 0.05)
    p: float = 0.5

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        factors = self._factors(self.p)
        order = (0, 1, 2, 3) if draw.unit() < 0.5 else (0, 2, 3, 1)  # contrast before or behind the colors
        channels = draw.permutation(channels_in(flat_inputs)) if draw.unit() < self.p else None
        return {"fn_idx": order, **factors, "channel_permutation": channels}


class RandomChannelPermutation(Transform, function=F.permute_channels, draws=True):
    """Permute the channels.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomChannelPermutation()(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"permutation": draw.permutation(channels_in(flat_inputs))}


class RandomInvert(RandomTransform, function=F.invert):
    """Invert the colors with a probability.

    Args:
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomInvert(p=1.0)(torch.zeros(1, 1, 1))
        tensor([[[1.]]])
    """


class RandomEqualize(RandomTransform, function=F.equalize):
    """Equalize the histograms of channels with a probability.

    Args:
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomEqualize(p=1.0)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """


class RandomAutocontrast(RandomTransform, function=F.autocontrast):
    """Stretch each channel to black and white with a probability.

    Args:
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomAutocontrast(p=1.0)(torch.tensor([[[0.0, 0.5]]]))
        tensor([[[0., 1.]]])
    """


class RandomPosterize(Chance, function=F.posterize):
    """Keep the high bits of the values with a probability.

    Args:
        bits: how many, 0 to 8.
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomPosterize(1, p=1.0)(torch.tensor([[[100, 200]]], dtype=torch.uint8))
        tensor([[[  0, 128]]], dtype=torch.uint8)
    """

    bits: int
    p: float = 0.5

    checks = {"bits": lambda op, name, value: _check.ints(op, name, value, 1, 0, 8)[0]}


class RandomSolarize(Chance, function=F.solarize):
    """Invert what is at least a threshold, with a probability.

    Args:
        threshold: in the units of the image.
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomSolarize(0.5, p=1.0)(torch.tensor([[[0.2, 0.75]]]))
        tensor([[[0.2000, 0.2500]]])
    """

    threshold: float
    p: float = 0.5


class RandomAdjustSharpness(Chance, function=F.adjust_sharpness):
    """Sharpen or smooth with a probability.

    Args:
        sharpness_factor: 0 smooths, 1 changes nothing, above 1 sharpens.
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomAdjustSharpness(2, p=1.0)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    sharpness_factor: float
    p: float = 0.5


class GaussianBlur(Transform, function=F.gaussian_blur, draws=True):
    """Smooth with a random standard deviation.

    Args:
        kernel_size: width and height of the kernel, odd, an int for both.
        sigma: least and largest standard deviation, or one.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.GaussianBlur(3)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    kernel_size: int | Sequence[int]
    sigma: float | Sequence[float] = (0.1, 2.0)

    checks = {
        "kernel_size": argument.where(argument.two, lambda v: v[0] % 2 == v[1] % 2 == 1, "odd"),
        "sigma": argument.where(
            argument.two_numbers, lambda v: 0 < v[0] <= v[1], "one or two numbers above 0, ascending"
        ),
    }

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"sigma": [draw.uniform(self.sigma)] * 2}


class GaussianNoise(Transform, function=F.gaussian_noise):
    """Add normally distributed noise.

    Args:
        mean: of the noise, in shares of white.
        sigma: its standard deviation.
        clip: keep values between black and white.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.GaussianNoise()(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    mean: float = 0.0
    sigma: float = 0.1
    clip: bool = True


class JPEG(Transform, function=F.jpeg, draws=True):
    """Compress and decompress uint8 images as JPEG of a random quality.

    Args:
        quality: least and largest quality of 1 to 100, or one.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.JPEG(50)(torch.zeros(3, 8, 6, dtype=torch.uint8)).shape
        torch.Size([3, 8, 6])
    """

    quality: int | Sequence[int]

    checks = {"quality": argument.where(argument.two, lambda v: v[0] <= v[1] <= 100, "of 1 to 100, or two of them")}

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        low, high = self.quality  # type: ignore[misc]  # two by now
        return {"quality": draw.integer(low, high + 1)}


_ON_HOST = torch.zeros((), dtype=torch.float32, device="cpu")


class RandomErasing(RandomTransform, function=F.erase):
    """Erase a random window with a probability.

    Args:
        p: the probability.
        scale: least and largest share of the area.
        ratio: least and largest height over width.
        value: the color: a number, one of each channel, or "random" for noise.
        inplace: write into the image.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> bool((tv.RandomErasing(p=1.0)(torch.ones(3, 8, 6)) == 0).any())
        True
    """

    scale: Sequence[float] = (0.02, 0.33)
    ratio: Sequence[float] = (0.3, 3.3)
    value: float | str | Sequence[float] = 0.0
    inplace: bool = False

    checks = {"scale": argument.fractions, "value": _erased}

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any] | None:
        channels, (height, width) = channels_in(flat_inputs), size_of(flat_inputs)
        value: Any = self.value
        if value is not None and len(value) not in (1, channels):
            raise ValueError(f"RandomErasing: expected a value, or one of {channels} channels, got {value}")
        for _ in range(10):
            w, h = drawn_window(height, width, self.scale, self.ratio)
            if h < height and w < width:
                noise = torch.randn(channels, h, w, device="cpu") if value is None else None
                v = constant(tuple(((v,),) for v in value), _ON_HOST) if noise is None else noise
                top, left = draw.integer(0, height - h + 1), draw.integer(0, width - w + 1)
                return {"i": top, "j": left, "h": h, "w": w, "v": v}
        return None
