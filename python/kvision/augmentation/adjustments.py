"""Random changes of the values of single pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from torch import Tensor

from kvision import _check
from kvision._constants import constant
from kvision._limits import LUMA
from kvision.augmentation.engine import Params, Shape
from kvision.augmentation.intensity_base import ColorStep, IntensityAugmentationBase2D
from kvision.augmentation.random_generator.color import PosterizeGenerator, ScaledGenerator
from kvision.augmentation.random_generator.plain import PlainUniformGenerator
from kvision.augmentation.ranges import Numbers, NumbersOfAxes
from kvision.core.exceptions import ShapeError, ValueCheckError

__all__ = [
    "RandomBrightness",
    "RandomContrast",
    "RandomGamma",
    "RandomGrayscale",
    "RandomHue",
    "RandomInvert",
    "RandomPosterize",
    "RandomRGBShift",
    "RandomSaturation",
    "RandomSolarize",
]


class RandomBrightness(IntensityAugmentationBase2D):
    """Add a random number to images: the factor less 1, as `enhance.adjust_brightness` takes it.

    Args:
        brightness: a pair of factors within 0 and 2; 1 changes nothing.
        clip_output: clamp the result to 0 and 1.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomBrightness((1.5, 1.5))(torch.full((1, 3, 1, 1), 0.25)).flatten()
        tensor([0.7500, 0.7500, 0.7500])
    """

    def __init__(
        self,
        brightness: Numbers = (1.0, 1.0),
        clip_output: bool = True,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = ScaledGenerator(
            "RandomBrightness", "brightness", brightness, (0.0, 2.0), "addition", 1.0, -1.0
        )
        self.clip_output = _check.switch(type(self).__name__, "clip_output", clip_output)

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep]:
        return [ColorStep("scale_shift", 1.0, "addition", float(self.clip_output))]


class RandomContrast(IntensityAugmentationBase2D):
    """Multiply images by a random factor.

    Args:
        contrast: a pair of factors of at least 0.
        clip_output: clamp the result to 0 and 1.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomContrast((2.0, 2.0))(torch.full((1, 3, 1, 1), 0.25)).flatten()
        tensor([0.5000, 0.5000, 0.5000])
    """

    def __init__(
        self,
        contrast: Numbers = (1.0, 1.0),
        clip_output: bool = True,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        bounds = (0.0, math.inf)
        self._param_generator = PlainUniformGenerator(
            (contrast, "contrast_factor", None, bounds), identity=[1.0], op="RandomContrast"
        )
        self.clip_output = _check.switch(type(self).__name__, "clip_output", clip_output)

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep]:
        return [ColorStep("scale_shift", "contrast_factor", 0.0, float(self.clip_output))]


class RandomSaturation(IntensityAugmentationBase2D):
    """Multiply the saturation of RGB images in HSV by a random factor.

    Args:
        saturation: a pair of factors of at least 0.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> red = torch.tensor([0.75, 0.25, 0.25]).reshape(1, 3, 1, 1)
        >>> K.augmentation.RandomSaturation((0.0, 0.0))(red).flatten()
        tensor([0.7500, 0.7500, 0.7500])
    """

    def __init__(
        self,
        saturation: Numbers = (1.0, 1.0),
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        bounds = (0.0, math.inf)
        self._param_generator = PlainUniformGenerator(
            (saturation, "saturation_factor", None, bounds), identity=[1.0], op="RandomSaturation"
        )

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep]:
        return [ColorStep("saturation", "saturation_factor")]


class RandomHue(IntensityAugmentationBase2D):
    """Rotate the hue of RGB images by a random angle.

    Args:
        hue: a pair of turns within -0.5 and 0.5.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> red = torch.tensor([1.0, 0.0, 0.0]).reshape(1, 3, 1, 1)
        >>> K.augmentation.RandomHue((0.5, 0.5))(red).flatten().round()
        tensor([0., 1., 1.])
    """

    def __init__(
        self,
        hue: Numbers = (0.0, 0.0),
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = ScaledGenerator("RandomHue", "hue", hue, (-0.5, 0.5), "radians", 2 * math.pi, 0.0)

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep]:
        return [ColorStep("hue", "radians")]


class RandomGamma(IntensityAugmentationBase2D):
    """Raise images to a random power, and multiply them by a random gain: gain * x ** gamma.

    Args:
        gamma: a pair of exponents of at least 0.
        gain: a pair of factors of at least 0.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomGamma((2.0, 2.0))(torch.full((1, 3, 1, 1), 0.5)).flatten()
        tensor([0.2500, 0.2500, 0.2500])
    """

    def __init__(
        self,
        gamma: Numbers = (1.0, 1.0),
        gain: Numbers = (1.0, 1.0),
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        bounds = (0.0, math.inf)
        self._param_generator = PlainUniformGenerator(
            (gamma, "gamma_factor", None, bounds),
            (gain, "gain_factor", None, bounds),
            identity=[1.0, 1.0],
            op="RandomGamma",
        )

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep]:
        return [ColorStep("gamma", "gamma_factor", "gain_factor")]


class RandomInvert(IntensityAugmentationBase2D):
    """Subtract images from their largest value.

    Args:
        max_val: the largest value: a number.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError: `max_val` is not a number.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomInvert(p=1.0)(torch.full((1, 1, 1, 1), 0.25)).flatten()
        tensor([0.7500])
    """

    def __init__(
        self,
        max_val: float | Tensor = 1.0,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self.flags = {"max_val": float(max_val)}

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep]:
        return [ColorStep("scale_shift", -1.0, flags["max_val"])]


class RandomSolarize(IntensityAugmentationBase2D):
    """Add a random number to images, and invert the values from a random threshold on.

    Args:
        thresholds: a number t for 0.5 - t to 0.5 + t within 0 and 1, or a pair.
        additions: a number a for -a to a within -0.5 and 0.5, or a pair.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> solarize = K.augmentation.RandomSolarize((0.5, 0.5), (0.0, 0.0), p=1.0)
        >>> solarize(torch.tensor([[[[0.25, 0.75]]]]))
        tensor([[[[0.2500, 0.2500]]]])
    """

    def __init__(
        self,
        thresholds: NumbersOfAxes = 0.1,
        additions: NumbersOfAxes = 0.1,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = PlainUniformGenerator(
            (thresholds, "thresholds", 0.5, (0.0, 1.0)), (additions, "additions", 0.0, (-0.5, 0.5)), op="RandomSolarize"
        )

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep]:
        return [ColorStep("solarize", "thresholds", "additions", 1.0)]


class RandomPosterize(IntensityAugmentationBase2D):
    """Keep a random number of the high bits of the 8-bit levels of images.

    Args:
        bits: a number b for b to 8, or a pair, of whole numbers within 0 and 8.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomPosterize((1, 1), p=1.0)(torch.tensor([[[[0.2, 0.6, 1.0]]]])) * 255
        tensor([[[[  0., 128., 128.]]]])
    """

    def __init__(
        self,
        bits: Numbers = 3,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = PosterizeGenerator(bits)

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep]:
        return [ColorStep("posterize", "bits_factor", 1.0)]


class RandomRGBShift(IntensityAugmentationBase2D):
    """Add a random number to each channel of RGB images, and clamp the result to 0 and 1.

    Args:
        r_shift_limit: largest shift of red, of either sign.
        g_shift_limit: that of green.
        b_shift_limit: that of blue.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomRGBShift(0.0, 0.0, 0.0, p=1.0)(torch.full((1, 3, 1, 1), 0.25)).flatten()
        tensor([0.2500, 0.2500, 0.2500])
    """

    def __init__(
        self,
        r_shift_limit: float = 0.5,
        g_shift_limit: float = 0.5,
        b_shift_limit: float = 0.5,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        limits = (("r", r_shift_limit), ("g", g_shift_limit), ("b", b_shift_limit))
        samplers = [(limit, f"{name}_shift", 0.0, None) for name, limit in limits]
        self._param_generator = PlainUniformGenerator(*samplers, op="RandomRGBShift")

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep]:
        return [ColorStep("scale_shift_rgb", 1.0, 1.0, 1.0, "r_shift", "g_shift", "b_shift", 1.0)]


class RandomGrayscale(IntensityAugmentationBase2D, keeps_contract=True):
    """Replace all channels by their weighted sum.

    Args:
        rgb_weights: weights of the channels; None for those of luma, (0.299, 0.587, 0.114), and for images that have not
            three channels the mean.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        ValueError: in a call, another number of weights than channels.

    Example:
        >>> import torch, kvision as K
        >>> gray = K.augmentation.RandomGrayscale(p=1.0)
        >>> gray(torch.tensor([1.0, 0.0, 0.0]).reshape(1, 3, 1, 1)).flatten()
        tensor([0.2990, 0.2990, 0.2990])
    """

    takes_volumes = True
    _is_by_pixel = True

    def __init__(
        self,
        rgb_weights: Tensor | Sequence[float] | None = None,
        same_on_batch: bool = False,
        p: float = 0.1,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self.rgb_weights = rgb_weights
        self._weights = None
        if rgb_weights is not None:
            weights = _check.as_tensor("RandomGrayscale", "rgb_weights", rgb_weights)
            _check.numbers("RandomGrayscale", "rgb_weights", weights)
            self._weights = weights.flatten().tolist()

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep] | None:
        if shape[1] != 3:
            return None
        row = self._weights or list(LUMA)
        if len(row) != 3:
            raise ValueCheckError(f"RandomGrayscale: expected 3 rgb_weights for 3 channels, got {len(row)}")
        return [ColorStep("affine", *row, *row, *row)]

    accepts_bytes = False

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        channels = input.shape[1]
        if channels == 3:
            return super().apply_transform(input, params, flags, transform)
        if self._weights is None:
            return input.mean(1, keepdim=True).expand_as(input)
        if len(self._weights) != channels:
            raise ShapeError(
                f"RandomGrayscale: expected {len(self._weights)} channels, got {tuple(input.shape)}"
                f"{_check.channels_advice(input.shape)}"
            )
        weights = constant(tuple(self._weights), input)
        return (input * weights.reshape(-1, *[1] * (input.dim() - 2))).sum(1, keepdim=True).expand_as(input)
