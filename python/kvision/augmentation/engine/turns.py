"""Execution where each sample of a batch has children of its own.

A turn is a run of children for the samples that want it at that point, which are one batch. `plan_turns` puts the sequences of all
samples into as few turns as they need, and nothing runs that no sample wants. Samples may have different sizes between turns:
`SampleRows` keeps them as rows of the tensors that turns gave, and reads them together again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import accumulate, chain
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._ops import FastPath
from kvision._torch_compat import in_function_transform
from kvision.augmentation.engine.augmentation import AugmentationBase
from kvision.augmentation.engine.record import Child
from kvision.augmentation.engine.runs import CallContext, execute
from kvision.augmentation.engine.stages import Chain, MaskReading, Stage
from kvision.augmentation.warp_and_color import SAME, make_pass
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.core.pixels import to_unit

# Rows of batches (B, C, H, W) of one size and type as one batch, by their numbers as if these were one.
_copy_rows = FastPath(
    "copy_rows", (torch.float32, torch.float64, torch.float16, torch.bfloat16, torch.uint8, torch.int64, torch.bool)
)

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
    groups: dict[tuple[int, ...], list[int]] = {}
    for sample, sequence in enumerate(sequences):
        groups.setdefault(tuple(sequence), []).append(sample)
    pending = [
        ([(number, sequence[:i].count(number)) for i, number in enumerate(sequence)], samples)
        for sequence, samples in groups.items()
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


# --- samples of different sizes -------------------------------------------------------------------------------------


class SampleRows:
    """The samples of a batch, each a row of a tensor: first of the batch itself, then of what turns gave.

    Args:
        x: images, masks or what else has a row of each sample.
    """

    def __init__(self, x: Tensor) -> None:
        self._whole: Tensor | None = x  # while all samples are the rows of one tensor
        self._count = len(x)
        self._at: list[tuple[Tensor, int]] = []

    def by_size(self, samples: Sequence[int]) -> list[list[int]]:
        """The samples in groups of one size."""
        if self._whole is not None:
            return [list(samples)] if samples else []
        groups: dict[torch.Size, list[int]] = {}
        for sample in samples:
            groups.setdefault(self._at[sample][0].shape[1:], []).append(sample)
        return list(groups.values())

    def size_of(self, sample: int) -> tuple[int, ...]:
        """Height and width of a sample; depth, height and width of volumes."""
        return tuple((self._at[sample][0] if self._whole is None else self._whole).shape[2:])

    def take(self, samples: Sequence[int]) -> Tensor:
        """The samples, which have one size, as a batch."""
        if self._whole is not None:
            return read_rows(self._whole, samples)
        parts: dict[int, tuple[Tensor, list[int], list[int]]] = {}
        for at, sample in enumerate(samples):
            tensor, row = self._at[sample]
            _, rows, positions = parts.setdefault(id(tensor), (tensor, [], []))
            rows.append(row)
            positions.append(at)
        tensors = [read_rows(tensor, rows) for tensor, rows, _ in parts.values()]
        if len(tensors) == 1:
            return tensors[0]
        if len({tensor.dtype for tensor in tensors}) > 1:
            tensors = [to_unit(tensor) if tensor.dtype == torch.uint8 else tensor for tensor in tensors]
        return _interleaved(tensors, [positions for _, _, positions in parts.values()])

    def put(self, samples: Sequence[int], y: Tensor) -> None:
        """Let the samples, in ascending order, be the rows of `y`."""
        if len(samples) == self._count:
            self._whole, self._at = y, []
            return
        if self._whole is not None:
            whole, self._whole = self._whole, None
            self._at = [(whole, row) for row in range(self._count)]
        for row, sample in enumerate(samples):
            self._at[sample] = y, row


def read_rows(x: Tensor, rows: Sequence[int]) -> Tensor:
    """Rows of `x` as a batch of the same layout: `x` itself or a view where they follow each other."""
    first, count = rows[0], len(rows)
    if rows[-1] - first == count - 1 and all(row == first + i for i, row in enumerate(rows)):
        return x if count == len(x) else x[first : first + count]
    if x.dim() == 4 and _copy_rows.serves(x):
        copied: Tensor = _copy_rows.kernel([x], list(rows))
        return copied
    index = _index(rows, x)
    if _is_channels_last(x):
        return x.permute(0, 2, 3, 1).index_select(0, index).permute(0, 3, 1, 2)
    return x.index_select(0, index)


def _is_channels_last(x: Tensor) -> bool:
    return x.dim() == 4 and not x.is_contiguous() and x.is_contiguous(memory_format=torch.channels_last)


def _index(rows: Sequence[int], like: Tensor) -> Tensor:
    return torch.tensor(rows, device="cpu").to(like.device, non_blocking=True)


def _interleaved(tensors: Sequence[Tensor], positions: Sequence[Sequence[int]]) -> Tensor:
    """One batch of the rows of tensors, which come to these positions."""
    first, dtype = tensors[0], tensors[0].dtype
    if first.dim() == 4 and all(tensor.dtype == dtype and _copy_rows.serves(tensor) for tensor in tensors):
        rows_of_positions = sorted((at, row) for row, at in enumerate(chain(*positions)))
        copied: Tensor = _copy_rows.kernel(list(tensors), [row for _, row in rows_of_positions])
        return copied
    has_one_type = all(tensor.dtype == dtype for tensor in tensors)
    needs_graph = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)
    if needs_graph or not has_one_type or in_function_transform():
        order = torch.tensor([at for part in positions for at in part], device="cpu").argsort()
        return read_rows(torch.cat(list(tensors)), order.tolist())
    layout = torch.channels_last if _is_channels_last(first) else torch.contiguous_format
    shape = (sum(map(len, positions)), *first.shape[1:])
    y = torch.empty(shape, dtype=dtype, device=first.device, memory_format=layout)
    for tensor, rows in zip(tensors, positions):
        y.index_copy_(0, _index(rows, y), tensor)
    return y


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


def execute_turns(x: Tensor, turns: Sequence[Turn], context: CallContext) -> tuple[Tensor, Chain, list[Child]]:
    """Run turns on images (B, C, H, W); gives the result, what labels have to follow, and the children with their samples.

    Seeds of the context are those of neighboring rows of the batch, as many rows for each.
    """
    if x.dtype == torch.uint8 and any(_leaves_bytes(child.module) for turn in turns for child in turn.children):
        x = to_unit(x)  # for all batches, whoever wants that child
    if not x.is_contiguous() and not _is_channels_last(x):
        x = x.contiguous()  # other strides would be those of some groups of samples and not of others
    rows, batch = SampleRows(x), len(x)
    stages: list[Stage] = []
    executed: list[Child] = []
    for turn in turns:
        for samples in rows.by_size(turn.samples):
            labels = (
                None if context.labels is None else context.labels.of_samples(_wrap(stages, samples, batch), samples)
            )
            own = context._replace(output=SAME, labels=labels, seed=_seed_of(context.seed, samples, batch))
            children = [replace(child, samples=samples, batch=batch) for child in turn.children]
            source = rows.take(samples)
            if turn.parts is None:
                y, stage = execute(source, children, own, turn.position)
            else:
                y, stage, children = _execute_parts(source, turn, own, children)
            rows.put(samples, y)
            size = tuple(x.shape[2:]) if source.shape[2:] == x.shape[2:] else None
            stages += stage.stages if len(samples) == batch else [SomeSamples(stage, samples, batch, size)]
            executed += children
    sizes = [rows.size_of(group[0]) for group in rows.by_size(range(batch))]
    if len(sizes) > 1:
        raise ShapeError(
            f"{context.op}: expected children that give all samples one size, got {sizes[0]} and {sizes[1]}"
        )
    y = rows.take(range(batch)) if batch else x
    if context.output != SAME:
        y, _ = make_pass(None, output=context.output).run(y, None)
    has_parts = any(isinstance(stage, SomeSamples) for stage in stages)
    return y, Chain([Turns(stages)] if has_parts else stages), executed


def _execute_parts(
    x: Tensor, turn: Turn, context: CallContext, children: Sequence[Child]
) -> tuple[Tensor, Chain, list[Child]]:
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
    y, stage = execute(x, children, context._replace(once=True, owners=owner), turn.position)
    return y, stage, [child for child in children if child.samples]


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


def _wrap(before: Sequence[Stage], samples: Sequence[int], batch: int) -> Callable[[list[Stage]], Stage]:
    """What stages of some samples are for all, after the turns before them."""
    earlier = list(before)
    return lambda stages: Turns([*earlier, SomeSamples(Chain(stages), samples, batch, None)])


def _seed_of(seed: Any, rows: Sequence[int], batch: int) -> Any:
    """The seeds of rows of a batch."""
    if not isinstance(seed, Tensor) or seed.dim() == 0:
        return seed
    frames = batch // len(seed)
    return read_rows(seed, [row // frames for row in rows[::frames]])


def _leaves_bytes(module: Any) -> bool:
    own = (part for part in module.modules() if isinstance(part, AugmentationBase))
    return any(part._result_dtype(torch.uint8) != torch.uint8 for part in own)


# --- what labels follow ---------------------------------------------------------------------------------------------


class SomeSamples(Stage):
    """What a stage did to some samples of a batch. The others kept their positions.

    Args:
        stage: of those samples alone.
        samples: their numbers in the batch.
        batch: how many samples there are.
        size: of the images of all samples before it; None where they had several sizes.
    """

    def __init__(self, stage: Stage, samples: Sequence[int], batch: int, size: tuple[int, ...] | None) -> None:
        self.stage, self.samples, self.batch, self.size = stage, samples, batch, size

    @property
    def keeps_lines(self) -> bool:
        return self.stage.keeps_lines

    @property
    def changes_boxes(self) -> bool:
        return self.stage.changes_boxes

    @property
    def removes_boxes(self) -> bool:
        return self.stage.removes_boxes

    def source_size(self) -> tuple[int, ...] | None:
        return self.size

    def maps(self) -> list[Tensor | None]:
        moved: list[Tensor | None] = []
        for chosen in self.stage.maps():
            index = torch.tensor(self.samples, device="cpu" if chosen is None else chosen.device)
            all_samples = torch.zeros(self.batch, dtype=torch.bool, device=index.device)
            moved.append(all_samples.index_copy(0, index, torch.ones_like(index).bool() if chosen is None else chosen))
        return moved

    def move_points(self, points: Tensor) -> Tensor:
        return self._replaced(points, self.stage.move_points)

    def move_points_back(self, points: Tensor) -> Tensor:
        return self._replaced(points, self.stage.move_points_back)

    def keeps_centers(self, centers: Tensor) -> Tensor | None:
        own = self.stage.keeps_centers(read_rows(centers, self.samples))
        if own is None:
            return None
        everything = torch.ones(centers.shape[:2], dtype=torch.bool, device=own.device)
        return everything.index_copy(0, _index(self.samples, own), own)

    def product(self, matrix: Tensor) -> Tensor:
        return self._replaced(matrix, self.stage.product)

    def _replaced(self, x: Tensor, move: Callable[[Tensor], Tensor]) -> Tensor:
        """`x` (B, ...) with the samples moved."""
        moved = move(read_rows(x, self.samples))
        return x.to(moved).index_copy(0, _index(self.samples, moved), moved)

    def flat(self) -> list[Stage]:
        parts: list[Stage] = []
        for part in self.stage.flat():
            size = self.size if part.source_size() in (self.size, None) else None
            parts.append(SomeSamples(part, self.samples, self.batch, size))
        return parts

    def forget(self) -> None:
        self.stage.forget()


class Turns(Chain):
    """The stages of turns, between which samples may have different sizes."""

    def concerns_all(self, has_boxes: bool) -> bool:
        if has_boxes and self.changes_boxes:
            raise ValueCheckError(
                "AugmentationSequential: expected containers that filter no boxes inside of a choice of each sample; filter them "
                "in the container around it"
            )
        return super().concerns_all(has_boxes)

    def move_masks(self, masks: Tensor, reading: MaskReading) -> Tensor:
        return self._through(masks, self.stages, lambda stage, x: stage.move_masks(x, reading))

    def move_masks_back(self, masks: Tensor) -> Tensor:
        return self._through(masks, self.stages[::-1], lambda stage, x: stage.move_masks_back(x))

    def invert(self, x: Tensor) -> Tensor:
        return self._through(x, self.stages[::-1], lambda stage, x: stage.invert(x))

    @staticmethod
    def _through(x: Tensor, stages: Sequence[Stage], move: Callable[[Stage, Tensor], Tensor]) -> Tensor:
        """Images or masks after stages, each of which moves its samples."""
        rows = SampleRows(x)
        everything = range(len(x))
        for stage in stages:
            samples, own = (stage.samples, stage.stage) if isinstance(stage, SomeSamples) else (everything, stage)
            rows.put(samples, move(own, rows.take(samples)))
        return rows.take(everything) if len(x) else x
