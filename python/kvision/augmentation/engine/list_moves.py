"""What the labels of a list of images follow: passes over all of its images, and the sizes of these in between."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._dtype import as_dtype, compute_dtype
from kvision.augmentation.engine.lists import OnList, SizeOfEach, WarpOfList
from kvision.augmentation.engine.passes import Joined
from kvision.augmentation.engine.sized import ImagesOfList
from kvision.augmentation.engine.stages import Stage
from kvision.augmentation.sample_rows import index_of
from kvision.augmentation.transforms import transform_matrix
from kvision.augmentation.warp_and_color import Resampling


class LabelStep(NamedTuple):
    """What labels follow in a run on a list: one warp, or an augmentation that runs by itself.

    Attributes:
        numbers: its augmentations, by their numbers in the run; none of a policy, whose steps have matrices.
        matrix: (B, 3, 3); None for an augmentation that leaves labels, or changes them by its own methods.
        resampling: of images; None for one augmentation, which says how it reads masks.
        before: height and width of each image before it.
        after: those of its results.
    """

    numbers: Sequence[int]
    matrix: Tensor | None
    resampling: Resampling | None
    before: Sequence[int]
    after: Sequence[int]


def label_steps(
    modules: Sequence[Any],
    calls: Iterable[Any],
    steps: Sequence[Any],
    columns: Tensor | None,
    of_list: ImagesOfList,
    like: Tensor,
) -> list[LabelStep]:
    """What labels follow of a run on images like a batch, in its order.

    `calls` say which augmentations are applied, and to images of which shape.
    """
    columns = as_dtype(like.new_empty(len(like), 0) if columns is None else columns, compute_dtype(like))
    sides, own = list(of_list.sides), of_list.sized.own
    step_of = {n: s for s in steps for n in (s.geometric if isinstance(s, Joined) else [s.number])}
    found: list[LabelStep] = []
    for number, (module, (applies, shape)) in enumerate(zip(modules, calls)):
        step, resampling = step_of.get(number), None
        numbers: Sequence[int] = [number]
        if isinstance(step, Joined):
            numbers, resampling = step.geometric, step.resampling if len(step.geometric) > 1 else None
        if step is None or not applies or numbers[0] != number:
            continue
        after = sides
        if numbers[-1] >= own and not module.keeps_positions:
            size = step.size if isinstance(step, Joined) else module.output_shape(shape, module.flags)[2:]
            after = [*size] * len(like)
        elif of_list.sized.changes(numbers):
            after = of_list.sized.sides_after(numbers, sides)
        matrix = transform_matrix(columns, step.chain) if step.chain else None
        found.append(LabelStep(numbers, matrix, resampling, sides, after))
        sides = after
    return found


class Move(NamedTuple):
    """A step on some images of a list: all, where `samples` is None. `before` has height and width of all before it."""

    matrix: Tensor | None
    before: Sequence[int]
    samples: Sequence[int] | None = None


class Moves(NamedTuple):
    """What boxes and points of a list of images follow, and height and width of the results."""

    moves: Sequence[Move]
    after: Sequence[int]

    def stages(self, device: torch.device) -> tuple[list[Stage], SizeOfEach]:
        """The same as stages of all images, and the sizes of results."""
        count = len(self.after) // 2
        has_moved, is_partial = [False] * count, any(move.samples is not None for move in self.moves)
        stages: list[Stage] = []
        for matrix, before, samples in self.moves:
            bounds: list[bool] | None = None
            if is_partial:
                members = range(count) if samples is None else samples
                bounds = [False] * count
                for i in members:
                    bounds[i], has_moved[i] = has_moved[i], True
            sizes = SizeOfEach(before, device, bounds)
            if matrix is None:
                stages.append(OnList(sizes))
                continue
            if samples is not None:
                identity = torch.eye(3, dtype=matrix.dtype, device=matrix.device).expand(count, 3, 3)
                matrix = identity.index_copy(0, index_of(samples, matrix), matrix)
            stages.append(WarpOfList(sizes, matrix))
        return stages, SizeOfEach(self.after, device, has_moved if is_partial else None)


def moves_of_run(run: Any) -> Moves | None:
    """Those of a run on a list; None where labels do not follow the matrices of its warps, or one removes boxes."""
    moves: list[Move] = []
    sides = run.sides
    for step in run.label_steps:
        for module in [run.modules[n] for n in step.numbers]:
            by_matrix = step.matrix is not None and module._warps_points and not module.removes_boxes
            if not (module.keeps_positions or by_matrix):
                return None
        moves.append(Move(step.matrix, step.before))
        sides = step.after
    return Moves(moves, sides)


def joined_moves(sides: Sequence[int], parts: Iterable[tuple[Sequence[int], Moves | None]]) -> Moves | None:
    """The moves of images of these sizes of which each part has moved some, one after the other."""
    moves: list[Move] = []
    for samples, own in parts:
        if own is None:
            return None
        if 2 * len(samples) == len(sides):
            moves, sides = [*moves, *own.moves], own.after
            continue
        for matrix, before, inner in own.moves:
            places = samples if inner is None else [samples[i] for i in inner]
            moves.append(Move(matrix, with_sides(sides, samples, before), places))
        sides = with_sides(sides, samples, own.after)
    return Moves(moves, sides)


def with_sides(sides: Sequence[int], samples: Sequence[int], own: Sequence[int]) -> list[int]:
    """Height and width of each image with those of some replaced."""
    every = list(sides)
    for place, i in enumerate(samples):
        every[2 * i : 2 * i + 2] = own[2 * place : 2 * place + 2]
    return every
