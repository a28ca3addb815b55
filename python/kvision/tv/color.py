"""v2's classes of colors, noise and erased parts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from kvision import _check
from kvision._tv_tensors import kind_of
from kvision.tv import functional as F
from kvision.tv.geometry import drawn_window
from kvision.tv.transform import (
    RandomTransform,
    Transform,
    channels_in,
    integer,
    pair,
    permutation,
    size_of,
    two,
    uniform,
    unit,
)


class Grayscale(Transform):
    """Make gray of colors.

    Args:
        num_output_channels: 1 or 3.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.Grayscale()(torch.zeros(3, 8, 6)).shape
        torch.Size([1, 8, 6])
    """

    def __init__(self, num_output_channels: int = 1) -> None:
        super().__init__()
        self.num_output_channels = num_output_channels

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.rgb_to_grayscale, inpt, num_output_channels=self.num_output_channels)


class RandomGrayscale(RandomTransform):
    """Make gray of colors with a probability, in as many channels.

    Args:
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomGrayscale(p=1.0)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    def __init__(self, p: float = 0.1) -> None:
        super().__init__(p)

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"num_output_channels": channels_in(flat_inputs)}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.rgb_to_grayscale, inpt, **params)


class RGB(Transform):
    """Repeat the one channel of gray images.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RGB()(torch.zeros(1, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.grayscale_to_rgb, inpt)


def _factors(name: str, value: Any, center: float, low: float, high: float) -> tuple[float, float] | None:
    """The interval of a factor; None for one that changes nothing."""
    if value is None:
        return None
    value = _check.scalars("ColorJitter", name, value)
    if isinstance(value, (int, float)):
        if value < 0:
            raise ValueError(f"ColorJitter: expected {name} of at least 0, got {value}")
        value = max(center - value, low) if low == 0 else center - value, center + value
    a, b = two("ColorJitter", name, value, (2,))
    if not low <= a <= b <= high:
        raise ValueError(f"ColorJitter: expected {name} in [{low}, {high}], increasing, got {value}")
    return None if a == b == center else (float(a), float(b))


class _Jitter(Transform):
    draws = True
    functionals = {
        "brightness_factor": F.adjust_brightness,
        "contrast_factor": F.adjust_contrast,
        "saturation_factor": F.adjust_saturation,
        "hue_factor": F.adjust_hue,
    }

    def _adjust(self, inpt: Any, names: Sequence[str], params: dict[str, Any]) -> Any:
        for name in names:
            if params[name] is not None:
                inpt = self._call_kernel(self.functionals[name], inpt, params[name])
        return inpt


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

    def __init__(
        self,
        brightness: float | Sequence[float] | None = None,
        contrast: float | Sequence[float] | None = None,
        saturation: float | Sequence[float] | None = None,
        hue: float | Sequence[float] | None = None,
    ) -> None:
        super().__init__()
        self.brightness = _factors("brightness", brightness, 1.0, 0.0, float("inf"))
        self.contrast = _factors("contrast", contrast, 1.0, 0.0, float("inf"))
        self.saturation = _factors("saturation", saturation, 1.0, 0.0, float("inf"))
        self.hue = _factors("hue", hue, 0.0, -0.5, 0.5)

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        order = permutation(4)
        intervals = (self.brightness, self.contrast, self.saturation, self.hue)
        factors = [None if interval is None else uniform(*interval) for interval in intervals]
        return {"fn_idx": order, **dict(zip(self.functionals, factors))}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        names = tuple(self.functionals)
        return self._adjust(inpt, [names[i] for i in params["fn_idx"]], params)


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

    def __init__(
        self,
        brightness: tuple[float, float] = (0.875, 1.125),
        contrast: tuple[float, float] = (0.5, 1.5),
        saturation: tuple[float, float] = (0.5, 1.5),
        hue: tuple[float, float] = (-0.05, 0.05),
        p: float = 0.5,
    ) -> None:
        super().__init__()
        op = "RandomPhotometricDistort"
        self.brightness, self.contrast = pair(op, "brightness", brightness), pair(op, "contrast", contrast)
        self.saturation, self.hue = pair(op, "saturation", saturation), pair(op, "hue", hue)
        self.p = _check.fraction(op, "p", p)

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        channels = channels_in(flat_inputs)
        intervals = (self.brightness, self.contrast, self.saturation, self.hue)
        params: dict[str, Any] = {}
        for name, interval in zip(self.functionals, intervals):
            params[name] = uniform(*interval) if unit() < self.p else None
        params["contrast_before"] = unit() < 0.5
        params["channel_permutation"] = permutation(channels) if unit() < self.p else None
        return params

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        names = ["brightness_factor", "saturation_factor", "hue_factor"]
        names.insert(1 if params["contrast_before"] else 3, "contrast_factor")
        inpt = self._adjust(inpt, names, params)
        channels = params["channel_permutation"]
        return inpt if channels is None else self._call_kernel(F.permute_channels, inpt, channels)


class RandomChannelPermutation(Transform):
    """Permute the channels.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomChannelPermutation()(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    draws = True

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"permutation": permutation(channels_in(flat_inputs))}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.permute_channels, inpt, **params)


class RandomInvert(RandomTransform):
    """Invert the colors with a probability.

    Args:
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomInvert(p=1.0)(torch.zeros(1, 1, 1))
        tensor([[[1.]]])
    """

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.invert, inpt)


