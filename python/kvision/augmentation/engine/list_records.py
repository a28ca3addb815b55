"""Records of runs on a list, which are made of the columns of the runs when they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

from torch import Tensor
from torch.compiler import is_compiling

from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.execution import Shape, matrix_type
from kvision.augmentation.engine.label_settings import MaskReading
from kvision.augmentation.engine.list_moves import Moves, joined_moves, moves_of_run
from kvision.augmentation.engine.lists import with_sides
from kvision.augmentation.engine.parts import Parts
from kvision.augmentation.engine.passes import Alone, Running, plan_steps
from kvision.augmentation.engine.record import Child, Record
from kvision.augmentation.engine.runs import replayed
from kvision.augmentation.engine.stages import Chain, Stage
from kvision.augmentation.lists.masks import checked_masks, move_masks


class ListParts(Parts):
    """The parts of runs on a list, whose calls are made of the columns of the runs when they are asked for.

    Each is a ListRun of some of the images, with their numbers.
    """

    def __init__(
        self, op: str, count: int, runs: Sequence[tuple[Sequence[int], Any]], child: int | None = None
    ) -> None:
        self.op, self.count, self._runs, self._child = op, count, runs, child

    @cached_property
    def rows(self) -> list[list[int]]:  # type: ignore[override]
        return [[samples[i] for i in rows] for samples, run in self._runs for rows in run.rows()]

    @cached_property
    def calls(self) -> list[Any]:
        each = [(run, rows) for _, run in self._runs for rows in run.rows()]
        if self._child is None:
            return [run.record(rows) for run, rows in each]
        return [run.executions(rows)[0][self._child] for run, rows in each]

    def params(self, read: Callable[[Any], Any]) -> Any:
        run = self._runs[0][1]
        if self._child == 0 and run.plan.begins_with_batch and len(self._runs) == 1:
            return run.params_of_first()
        return super().params(read)

    @property
    def shape(self) -> tuple[int, ...]:
        run = self._runs[0][1]
        if is_compiling():  # a graph would be one of which image is the largest
            return (self.count, run.shape[1], *run.sides[:2])
        sides = [run.sides for _, run in self._runs]
        return (self.count, run.shape[1], *(max(max(own[axis::2]) for own in sides) for axis in (0, 1)))

    def done(self, i: int) -> tuple[Sequence[Child], Sequence[Stage]]:
        """What an image got, and what its labels have to follow."""
        samples, run = next(run for run in self._runs if i in run[0])
        record = run.record([samples.index(i)])
        return record.children, record.stages.stages

    @property
    def sides(self) -> list[int]:
        """Height and width of each image."""
        sides = [0] * (2 * self.count)
        for samples, run in self._runs:
            sides = with_sides(sides, samples, run.sides)
        return sides

    def moves(self) -> Moves | None:
        """What boxes and points follow; None where they follow the calls of the parts."""
        return joined_moves(self.sides, [(samples, moves_of_run(run)) for samples, run in self._runs])

    def moved_masks(self, masks: Any, reading: MaskReading) -> list[Tensor] | None:
        """Masks (N, h, w) of each image by the launches of a batch; None where they follow the calls of the parts."""
        given = checked_masks(masks, self.sides)
        if given is None:
            return None
        moved = list(given)
        for samples, run in self._runs:
            own = move_masks([given[i] for i in samples], run, reading)
            if own is None:
                return None
            for i, mask in zip(samples, own):
                moved[i] = mask
        return moved

    def of_child(self, number: int) -> ListParts:
        """The calls of an augmentation of the runs."""
        return ListParts(self.op, self.count, self._runs, number)


def record_of_run(
    shape: Shape, children: Sequence[Child], columns: Tensor | None, like: Tensor, context: CallContext
) -> Record:
    """The record of a run on images of a shape, of the type and device of `like`, by the executions of its children."""
    modules: list[Any] = [child.module for child in children]
    executions: list[Any] = [child.record for child in children]
    running = Running(modules, executions, columns, context.has_labels)
    stages: list[Stage] = []
    for step in plan_steps(modules, executions, context.once, like.dtype, context.output):
        if isinstance(step, Alone):
            stages.append(running.applied(step.number))
        elif (stage := step.replayed(like, running)) is not None:
            stages.append(stage)
    record = Record(shape, children, Chain(stages))
    for execution, module in zip(executions, modules):
        shape = module.output_shape(execution.shape, module.flags) if execution.applied else shape
    if not modules[-1].has_known_size:  # which ends a run
        shape = (*shape[:2], *modules[-1]._size_of(executions[-1], modules[-1].flags))
    record.size, record.identity = shape[2:], matrix_type(like)
    return record


def replayed_record(
    children: Sequence[Child], context: CallContext, like: Tensor, shape: Shape, params: Sequence[Any]
) -> Record:
    """The record of a run on images of a shape with the parameters of its children, without running it."""
    own = [replace(child, params=item.data) for child, item in zip(children, params)]
    executions, columns = replayed(like.expand(shape), own)
    of_run = [replace(child, record=execution) for child, execution in zip(own, executions)]
    return record_of_run(shape, of_run, columns, like, context)
