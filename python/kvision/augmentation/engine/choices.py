"""Which children of a container run, where `random_apply` draws them: for the batch, or for each sample by its seed.

With a seed for each sample the children of a sample do not depend on the batch; turns.py executes them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from kvision.augmentation.draws import philox, unit

_CHOICE = 1 << 20  # the position in the chain of draws that choose children


class Choices(NamedTuple):
    """What `random_apply` says: so many children at least, fewer than `end`, with relative probabilities."""

    low: int
    end: int
    weights: Sequence[float]
    mixes: Sequence[bool]  # of each child, whether it mixes samples: at most one of these runs

    def of_key(self, key: int, with_mix: bool = True) -> list[int]:
        """The numbers of the children for a key."""
        return self._chosen((unit(philox(key, (i, 0, 0, _CHOICE))[0]) for i in range(self._count)), with_mix)

    def of_seeds(self, seeds: Tensor) -> list[list[int]]:
        """The numbers of the children of each sample, for seeds (B,): as `of_key` of each."""
        if seeds.device.type != "cpu":
            seeds = seeds.cpu()
        index = torch.arange(self._count, device="cpu")
        words = unit(philox(seeds[:, None], (index, 0, torch.zeros_like(index), _CHOICE))[0])
        return [self._chosen(iter(row), True) for row in words.tolist()]

    @property
    def _count(self) -> int:
        return 2 * (self.end + len(self.weights)) + 2

    def _chosen(self, words: Iterator[float], with_mix: bool) -> list[int]:
        count = self.low + int(next(words) * (self.end - self.low))
        chosen: list[int] = []
        left, mixed = list(self.weights), False
        for _ in range(count):
            if sum(left) == 0:  # with replacement
                left = list(self.weights)
            at = _pick(left, next(words))
            left[at] = 0.0
            if self.mixes[at] and (mixed or not with_mix):
                continue
            mixed = mixed or self.mixes[at]
            chosen.append(at)
        return chosen


def _pick(weights: Sequence[float], u: float) -> int:
    """The index at which the sum of weights passes `u` of the total."""
    target, total = u * sum(weights), 0.0
    for i, weight in enumerate(weights):
        total += weight
        if target < total:
            return i
    return max(i for i, weight in enumerate(weights) if weight)
