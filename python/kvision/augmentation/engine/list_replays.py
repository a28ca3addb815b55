"""Runs on lists of images of different sizes with given parameters, by the launches of a batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision._constants import on_device
from kvision._dtype import compute_dtype
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.list_calls import SIZES, params_of_rows
from kvision.augmentation.engine.list_runs import (
    ListParts,
    count_list_steps,
    grouped,
    record_of_run,
    run_list,
    run_list_steps,
    takes_list,
)
from kvision.augmentation.engine.passes import Alone, Running, Step, plan_steps
from kvision.augmentation.engine.record import Child, Record
from kvision.augmentation.engine.runs import replayed, runs_of
from kvision.augmentation.engine.sized import NumbersOfEach, Sized, SizedNumbers, find_sized
from kvision.augmentation.transforms import Transform
from kvision.geometry.transform.lists.arguments import like_batch


def run_or_replay(
    images: list[Tensor], children: Sequence[Child], context: CallContext
) -> tuple[Any, ListParts | None] | None:
    """The results of a run and its parts, None of a replay; None where others run or replay it."""
    if children[0].params is None:
        return run_list(images, children, context)
    y = replay_list(images, children, context)
    return None if y is None else (y, None)


def replayed_record(
    children: Sequence[Child], context: CallContext, like: Tensor, shape: tuple[int, ...], params: Sequence[Any]
) -> Record:
    """The record of a run on images of a shape with the parameters of its children, without running it."""
    own = [replace(child, params=item.data) for child, item in zip(children, params)]
    executions, columns = replayed(like.expand(shape), own)
    of_run = [replace(child, record=execution) for child, execution in zip(own, executions)]
    return record_of_run(shape, of_run, columns, like, context)


class _Replay(NamedTuple):
    """A run with given parameters on lists, whatever their lengths and sizes."""

    sized: Sized
    numbers: SizedNumbers | NumbersOfEach | None  # inputs of matrices
    has_sized_identity: bool  # columns of samples that are not chosen depend on the size


def replay_list(images: list[Tensor], children: Sequence[Child], context: CallContext) -> Any:
    """The results of a run with the parameters of its children, a list or a batch; None where others replay it."""
    modules: list[Any] = [child.module for child in children]
    first, names = images[0], [tuple(child.params or ()) for child in children]
    runs = runs_of(children, context.plans)
    if is_compiling() or len(runs) != 1 or not runs[0][1] or any(child.samples is not None for child in children):
        return None
    if any(isinstance(x, Tensor) and x.is_cuda for child in children for x in (child.params or {}).values()):
        return None
    groups = _groups(children, len(images))
    if len(groups) > 1:
        return _replay_groups(images, children, context, groups)
    ((_, applied),) = groups
    key = (
        "list replay",
        first.shape[0],
        first.dtype,
        context.once,
        context.output,
        *applied,
        *map(id, modules),
        *names,
    )
    replay: _Replay | None = context.plans.made(key, lambda: _make(images, children, applied, context))
    if replay is None:
        return None
    like = like_batch(images)
    executions, columns = replayed(like.new_empty(1).expand(len(images), first.shape[0], *SIZES[0]), children)
    if replay.has_sized_identity and any(execution.chosen is not None for execution in executions):
        return None
    chains: Mapping[int, Sequence[Transform]] = {}
    if replay.numbers is not None:
        own = on_device(replay.numbers.of_each(images).to(compute_dtype(like)), like.device)
        width = 0 if columns is None else columns.shape[1]
        columns = own if columns is None else torch.cat([columns.to(own), own], 1)
        spans = [None if execution.columns is None else execution.columns.span for execution in executions]
        chains = replay.sized.bound(modules, spans, width)
    steps = plan_steps(modules, executions, context.once, first.dtype, context.output, chains)
    if not all(_takes_list(step, modules, first.dtype) for step in steps):
        return None
    one_size = replay.sized.own if replay.sized.own < len(modules) else None
    running = Running(modules, executions, columns, False)
    return run_list_steps(images, steps, running, count_list_steps(steps, one_size), replay.sized)


def _groups(children: Sequence[Child], count: int) -> list[tuple[Sequence[int], Sequence[bool]]]:
    """The images for which the same augmentations are applied, of those that are applied to a batch or not."""
    columns: list[list[bool]] = []
    for child in children:
        module: Any = child.module
        chosen: Any = (child.params or {}).get("batch_prob") if module.whole_batch else None
        is_of_each = isinstance(chosen, Tensor) and len(chosen) == count
        columns.append((chosen > 0.5).tolist() if is_of_each else [True] * count)
    return grouped(columns)


def _replay_groups(
    images: list[Tensor], children: Sequence[Child], context: CallContext, groups: Sequence[Any]
) -> list[Tensor] | None:
    """The results of a run whose augmentations are applied to some of the images."""
    results = list(images)
    for samples, _ in groups:
        own = [replace(child, params=params_of_rows(child.params, samples, len(images))) for child in children]
        y = replay_list([images[i] for i in samples], own, context)
        if y is None:
            return None
        for i, result in zip(samples, y):
            results[i] = result
    return results


def _make(
    images: Sequence[Tensor], children: Sequence[Child], applied: Sequence[bool], context: CallContext
) -> _Replay | None:
    modules: list[Any] = [child.module for child in children]
    sized = find_sized(modules, applied, images[0].shape[0], context)
    has_pixels = any(m._param_generator is not None and m._param_generator.per_pixel for m in modules)
    if sized is None or has_pixels or context.output.memory_format is not None:
        return None
    count = len(images)
    if not _has_same_columns(sized, children, count, None):
        return None
    none = torch.zeros(count, dtype=torch.bool, device="cpu")
    return _Replay(sized, sized.numbers(has_draws=False), not _has_same_columns(sized, children, count, none))


def _has_same_columns(sized: Sized, children: Sequence[Child], count: int, chosen: Tensor | None) -> bool:
    """Whether the columns of given parameters of so many images do not depend on their size."""
    each = [[(count, *shape[1:]) for shape in sized.reading.shapes(size)] for size in SIZES]
    for child, *shapes in zip(children, *each):  # those behind have one size
        own: Any = child.module
        columns = [
            own._columns_of(child.params, of_size, torch.device("cpu"), chosen).drawn
            for of_size in shapes
            if own._executes_columns(of_size)
        ]
        if len(columns) == 1 or (columns and not torch.equal(*columns)):
            return False
    return True


def _takes_list(step: Step, modules: Sequence[Any], dtype: torch.dtype) -> bool:
    return takes_list(step, modules, dtype) and (not isinstance(step, Alone) or modules[step.number].replays_lists)


__all__ = ["replay_list", "replayed_record", "run_or_replay"]
