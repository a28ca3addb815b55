"""Color functions of the images of a batch, each with its own in an order of its own, as one color program."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from kvision._tv_tensors import kind_of, plain, wrap
from kvision.color.program import MAX_TENSORS, Arguments, run
from kvision.color.steps import STEPS
from kvision.tv.functional.dispatch import on_device

_NEEDS_LEVELS = ("posterize", "solarize")  # a fraction of a level moves their results far


def apply_steps(x: Any, calls: list[list[Any]]) -> Any:
    """Apply the functions with `steps` that the calls of each image of bytes (B, 3, H, W) begin with, and take them from the calls.

    Bytes are rounded at the end alone; in between, half a level less stands for v2's truncation. A function that the image has
    had before is left in the calls, as is one that needs whole levels and is not the first.
    """
    batch = plain(x)
    if kind_of(x) not in ("tensor", "image") or batch.dtype != torch.uint8 or batch.dim() != 4 or batch.shape[1] != 3:
        return x
    if not any(getattr(function, "steps", None) for function in {own[0][0] for own in calls if own}):
        return x
    images = [_taken(own) for own in calls]
    steps: list[int] = []
    numbers: list[float] = []
    columns: list[int] = []  # of each number in the table of those that differ, -1 for one that all images have
    table: list[Any] = []  # arrays
    places: dict[Any, range] = {}  # of the steps of each function
    for function in dict.fromkeys(function for taken in images for function in taken):
        some = next(taken[function] for taken in images if function in taken)
        rows = [taken.get(function, some) for taken in images]
        of_each = {name: np.array([row[name] for row in rows], np.float32) for name in some}
        first = len(steps)
        for name, *values in function.steps(**of_each):
            steps.append(STEPS[name].number)
            for value in values:
                differs = isinstance(value, np.ndarray)
                columns.append(len(table) if differs else -1)
                numbers.append(0.0 if differs else value)
                table += [value] if differs else []
        places[function] = range(first, len(steps))
    orders = [[place for function in taken for place in places[function]] for taken in images]
    longest = max(map(len, orders))
    order = on_device(np.array([own + [-1] * (longest - len(own)) for own in orders]), x.device)
    drawn = on_device(np.stack(table, 1)[:, None], x.device) if table else None
    parameters = Arguments((drawn, *[None] * (MAX_TENSORS - 1)), numbers, columns if table else ())
    return wrap(run(batch, steps, parameters, order), x)


def _taken(calls: list[Any]) -> dict[Any, dict[str, Any]]:
    """The functions that an image's calls begin with, taken from them, with their arguments."""
    taken: dict[Any, dict[str, Any]] = {}
    while calls and (function := calls[0][0]) not in taken and getattr(function, "steps", None) is not None:
        if taken and function.__name__ in _NEEDS_LEVELS:
            break
        taken[function] = calls.pop(0)[1]
    return taken
