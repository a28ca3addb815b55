"""Leading axes of any number: images (*, C, H, W) for operators on batches (B, C, H, W), and what shapes have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import torch
from torch import Tensor


def apply_on_batch(operator: Callable[..., Any], image: Tensor, *args: Any) -> Any:
    """`operator(image, *args)` with the leading axes of `image` as one; its result, or each of them, has them again."""
    if image.dim() == 4:
        return operator(image, *args)
    leading = image.shape[:-3]

    def unflattened(y: Tensor) -> Tensor:
        return y.reshape(*leading, *y.shape[1:])

    output = operator(flatten_batch(image), *args)
    return tuple(map(unflattened, output)) if isinstance(output, tuple) else unflattened(output)


def broadcast_shapes(*shapes: Sequence[int]) -> Sequence[int]:
    """torch.broadcast_shapes, which takes as long as a kernel on few points; most of the time they are the same."""
    known = shapes[0] or shapes[-1]
    return known if all(s == known or not s for s in shapes) else torch.broadcast_shapes(*shapes)


def expand_to_batch(x: Tensor, leading: Sequence[int], axes: int) -> Tensor:
    """x (*, ...), whose last axes are a sample's, as rows for all samples of the axes `leading`; one that serves all, as one."""
    own = x.shape[x.dim() - axes :]
    if x.dim() == axes or x.numel() == own.numel():
        return x.reshape(1, *own)
    return x.expand(*leading, *own).reshape(prod(leading), *own)


def flat(image: Tensor) -> Tensor:
    """(*, C, H, W) as (B, C, H, W)."""
    return image if image.dim() == 4 else image.unsqueeze(0).flatten(0, -4)
