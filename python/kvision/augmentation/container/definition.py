"""What a chain of augmentations computes, written plainly: one after the other, each sample by its parameters by name.

The plans of passes.py give the same in fewer passes over the images, up to rounding. No call runs this; tests compare with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision.augmentation.base import AugmentationBase, where_chosen


def run_in_turn(x: Tensor, augmentations: Sequence[AugmentationBase], params: Sequence[dict[str, Any]]) -> Tensor:
    """Run augmentations with given parameters, each of which resamples the images that the one before it left.

    Bytes count as 255ths where colors change. They are rounded behind each augmentation, but behind neighbors that change
    colors once: between these there are numbers.
    """
    stored = x.dtype
    for i, (module, own) in enumerate(zip(augmentations, params)):
        result = module._result_dtype(stored)
        is_color = _changes_colors(module, x)
        if is_color and x.dtype == torch.uint8:
            x = x.float() / 255
        x = _run_chosen(x, module, own)
        goes_on = is_color and i + 1 < len(augmentations) and _changes_colors(augmentations[i + 1], x)
        if result == torch.uint8 and x.dtype != result and not goes_on:
            x = (x * 255).round().clamp(0, 255).to(result)
        stored = result
    return x


def _changes_colors(module: AugmentationBase, x: Tensor) -> bool:
    contribution = module._contribution(tuple(x.shape), module.flags)
    return contribution is not None and contribution.colors is not None


def _run_chosen(x: Tensor, module: AugmentationBase, params: dict[str, Any]) -> Tensor:
    """All samples augmented, and those taken that are chosen; a batch whose size changes is augmented as a whole or not at all."""
    chosen = params["batch_prob"] > 0.5
    if module.whole_batch and not bool(chosen.any()):
        return x
    y: Tensor = module(x, params={**params, "batch_prob": torch.ones(len(chosen))})
    return y if module.whole_batch else where_chosen(chosen.to(x.device), y, x.to(y.dtype))
