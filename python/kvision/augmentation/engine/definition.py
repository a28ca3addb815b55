"""What a chain of augmentations computes, written plainly: one after the other, each sample by its parameters by name.

The plans of passes.py give the same in fewer passes over the images, up to rounding. No call runs this; tests compare with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import takewhile
from typing import Any

import torch
from torch import Tensor

from kvision.augmentation import maps
from kvision.augmentation.engine.augmentation import AugmentationBase
from kvision.augmentation.engine.contribution import Contribution
from kvision.augmentation.engine.execution import Shape
from kvision.augmentation.samples import where_chosen

Call = tuple[AugmentationBase, dict[str, Any]]  # an augmentation with its parameters


def run_in_turn(
    x: Tensor, augmentations: Sequence[AugmentationBase], params: Sequence[dict[str, Any]], once: bool = False
) -> Tensor:
    """Run augmentations with given parameters, each of which resamples the images that the one before it left.

    Bytes count as 255ths where colors change. They are rounded behind each augmentation, but behind neighbors that change
    colors once: between these there are numbers. With `once`, neighbors that move pixels read the images once. What is blurred
    where images become smaller is left out.
    """
    stored = x.dtype
    pending: list[Call] = list(zip(augmentations, params))
    while pending:
        shape = tuple(x.shape)
        motions = [_contribution(module, shape).motion for module, _ in pending] if once else []
        together = pending[: len(list(takewhile(bool, motions)))]
        if together:
            x, pending = _read_once(x, together), pending[len(together) :]
            continue
        (module, own), pending = pending[0], pending[1:]
        result = module._result_dtype(stored)
        is_color = _contribution(module, tuple(x.shape)).colors is not None
        if is_color and x.dtype == torch.uint8:
            x = x.float() / 255
        x = _run_chosen(x, module, own)
        goes_on = is_color and len(pending) > 0 and _contribution(pending[0][0], tuple(x.shape)).colors is not None
        if result == torch.uint8 and x.dtype != result and not goes_on:
            x = (x * 255).round().clamp(0, 255).to(result)
        stored = result
    return x


def _contribution(module: AugmentationBase, shape: Shape) -> Contribution:
    return module._contribution(shape, module.flags) or Contribution()


def _run_chosen(x: Tensor, module: AugmentationBase, params: dict[str, Any]) -> Tensor:
    """All samples augmented, and those taken that are chosen; a batch whose size changes is augmented as a whole or not at all."""
    chosen = params["batch_prob"] > 0.5
    if module.whole_batch and not bool(chosen.any()):
        return x
    y: Tensor = module(x, params={**params, "batch_prob": torch.ones_like(chosen, dtype=torch.float32)})
    return y if module.whole_batch else where_chosen(chosen.to(x.device), y, x.to(y.dtype))


def _read_once(x: Tensor, calls: Sequence[Call]) -> Tensor:
    """The images where the pixels of the result come from, which go back through the augmentations, the last one first."""
    shape, executions, motions = tuple(x.shape), [], []
    for module, params in calls:
        execution = module._execution_on(x.new_empty(1).expand(shape), params, module.flags)
        motion = module._declared(shape, module.flags).motion
        assert motion is not None
        shape = (*shape[:2], *motion.size) if execution.applied else shape
        executions.append(execution)
        motions.append(motion)
    like = x if x.is_floating_point() else x.new_empty(0, dtype=torch.float32)
    height, width = shape[2:]
    points = maps.pixel_positions(height, width, like).expand(len(x), -1, 2)
    for (module, _), execution in zip(reversed(calls), reversed(executions)):
        points = module.inverse_points(points, execution)
    reading = next((motion for motion in motions if motion.interpolates), motions[-1])
    return maps.read(x, points.unflatten(1, (height, width)), reading.resampling)
