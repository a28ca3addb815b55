"""A benchmark case: a call, the bytes it must move, the same work in the peers' API, and its performance bars.

A file in benchmarks/cases/ lists the cases of one module. No other list names them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

Size = tuple[int, ...]
Traffic = Callable[[Sequence[Tensor], Sequence[Tensor]], int]


def photographs(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    """A batch of this size in [0, 1] with the statistics of photographs, from `dead_leaves`."""
    leaves = dead_leaves(size[-3:]).to(device=device, dtype=dtype)
    batch = torch.empty(size, dtype=dtype, device=device)
    for index, sample in enumerate(batch):  # samples are shifts of one image, so that gigabytes are quick to make
        sample.copy_(leaves.roll((7 * index, 13 * index), (-2, -1)))
    return (batch,)


@lru_cache(maxsize=4)
def dead_leaves(size: Size, leaves: int = 400) -> Tensor:
    """A (C, H, W) image of overlapping discs, many small and few large, with a little sensor noise.

    Like a photograph it has flat regions, sharp edges and structure at every scale. White noise would be all edges,
    which is unrealistic for an edge detector and the worst case of every median.
    """
    channels, height, width = size
    random = torch.Generator().manual_seed(0)
    picture = torch.full(size, 0.5)
    for y, x, shrink, *color in torch.rand(leaves, 3 + channels, generator=random).tolist():
        radius = max(1.0, 0.25 * max(height, width) * (1 - shrink) ** 2)
        y, x = y * height, x * width
        top, left = max(0, int(y - radius)), max(0, int(x - radius))
        box = picture[:, top : int(y + radius) + 1, left : int(x + radius) + 1]
        rows = torch.arange(box.shape[1]).unsqueeze(1) + (top - y)
        columns = torch.arange(box.shape[2]) + (left - x)
        box[:, rows**2 + columns**2 <= radius**2] = torch.tensor(color).unsqueeze(1)
    return (picture + 0.01 * torch.randn(size, generator=random)).clamp(0, 1)


def nbytes(tensors: Sequence[Tensor]) -> int:
    return sum(t.numel() * t.element_size() for t in tensors)


def forward_traffic(inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> int:
    """Bytes of a forward: inputs are read once and outputs are written once."""
    return nbytes(inputs) + nbytes(outputs)


def linear_backward(inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> int:
    """Bytes of a linear map's backward: the output's gradient is read and the input's gradient is written."""
    return nbytes(outputs) + nbytes(inputs)


def nonlinear_backward(inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> int:
    """Bytes of any other backward: those of a linear one, and the input is read again."""
    return linear_backward(inputs, outputs) + nbytes(inputs)


@dataclass(frozen=True)
class Bars:
    """Performance limits of a case. `None` sets no limit. README.md defines what each is measured against.

    On a GPU: `floor` and `both` bound forward and forward + backward as multiples of their floors, `backward` bounds
    the backward as a multiple of the forward's time, `launches` the kernels of a forward, `half` is the minimum
    speed-up of float16 over float32. On a CPU: `opencv` and `kornia` bound the forward by multiples of a peer's time.
    """

    floor: float | None = None
    both: float | None = None
    backward: float | None = None
    launches: int | None = 1
    half: float | None = None
    opencv: float | None = None
    kornia: float | None = 1.0


@dataclass(frozen=True)
class Case:
    """A benchmark: one task as a call of kvision and as calls of its peers.

    `call` is kvision's public call on the tensors of `inputs(size, dtype, device)`; the first one gets the gradient.
    `peers` maps a peer's name to the same task in its API; peers.py defines its arguments. `result` selects the tensor
    to compare where a call returns several. `forward` and `backward` give the bytes of the two passes.
    """

    name: str
    call: Callable[..., Any]
    peers: Mapping[str, Callable[..., Any]] = field(default_factory=dict)
    bars: Bars = Bars()
    inputs: Callable[[Size, torch.dtype, torch.device], tuple[Tensor, ...]] = photographs
    result: Callable[[Any], Tensor] = lambda output: output
    forward: Traffic = forward_traffic
    backward: Traffic = linear_backward
    border: int = 1  # border width in pixels within which a peer's border rule may differ