class RandomEqualize(RandomTransform):
    """Equalize the histograms of channels with a probability.

    Args:
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomEqualize(p=1.0)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.equalize, inpt)


class RandomAutocontrast(RandomTransform):
    """Stretch each channel to black and white with a probability.

    Args:
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomAutocontrast(p=1.0)(torch.tensor([[[0.0, 0.5]]]))
        tensor([[[0., 1.]]])
    """

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.autocontrast, inpt)


class RandomPosterize(RandomTransform):
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

    def __init__(self, bits: int, p: float = 0.5) -> None:
        super().__init__(p)
        (self.bits,) = _check.ints("RandomPosterize", "bits", bits, 1, 0, 8)

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.posterize, inpt, bits=self.bits)


class RandomSolarize(RandomTransform):
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

    def __init__(self, threshold: float, p: float = 0.5) -> None:
        super().__init__(p)
        self.threshold = _check.number("RandomSolarize", "threshold", threshold)

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.solarize, inpt, threshold=self.threshold)


class RandomAdjustSharpness(RandomTransform):
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

    def __init__(self, sharpness_factor: float, p: float = 0.5) -> None:
        super().__init__(p)
        self.sharpness_factor = _check.number("RandomAdjustSharpness", "sharpness_factor", sharpness_factor, 0)

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.adjust_sharpness, inpt, sharpness_factor=self.sharpness_factor)


class GaussianBlur(Transform):
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

    draws = True

    def __init__(self, kernel_size: int | Sequence[int], sigma: float | Sequence[float] = (0.1, 2.0)) -> None:
        super().__init__()
        self.kernel_size = two("GaussianBlur", "kernel_size", kernel_size)
        if any(k <= 0 or k % 2 == 0 for k in self.kernel_size):
            raise ValueError(f"GaussianBlur: expected odd kernel_size, got {kernel_size}")
        self.sigma = two("GaussianBlur", "sigma", sigma)
        if not 0 < self.sigma[0] <= self.sigma[1]:
            raise ValueError(f"GaussianBlur: expected sigma above 0, increasing, got {sigma}")

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"sigma": [uniform(*self.sigma)] * 2}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.gaussian_blur, inpt, self.kernel_size, **params)


class GaussianNoise(Transform):
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

    def __init__(self, mean: float = 0.0, sigma: float = 0.1, clip: bool = True) -> None:
        super().__init__()
        self.mean, self.sigma, self.clip = mean, sigma, clip

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.gaussian_noise, inpt, mean=self.mean, sigma=self.sigma, clip=self.clip)


class JPEG(Transform):
    """Compress and decompress uint8 images as JPEG of a random quality.

    Args:
        quality: least and largest quality of 1 to 100, or one.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.JPEG(50)(torch.zeros(3, 8, 6, dtype=torch.uint8)).shape
        torch.Size([3, 8, 6])
    """

    draws = True

    def __init__(self, quality: int | Sequence[int]) -> None:
        super().__init__()
        low, high = self.quality = two("JPEG", "quality", quality, (2,))
        if not (type(low) is type(high) is int and 1 <= low <= high <= 100):
            raise ValueError(f"JPEG: expected a quality of 1 to 100, or two of them, got {quality!r}")

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"quality": integer(self.quality[0], self.quality[1] + 1)}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.jpeg, inpt, **params)


class RandomErasing(RandomTransform):
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

    def __init__(
        self,
        p: float = 0.5,
        scale: Sequence[float] = (0.02, 0.33),
        ratio: Sequence[float] = (0.3, 3.3),
        value: float | str | Sequence[float] = 0.0,
        inplace: bool = False,
    ) -> None:
        super().__init__(p)
        self.scale, self.ratio = (two("RandomErasing", n, v, (2,)) for n, v in (("scale", scale), ("ratio", ratio)))
        if not (0 <= self.scale[0] and self.scale[1] <= 1):
            raise ValueError(f"RandomErasing: expected scale in [0, 1], got {scale}")
        if not 0 < self.ratio[0] <= self.ratio[1] < float("inf"):
            raise ValueError(f"RandomErasing: expected ratio above 0, in ascending order, got {ratio}")
        if isinstance(value, str) and value != "random":
            raise ValueError(
                f"RandomErasing: expected value to be a number, one of each channel or 'random', got {value!r}"
            )
        value = _check.scalars("RandomErasing", "value", value)
        numbers = [value] if isinstance(value, (int, float)) else value
        self.value = None if isinstance(numbers, str) else [float(v) for v in numbers]
        self.inplace = inplace
        self._log_ratio = torch.log(torch.tensor(self.ratio, device="cpu")).tolist()

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        channels, (height, width) = channels_in(flat_inputs), size_of(flat_inputs)
        if self.value is not None and len(self.value) not in (1, channels):
            raise ValueError(f"RandomErasing: expected a value, or one of {channels} channels, got {self.value}")
        for _ in range(10):
            w, h = drawn_window(height, width, self.scale, self._log_ratio)
            if h < height and w < width:
                random = self.value is None
                v = (
                    torch.randn(channels, h, w, device="cpu")
                    if random
                    else torch.tensor(self.value, device="cpu")[:, None, None]
                )
                return {"i": integer(0, height - h + 1), "j": integer(0, width - w + 1), "h": h, "w": w, "v": v}
        return {}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        if not params or kind_of(inpt) == "mask":
            return inpt
        return self._call_kernel(F.erase, inpt, **{**params, "inplace": self.inplace})
