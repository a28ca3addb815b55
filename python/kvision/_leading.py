"""Any number of leading axes: images (*, C, H, W) for operators on batches (B, C, H, W), and shapes that broadcast."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import torch
from torch import Tensor


def apply_on_batch(operator: Callable[..., Any], image: Tensor, *args: Any) -> Any:
    """Call `operator` on `image` with its leading axes flattened to one batch, and restore them in the results."""
    if image.dim() == 4:
        return operator(image, *args)
    leading = image.shape[:-3]

    def unflatten_batch(y: Tensor) -> Tensor:
        return y.reshape(*leading, *y.shape[1:])

    output = operator(flatten_batch(image), *args)
    return tuple(map(unflatten_batch, output)) if isinstance(output, tuple) else unflatten_batch(output)


def broadcast_shapes(*shapes: Sequence[int]) -> Sequence[int]:
    """The shape that all `shapes` broadcast to.

    Equal shapes, the usual case, do not call torch.broadcast_shapes, which takes as long as a kernel on few points.
    """
    common = shapes[0] if len(shapes[0]) else shapes[-1]
    return common if all(s == common or len(s) == 0 for s in shapes) else torch.broadcast_shapes(*shapes)


def expand_to_batch(x: Tensor, leading: Sequence[int], axes: int) -> Tensor:
    """Expand x (*, ...) to the axes `leading` and flatten these; the last `axes` axes of `x` are those of one sample.

    One sample for the whole batch is not expanded: the result has a batch of size 1.
    """
    sample_shape = x.shape[x.dim() - axes :]
    if x.dim() == axes or x.numel() == sample_shape.numel():
        return x.reshape(1, *sample_shape)
    return x.expand(*leading, *sample_shape).reshape(prod(leading), *sample_shape)


def flatten_batch(image: Tensor) -> Tensor:
    """(*, C, H, W) as (B, C, H, W)."""
    return image if image.dim() == 4 else image.unsqueeze(0).flatten(0, -4)
