"""Fractal noise by the diamond-square algorithm, drawn by the operator that makes it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision._ops import register
from kvision.augmentation.keys import flatten_draws
from kvision.augmentation.noise import PixelNoise, uniform_noise
from kvision.contrib.diamond_square import diamond_square
from kvision.geometry.transform.lists.arguments import row


def _largest(size: Sequence[int]) -> Sequence[int]:
    """Channels and the largest of heights and widths."""
    return size if len(size) == 3 else [size[0], max(size[1::2]), max(size[2::2])]


def _reference(
    roughness: Tensor, keys: Tensor, seeds: Tensor | None, plan: Sequence[int], size: Sequence[int]
) -> Tensor:
    """Fractal maps (B, C, H, W) of roughness (B,), by the uniform noise of a key: that of the first grid, and of each step.

    The size is C, H and W, or C, and height and width of each sample: then maps are as large as the largest, and 0 beyond their
    own pixels. Computed in float64 and rounded, so that the maps do not depend on the device.
    """
    if len(size) > 3:
        largest = _largest(size)
        index, position, draw, same, form, first = (*plan, 0, 0)[:6]
        maps_of_samples = []
        for b in range(roughness.shape[0]):
            side = size[2 * b + 1 : 2 * b + 3]
            own_plan = (index, position, draw, same, form, first + b)
            own = _reference(roughness[b : b + 1], keys, row(seeds, b), own_plan, [size[0], *side])
            maps_of_samples.append(F.pad(own, (0, largest[2] - side[1], 0, largest[1] - side[0])))
        return torch.cat(maps_of_samples)
    (batch, (channels, height, width)), maps = (roughness.shape[0], size), itertools.count()
    if roughness.numel() == 0:
        return roughness.new_empty(batch, channels, height, width)
    half = torch.full((1, 2), 0.5, dtype=torch.float64, device=roughness.device)

    def random(size: Sequence[int], device: Any = None, dtype: Any = None) -> Tensor:
        zeros = torch.zeros(batch, channels, *size[-2:], dtype=torch.float64, device=roughness.device)
        index, position, draw, *rest = plan
        own = (index, position, draw + next(maps), *rest)
        return uniform_noise.definition(zeros, half, keys, seeds, None, own).reshape(tuple(size))

    whole = (batch, channels, int(height), int(width))
    y = diamond_square(whole, roughness.double(), random_fn=random, device=roughness.device, dtype=torch.float64)
    return y.to(roughness.dtype)


_fractal_noise = register(
    "fractal_noise",
    _reference,
    fake=lambda roughness, keys, seeds, plan, size: (roughness.shape[0], *_largest(size)),
    non_differentiable=(0,),
    flatten=flatten_draws(keys=1),
)


def fractal_noise(roughness: Tensor, noise: PixelNoise, size: Sequence[int]) -> Tensor:
    """Fractal maps (B, C, H, W) of a size, as the reference takes it, and of roughness (B,), by a source of noise."""
    keys, seeds, _, plan = noise.arguments()
    y: Tensor = _fractal_noise(roughness.detach(), keys, seeds, plan, list(size))
    return y
