"""Fractal noise by the diamond-square algorithm, drawn by the operator that makes it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._ops import register
from kvision.augmentation.keys import flatten_draws
from kvision.augmentation.noise import PixelNoise, uniform_noise
from kvision.contrib.diamond_square import diamond_square


def _reference(
    roughness: Tensor, keys: Tensor, seeds: Tensor | None, plan: Sequence[int], size: Sequence[int]
) -> Tensor:
    """Fractal maps (B, C, H, W) of roughness (B,), by the uniform noise of a key: that of the first grid, and of each step.

    Computed in float64 and rounded, so that the maps do not depend on the device.
    """
    (batch, (channels, height, width)), maps = (roughness.shape[0], size), itertools.count()
    if roughness.numel() == 0:
        return roughness.new_empty(batch, channels, height, width)
    half = torch.full((1, 2), 0.5, dtype=torch.float64, device=roughness.device)

    def random(size: Sequence[int], device: Any = None, dtype: Any = None) -> Tensor:
        zeros = torch.zeros(batch, channels, *size[-2:], dtype=torch.float64, device=roughness.device)
        index, position, draw, same = plan
        own = (index, position, draw + next(maps), same)
        return uniform_noise.definition(zeros, half, keys, seeds, None, own).reshape(tuple(size))

    whole = (batch, channels, int(height), int(width))
    y = diamond_square(whole, roughness.double(), random_fn=random, device=roughness.device, dtype=torch.float64)
    return y.to(roughness.dtype)


_fractal_noise = register(
    "fractal_noise",
    _reference,
    fake=lambda roughness, keys, seeds, plan, size: (roughness.shape[0], *size),
    non_differentiable=(0,),
    flatten=flatten_draws(keys=1),
)


def fractal_noise(roughness: Tensor, noise: PixelNoise, size: Sequence[int]) -> Tensor:
    """Fractal maps (B, C, H, W) of a size (C, H, W) and of roughness (B,), by a source of noise."""
    keys, seeds, _, plan = noise.arguments()
    y: Tensor = _fractal_noise(roughness.detach(), keys, seeds, plan, list(size))
    return y
