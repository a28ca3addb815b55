"""Layers and maps of noise for a list of images, drawn and changed by one operator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._constants import constant
from kvision._dtype import compute_dtype
from kvision._ops import FastPath
from kvision.augmentation.engine import Execution
from kvision.augmentation.lists.pixels import given_maps
from kvision.augmentation.lists.sides import rows_on_device
from kvision.augmentation.maps import as_batch
from kvision.augmentation.random_generator.mapped import NoiseOfList
from kvision.geometry.transform.lists.arguments import sizes
from kvision.geometry.transform.lists.kept_sizes import Operation

_spatter_layers = FastPath("spatter_layers", (torch.float32,))
_blurred_maps = FastPath("blurred_maps", (torch.float32,))


def spatter_layers(
    noise: NoiseOfList, smoothing: Operation, parameters: Tensor, softening: Operation | None
) -> tuple[Tensor, Tensor | None] | None:
    """The packed layers (N,) of stains, or without `softening` of drops, whose largest values (B,) follow them; None where no
    kernel serves them.
    """
    then = smoothing if softening is None else softening
    wants_gradients = any(
        isinstance(x, Tensor) and x.requires_grad for x in (smoothing.arguments[0], then.arguments[0])
    )
    if wants_gradients or not _spatter_layers.serves(parameters):
        return None
    standard = constant(((0.0, 1.0),), parameters)
    (keys, seeds, chosen, plan), sides = noise.source.arguments(), sizes(noise.images)
    *blur, _ = smoothing.arguments
    *soft, _ = then.arguments
    drawn = (standard, keys, seeds, chosen, list(plan), sides)
    layers, most = _spatter_layers.kernel(*drawn, *blur, parameters, softening is None, *soft)
    return layers, most if softening is None else None


def blurred_maps(noise: NoiseOfList, sigma: float, border: int) -> Tensor | None:
    """The maps (B, 2, H, W) of noise, blurred by `sigma` sides of each image; None where no kernel serves them."""
    like = noise.images[0]
    if not _blurred_maps.serves(like.new_empty(1, dtype=compute_dtype(like))):
        return None
    sides, (keys, seeds, chosen, plan) = sizes(noise.images), noise.source.arguments()
    scales = torch.tensor([(0.0, noise.map.most * height) for height in sides[::2]], device="cpu")
    parameters = rows_on_device(scales, noise.images[0], torch.float32)
    maps: Tensor = _blurred_maps.kernel(parameters, keys, seeds, chosen, list(plan), sides, sigma, border)
    return maps


def plasma_of_list(module: Any, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Tensor:
    """The fractal maps (B, C, H, W) of an augmentation, as large as the largest image of a list."""
    if execution.params is not None:
        return as_batch(given_maps(execution.params["plasma"], like.device, compute_dtype(like)))
    assert execution.columns is not None
    values, noise = execution.columns.values, module._pixel_noise(execution, execution.redraw, like.device)
    plasma: Tensor = module._param_generator.plasma(values, like.shape[1], sizes(images), noise)
    return plasma.to(compute_dtype(like))
