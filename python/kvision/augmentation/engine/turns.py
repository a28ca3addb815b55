"""Execution where each sample of a batch has children of its own.

A turn is a run of children for the samples that want it at that point, which are one batch. `plan_turns` puts the sequences of all
samples into as few turns as they need, and nothing runs that no sample wants. Samples may have different sizes between turns:
`SampleRows` keeps them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import accumulate, chain
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision.augmentation.engine.augmentation import AugmentationBase
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.lists import SizeOfEach, with_sides
from kvision.augmentation.engine.record import Child
from kvision.augmentation.engine.runs import execute
from kvision.augmentation.engine.stages import Chain, Stage
from kvision.augmentation.sample_rows import SampleRows, index_of, is_channels_last, numbers_by, read_rows
from kvision.augmentation.warp_and_color import SAME
from kvision.core.exceptions import ShapeError, ValueCheckError

# --- the plan -------------------------------------------------------------------------------------------------------


class Wanted(NamedTuple):
    """What samples want together: its number among what they choose from, and how often they have had it before."""

    number: int
    occurrence: int
    samples: list[int]


def plan_turns(sequences: Sequence[Sequence[int]]) -> list[Wanted]:
    """Turns in which each sample has its sequence of numbers.

    The next turn is that of the number that the fewest samples want behind another one, of those the one that most want now. So
    sequences in ascending order take each number once.
    """
    pending = [
        ([(number, sequence[:i].count(number)) for i, number in enumerate(sequence)], samples)
        for sequence, samples in numbers_by(map(tuple, sequences)).items()
    ]
    turns: list[Wanted] = []
    while pending := [(wanted, samples) for wanted, samples in pending if wanted]:
        now: dict[tuple[int, int], int] = {}
        later: dict[tuple[int, int], int] = {}
        for wanted, samples in pending:
            now[wanted[0]] = now.get(wanted[0], 0) + len(samples)
            for other in wanted[1:]:
                later[other] = later.get(other, 0) + len(samples)
        turn = min(now, key=lambda wanted: (later.get(wanted, 0), -now[wanted], wanted))
        own = [samples for wanted, samples in pending if wanted[0] == turn]
        turns.append(Wanted(*turn, own[0] if len(own) == 1 else sorted(chain(*own))))
        pending = [(wanted[1:] if wanted[0] == turn else wanted, samples) for wanted, samples in pending]
    return turns


# --- execution ------------------------------------------------------------------------------------------------------


class Turn(NamedTuple):
    """Children that run one after the other for some samples of a batch."""

    children: Sequence[Child]
    samples: Sequence[int]
    position: int = 0  # of the first child in the chain, under a seed, on which the draws of a sample depend
    parts: Sequence[Sequence[int]] | None = None  # the samples of each child, where each sample gets one of them alone


def turns_of(
    units: Sequence[Sequence[Child]], sequences: Sequence[Sequence[int]], frames: int, position: int
) -> list[Turn]:
    """The turns of samples, each of which gets units of children by their numbers, and has `frames` neighboring rows of a batch."""
    firsts = list(accumulate(map(len, units), initial=position))
    turns = []
    for number, occurrence, samples in plan_turns(sequences):
        rows = samples if frames == 1 else [sample * frames + i for sample in samples for i in range(frames)]
        turns.append(Turn(units[number], rows, firsts[number] + (firsts[-1] - position) * occurrence))
    return turns


def execute_turns(x: Tensor, turns: Sequence[Turn], context: CallContext) -> tuple[Tensor, list[Stage], list[Child]]:
    """Run turns on images (B, C, H, W); gives the result, what labels have to follow, and the children with their samples.

    Seeds of the context are those of neighboring rows of the batch, as many rows for each.
    """
    if not x.is_contiguous() and not is_channels_last(x):
        x = x.contiguous()  # other strides would be those of some groups of samples and not of others
    rows, batch = SampleRows(x), len(x)
    stages: list[Stage] = []
    executed: list[Child] = []
    for turn in turns if not batch else ():
        children = [replace(child, samples=[], batch=0) for child in turn.children]
        own = context._replace(output=SAME, labels=None)
        x, done = execute(x, children if turn.parts is None else children[:1], own, turn.position)
        stages, executed = [*stages, *done], [*executed, *children]
    if not batch:
        return context.converted(x), stages, executed
    for turn in turns:
        for samples in rows.by_size(turn.samples):
            labels, size = context.labels, _size_of_all(rows, x)
            if labels is not None:
                labels = labels.of_samples(_wrap(stages, samples, x, size), samples)
            own = context._replace(output=SAME, labels=labels, seed=seed_of(context.seed, samples, batch))
            children = [replace(child, samples=samples, batch=batch) for child in turn.children]
            source = rows.take(samples)
            if turn.parts is None:
                y, done = execute(source, children, own, turn.position)
            else:
                y, done, children = _execute_parts(source, turn, own, children)
            rows.put(samples, y)
            stages += done if len(samples) == batch else [SomeSamples(done, samples, batch, size, x.device)]
            executed += children
    sizes = [rows.size_of(group[0]) for group in rows.by_size(range(batch))]
    if len(sizes) > 1:
        raise ShapeError(
            f"{context.op}: expected children that give all samples one size, got {sizes[0]} and {sizes[1]}"
        )
    y = context.converted(rows.take(range(batch)))
    has_parts = any(isinstance(stage, SomeSamples) for stage in stages)
    return y, [Turns(stages)] if has_parts else stages, executed


def _execute_parts(
    x: Tensor, turn: Turn, context: CallContext, children: Sequence[Child]
) -> tuple[Tensor, list[Stage], list[Child]]:
    """Run children of which each sample gets one as one run, in which the others change nothing."""
    assert turn.parts is not None
    is_whole = len(x) == children[0].batch
    row_of = range(len(x)) if is_whole else {sample: row for row, sample in enumerate(turn.samples)}
    owners = [0] * len(x)
    for number, (child, samples) in enumerate(zip(children, turn.parts)):
        child.samples, child.rows = samples, samples if is_whole else [row_of[sample] for sample in samples]
        for row in child.rows:
            owners[row] = number
    owner = torch.tensor(owners, device="cpu")
    y, stages = execute(x, children, context._replace(once=True, owners=owner), turn.position)
    return y, stages, [child for child in children if child.samples]


def joins(module: Any, shape: tuple[int, ...]) -> Any:
    """What says which augmentations of images of a shape are one run of a pass if each sample gets one of them; None for none.

    These are those that change colors, and those that read the image at a matrix in the same way: a run multiplies the matrices, of
    which all but one are the identity. Those that permute pixels read in any way, for which True stands.
    """
    if not isinstance(module, AugmentationBase) or module.whole_batch or module.needs_masks or module.fuses_noise:
        return None
    if module._derives:  # columns that the others of a run would have to leave as they are
        return None
    contribution = module._contribution(shape, module.flags)
    if contribution is None or not module.has_known_size or len(shape) != module.axes + 1 != 4:
        return None
    if contribution.colors is not None:
        return "colors" if module._result_dtype(torch.uint8) == torch.uint8 else None
    motion = contribution.motion
    if motion is None or motion.is_map or motion.is_antialiased or tuple(motion.size) != tuple(shape[2:]):
        return None
    if motion.permutes_pixels:
        return True
    return motion.resampling if isinstance(motion.resampling.fill, (int, float, type(None))) else None


def _size_of_all(rows: SampleRows, x: Tensor) -> Any:
    """The size of the samples of images like x; of images of several sizes (B, 1) of each, None of volumes."""
    samples = range(len(x))
    if len(rows.by_size(samples)) == 1:
        return rows.size_of(0)
    return SizeOfEach([n for i in samples for n in rows.size_of(i)], x.device) if x.dim() == 4 else None


def _wrap(before: Sequence[Stage], samples: Sequence[int], x: Tensor, size: Any) -> Callable[[list[Stage]], Stage]:
    """What stages of some samples of images like x are for all, after the turns before them."""
    earlier = list(before)
    return lambda stages: Turns([*earlier, SomeSamples(stages, samples, len(x), size, x.device)], samples)


def seed_of(seed: Any, rows: Sequence[int], batch: int) -> Any:
    """The seeds of rows of a batch."""
    if not isinstance(seed, Tensor) or seed.dim() == 0:
        return seed
    frames = batch // len(seed)
    return read_rows(seed, [row // frames for row in rows[::frames]])


# --- what labels follow ---------------------------------------------------------------------------------------------


class SomeSamples(Chain):
    """What was done to some samples of a batch. The others kept their positions.

    Args:
        stages: of those samples alone.
        samples: their numbers in the batch.
        batch: how many samples there are.
        size: of all samples before it, a number or (B, 1) an axis; None where it is not known.
        device: of these.
    """

    def __init__(
        self,
        stages: Sequence[Stage],
        samples: Sequence[int],
        batch: int,
        size: Any = None,
        device: torch.device | None = None,
    ) -> None:
        super().__init__(stages)
        self.samples, self.batch, self.size, self._device = samples, batch, size, device

    def source_size(self) -> Any:
        return self.size

    def members(self) -> Sequence[int]:
        each = [stage.members() for stage in self.stages]
        if any(own is None for own in each):
            return self.samples
        return [self.samples[i] for i in sorted({i for own in each for i in own or ()})]

    def maps(self) -> list[Tensor | None]:
        moved: list[Tensor | None] = []
        for chosen in super().maps():
            index = torch.tensor(self.samples, device="cpu" if chosen is None else chosen.device)
            all_samples = torch.zeros(self.batch, dtype=torch.bool, device=index.device)
            moved.append(all_samples.index_copy(0, index, torch.ones_like(index).bool() if chosen is None else chosen))
        return moved

    def move_points(self, points: Tensor) -> Tensor:
        return self._replaced(points, super().move_points)

    def move_points_back(self, points: Tensor) -> Tensor:
        return self._replaced(points, super().move_points_back)

    def keeps_centers(self, centers: Tensor) -> Tensor | None:
        own = Chain(self.stages).keeps_centers(read_rows(centers, self.samples))
        if own is None:
            return None
        everything = torch.ones(centers.shape[:2], dtype=torch.bool, device=own.device)
        return everything.index_copy(0, index_of(self.samples, own), own)

    def product(self, matrix: Tensor) -> Tensor:
        return self._replaced(matrix, super().product)

    def _replaced(self, x: Tensor, move: Callable[[Tensor], Tensor]) -> Tensor:
        """`x` (B, ...) with the samples moved."""
        moved = move(read_rows(x, self.samples))
        return x.to(moved).index_copy(0, index_of(self.samples, moved), moved)

    def flat(self) -> list[Stage]:
        parts: list[Stage] = []
        for part in super().flat():
            parts.append(SomeSamples([part], self.samples, self.batch, self._size_before(part), self._device))
        return parts

    def _size_before(self, part: Stage) -> Any:
        """The size of all samples before one of the stages."""
        own, size = part.source_size(), self.size
        if own is None or size is None or own == size:
            return size
        if self._device is None or len(own) != 2:
            return None
        of_all, of_some = SizeOfEach.sides_of(size, self.batch), SizeOfEach.sides_of(own, len(self.samples))
        return SizeOfEach(with_sides(of_all, self.samples, of_some), self._device)


class Turns(Chain):
    """The stages of turns, between which samples may have different sizes.

    Args:
        stages: those of all samples, and of some of them.
        wanted: the samples that are asked for; others may have another size now, and are zeros. None for all.
    """

    def __init__(self, stages: Sequence[Stage], wanted: Sequence[int] | None = None) -> None:
        super().__init__(stages)
        self.wanted = wanted

    def concerns_all(self, has_boxes: bool) -> bool:
        if super().concerns_all(has_boxes):  # nothing here mixes samples
            raise ValueCheckError(
                "AugmentationSequential: expected containers that filter no boxes inside of a choice of each sample; filter them "
                "in the container around it"
            )
        return False

    def _through(self, x: Tensor, stages: Sequence[Stage], move: Callable[[Stage, Tensor], Tensor]) -> Tensor:
        """The same, where each stage moves its samples."""
        rows = SampleRows(x)
        everything = range(len(x))
        for stage in stages:
            samples: Sequence[int] = everything
            if isinstance(stage, SomeSamples):
                samples, stage = stage.samples, Chain(stage.stages)
            rows.put(samples, move(stage, rows.take(samples)))
        if self.wanted is None or not len(x):
            return rows.take(everything) if len(x) else x
        y = rows.take(self.wanted)
        return y.new_zeros(len(x), *y.shape[1:]).index_copy(0, index_of(self.wanted, y), y)
