"""Generators of noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision.augmentation import ranges
from kvision.augmentation.draws import uniform
from kvision.augmentation.noise import PixelNoise, gaussian_noise, on_numbers, salt_and_pepper
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.ranges import Numbers
from kvision.geometry.transform.lists.kept_sizes import Operation

__all__ = ["GaussianNoiseGenerator", "SaltAndPepperGenerator"]


class GaussianNoiseGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomGaussianNoise`.

    Args:
        mean: of the noise.
        std: standard deviation of the noise.

    Returns:
        gaussian_noise (B, C, H, W).

    Raises:
        TypeError, ValueError: an argument is not a number; `std` is below 0.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.GaussianNoiseGenerator(1.0, 0.0)((1, 1, 1, 2))
        {'gaussian_noise': tensor([[[[1., 1.]]]])}
    """

    per_pixel = True

    def __init__(self, mean: float, std: float) -> None:
        super().__init__()
        op = "RandomGaussianNoise"
        self.mean = ranges.parse(op, "mean", (mean, mean)).low
        self.std = ranges.parse(op, "std", (std, std), bounds=(0.0, float("inf"))).low

    def draws(self, shape: Shape) -> Sequence[Any]:
        # Columns as the operator takes them: samples that are not chosen have no noise.
        return [uniform(self.mean, self.mean), uniform(self.std, self.std)]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {}

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        drawing = Operation(gaussian_noise, (columns, *noise.arguments()))
        return {"gaussian_noise": on_numbers(drawing, shape, 0.0, columns)}


class SaltAndPepperGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomSaltAndPepperNoise`.

    Args:
        amount: fraction of pixels that are hit: a number, or a pair within 0 and 1.
        salt_and_pepper: fraction of salt among them: a number, or a pair within 0 and 1.

    Returns:
        amount_factor and salt_and_pepper_factor (B,); mask_salt and mask_pepper (B, C, H, W), bool.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.SaltAndPepperGenerator(1.0, 1.0)((1, 1, 1, 2))["mask_salt"]
        tensor([[[[True, True]]]])
    """

    fields = (("amount_factor", 0), ("salt_and_pepper_factor", 0))
    per_pixel = is_exact = True

    def __init__(self, amount: Numbers, salt_and_pepper: Numbers) -> None:
        super().__init__()
        self._ranges = [
            ranges.parse("RandomSaltAndPepperNoise", name, ranges.as_pair(value), bounds=(0.0, 1.0))
            for name, value in zip(
                ("amount", "salt_vs_pepper"),
                ranges.keep_parameters(self, amount=amount, salt_vs_pepper=salt_and_pepper),
            )
        ]

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [r.uniform() for r in self._ranges]

    def pixel_params(self, columns: Tensor, shape: Shape, noise: PixelNoise) -> dict[str, Tensor]:
        gray = torch.full((shape[0], 1, *shape[-2:]), 0.5, dtype=torch.float32, device=columns.device)
        hit = salt_and_pepper(gray, columns.detach(), *noise.arguments()).expand(*shape)
        return {"mask_salt": hit == 1, "mask_pepper": hit == 0}
