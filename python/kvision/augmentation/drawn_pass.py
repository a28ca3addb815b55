"""A pass over images and the draws of the columns that it reads, by one kernel where nothing else is asked for."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision._ops import Shortcut
from kvision.augmentation.columns import DrawPlan
from kvision.augmentation.keys import Keys
from kvision.augmentation.warp_and_color import Pass
from kvision.color.program import _DTYPES

_draw_warp_and_color = Shortcut("draw_warp_and_color", (torch.float32, torch.float16, torch.bfloat16, torch.uint8))


class DrawnPass(NamedTuple):
    """Draws, and the pass over images that reads their columns; with the plan of both for the kernel, where it takes them."""

    draws: DrawPlan
    own: Pass
    plan: Tensor | None
    numbers: Tensor | None

    def run(self, x: Tensor, keys: Keys) -> tuple[Tensor, Tensor, Tensor]:
        """The result, the matrices (B, 3, 3) of the warp, which do not carry gradients, and the columns."""
        if self.plan is not None and _draw_warp_and_color.serves(x):
            seeds = None if keys.seeds is None else keys.seeds.to(x.device, non_blocking=True)
            y, matrix, columns = _draw_warp_and_color(x, self.draws.keys_of(keys), seeds, self.plan, self.numbers)
            return y, matrix, columns
        columns = self.draws.draw(x, keys)
        y, matrix = self.own.run(x, columns)
        return y, matrix, columns


def join(draws: DrawPlan, own: Pass) -> DrawnPass:
    """Draws and a pass over the images of one call."""
    in_doubles = own.plan[0] == _DTYPES.index(torch.float64)
    if is_compiling() or draws.learned is not None or own.resampling is not None or own.chain or in_doubles:
        return DrawnPass(draws, own, None, None)
    # Tensors, because torch converts each entry of a list in every call. The plan: that of the draws, with its length
    # before it; how many of the numbers are theirs; the size of the result, with its length; and the plan of the pass.
    plan = [len(draws.plan), *draws.plan, len(draws.numbers), len(own.size), *own.size, *own.plan]
    numbers = [*draws.numbers, *own.numbers]
    return DrawnPass(
        draws,
        own,
        torch.tensor(plan, dtype=torch.int64, device="cpu"),
        torch.tensor(numbers, dtype=torch.float64, device="cpu"),
    )
