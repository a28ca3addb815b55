"""Random noise."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision._dtype import compute_dtype
from kvision.augmentation.engine import Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.noise import gaussian_noise, salt_and_pepper
from kvision.augmentation.random_generator.noise import GaussianNoiseGenerator, SaltAndPepperGenerator
from kvision.augmentation.ranges import Numbers
from kvision.geometry.transform.lists.kept_sizes import Operation

__all__ = ["RandomGaussianNoise", "RandomSaltAndPepperNoise"]

# Noise is drawn where it is added. Reading `_params` makes a tensor of it, by the same key.


class RandomGaussianNoise(IntensityAugmentationBase2D, keeps_contract=True):
    """Add normal noise to images, without clamping the result.

    Args:
        mean: of the noise.
        std: standard deviation of the noise.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: an argument is not a number; `std` is below 0.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomGaussianNoise(0.5, 0.0, p=1.0)(torch.zeros(1, 1, 1, 2))
        tensor([[[[0.5000, 0.5000]]]])
    """

    fuses_noise = True
    _of_pixels = ("gaussian_noise",)

    def __init__(
        self,
        mean: float = 0.0,
        std: float = 1.0,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = GaussianNoiseGenerator(mean, std)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        if "_noise" not in params and input.dtype == torch.uint8:
            return (input.float() + 255 * params["gaussian_noise"]).round().clamp(0, 255).to(torch.uint8)
        if "_noise" not in params:
            return input + params["gaussian_noise"]
        return self._operation(input, params)(input)

    def _operation(self, like: Tensor, params: Params) -> Operation:
        parameters, noise = params["_noise"]
        return Operation(gaussian_noise, (parameters.to(compute_dtype(like)), *noise.arguments()))


class RandomSaltAndPepperNoise(IntensityAugmentationBase2D, keeps_contract=True):
    """Set random pixels to 1 and to 0, in all channels.

    Args:
        amount: fraction of pixels that are hit: a number, or a pair within 0 and 1.
        salt_vs_pepper: fraction of salt, 1, among them: a number, or a pair within 0 and 1.
        p: probability that a sample is augmented.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomSaltAndPepperNoise(1.0, 1.0, p=1.0)(torch.zeros(1, 1, 1, 2))
        tensor([[[[1., 1.]]]])
    """

    fuses_noise = True
    _of_pixels = ("mask_salt", "mask_pepper")

    def __init__(
        self,
        amount: Numbers = (0.01, 0.06),
        salt_vs_pepper: Numbers = (0.4, 0.6),
        p: float = 0.5,
        same_on_batch: bool = False,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = SaltAndPepperGenerator(amount, salt_vs_pepper)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        if "_noise" not in params:
            salt = 255 if input.dtype == torch.uint8 else 1
            return input.masked_fill(params["mask_salt"], salt).masked_fill(params["mask_pepper"], 0)
        return self._operation(input, params)(input)

    def _operation(self, like: Tensor, params: Params) -> Operation:
        parameters, noise = params["_noise"]
        return Operation(salt_and_pepper, (parameters.to(compute_dtype(like)), *noise.arguments()))
