"""Replays of lists whose parameters are numbers of each pixel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.lists.pixels import PixelRow
from kvision.augmentation.sample_rows import index_of


def replay_pixels(
    module: Any, images: Sequence[Tensor], execution: Execution, names: Sequence[str], of_images: Sequence[str] = ()
) -> list[Tensor]:
    """What an augmentation makes of images each pixel of which becomes what its own numbers say: maps of these names, and numbers
    of its image.
    """
    params, results = execution.params or {}, list(images)
    is_drawn = "batch_prob" not in params  # so that which are chosen is not known to the host
    rows = list(range(len(images))) if is_drawn else chosen_rows(params)
    if not rows:
        return results
    row = PixelRow([images[i] for i in rows])
    pixels = row.of(row.images)[None, None, None]
    own = {name: row.of_maps(maps_of_rows(params[name], rows))[None, None, None] for name in names}
    for name in of_images:
        numbers = params[name].to(pixels.device)
        own[name] = row.of_images(numbers[index_of(rows, numbers)])[None, None, None]
    y = module._run(pixels, Execution(tuple(pixels.shape), params=own), module.flags).flatten()
    if is_drawn and execution.chosen is not None:
        y = torch.where(row.of_images(execution.chosen), y, pixels.flatten())
    for i, result in zip(rows, row.split(y)):
        results[i] = result
    return results


def chosen_rows(params: Params) -> list[int]:
    """The numbers of the images that are augmented."""
    return [i for i, is_chosen in enumerate((params["batch_prob"] > 0.5).tolist()) if is_chosen]


def maps_of_rows(maps: Any, rows: Sequence[int]) -> list[Tensor]:
    """The maps (1, P, H, W) of these images."""
    each = maps if isinstance(maps, list) else maps.split(1)
    return [each[i] for i in rows]
