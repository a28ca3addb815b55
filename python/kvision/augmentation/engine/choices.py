"""Which children of a container run, where `random_apply` draws them: for the batch, or for each sample by its seed.

With a seed for each sample the children of a sample do not depend on the batch. A child then runs on the whole batch, one launch
for all samples that want it at that point, and the others keep what they had. `plan_turns` puts the sequences of all samples into
one sequence of such turns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from kvision.augmentation.draws import philox, unit
from kvision.augmentation.engine.augmentation import AugmentationBase
from kvision.augmentation.engine.record import Child
from kvision.augmentation.engine.runs import CallContext, execute
from kvision.augmentation.engine.stages import Chain, Stage
from kvision.augmentation.samples import where_chosen
from kvision.augmentation.warp_and_color import SAME, make_pass
from kvision.core.exceptions import ShapeError
from kvision.core.pixels import to_unit

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


class Turn(NamedTuple):
    """A run of one child on the samples that want it next."""

    child: int  # its number
    occurrence: int  # how often these samples have had it before
    samples: list[bool]


def plan_turns(sequences: Sequence[Sequence[int]]) -> list[Turn]:
    """Turns in which each sample has its sequence of children. Each turn is that of the child that most samples want next."""
    wanted = [[(child, sequence[:i].count(child)) for i, child in enumerate(sequence)] for sequence in sequences]
    turns: list[Turn] = []
    while any(wanted):
        counts = Counter(own[0] for own in wanted if own)
        most = min(counts, key=lambda turn: (-counts[turn], turn))
        samples = [own[:1] == [most] for own in wanted]
        turns.append(Turn(*most, samples))
        wanted = [own[1:] if is_next else own for own, is_next in zip(wanted, samples)]
    return turns


def execute_turns(
    x: Tensor,
    named: Sequence[tuple[str, nn.Module]],
    sequences: Sequence[Sequence[int]],
    context: CallContext,
    position: int,
) -> tuple[Tensor, Chain, list[Child]]:
    """Run the sequence of children of each sample; gives the result, what labels have to follow, and the turns as children.

    The position in the chain of a child is its number, so that what a sample draws does not depend on the turns of others.
    """
    frames = len(x) // max(len(sequences), 1)  # neighboring samples of one seed
    if x.dtype == torch.uint8 and any(_leaves_bytes(module) for _, module in named):
        x = to_unit(x)  # for all batches, whoever wants that child
    stages: list[Stage] = []
    children: list[Child] = []
    for number, occurrence, samples in plan_turns(sequences):
        child = Child(*named[number], runs_alone=True)
        at = position + number + len(named) * occurrence
        y, more = execute(x, [child], context._replace(output=SAME), at)
        if not all(samples):
            if y.shape != x.shape:
                raise ShapeError(
                    f"{context.op}: expected children that keep the size of images with random_apply and seeds of samples, "
                    f"got {tuple(y.shape)} from {tuple(x.shape)}"
                )
            chosen = torch.tensor(samples, device="cpu").repeat_interleave(frames)
            y = where_chosen(chosen.to(x.device), y, x if x.dtype == y.dtype else to_unit(x))
            more = more.restricted(chosen)
            child.restrict(chosen)
        x = y
        stages += more.stages
        children.append(child)
    if context.output != SAME:
        x, _ = make_pass(None, output=context.output).run(x, None)
    return x, Chain(stages), children


def _leaves_bytes(module: nn.Module) -> bool:
    own = (part for part in module.modules() if isinstance(part, AugmentationBase))
    return any(part._result_dtype(torch.uint8) != torch.uint8 for part in own)
