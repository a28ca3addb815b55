"""Runs of augmentations that leave images of a list their sizes, by the launches of a batch, whatever the number of images.

The draws are those of a batch, in one launch. What a draw or a matrix takes from the size of its image is a linear function of
height and width: columns of their own, which the same launch writes. Each pass gives a list, until a crop or resize gives all
images one size; the rest is a run on a batch. What belongs to the images later, labels, parameters and the inverse, asks for the
calls of parts, which the columns of the list give.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision.augmentation.columns import Column, Columns, DrawPlan
from kvision.augmentation.drawn_pass import DrawnListPass, SizedDraws
from kvision.augmentation.draws import HEADER, MAX_DRAWS, MAX_NUMBERS, Draw, Request, make_plan
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.execution import Execution, ListExecution, matrix_type
from kvision.augmentation.engine.list_calls import SIZES, Parts
from kvision.augmentation.engine.passes import Alone, Joined, Running, Step, plan_steps
from kvision.augmentation.engine.record import Child, Record
from kvision.augmentation.engine.runs import Call, RunPlan, decides, plan_run, runs_of
from kvision.augmentation.engine.stages import Chain, Stage
from kvision.augmentation.keys import Keys
from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.transforms import Transform
from kvision.augmentation.warp_and_color_list import warp_and_color_list, warp_and_color_to_list
from kvision.geometry.transform.lists.arguments import like_batch, row
from kvision.geometry.transform.lists.arguments import sizes as sides_of

Size = tuple[int, ...]
_CORNERS = ((64, 64), (128, 64), (64, 128))  # sizes from which linear functions follow; at the others they are compared
_ANY = 2  # images of a batch in plans, which do not depend on it
_COMPARED = (*SIZES, (SIZES[0][0], SIZES[0][0]))  # square images may be drawn for in another way
_PROBES = (*_CORNERS, *SIZES, (1, 1), (3, 1000), (641, 427))


class SizedNumbers(NamedTuple):
    """Numbers that are linear functions of the size of an image."""

    constant: Sequence[float]
    of_height: Sequence[float]
    of_width: Sequence[float]

    @classmethod
    def of(cls, read: Callable[[Size], Sequence[float]]) -> SizedNumbers | None:
        """Those that `read` gives for a size; None if they are no linear functions."""
        try:
            rows = [read(size) for size in _PROBES]
        except ValueError:  # of images that are too small
            return None
        if any(len(row) != len(rows[0]) for row in rows):
            return None
        side, numbers = _CORNERS[0][0], []
        for first, higher, wider in zip(*rows[:3]):
            of_height, of_width = (higher - first) / side, (wider - first) / side
            numbers.append((first - side * of_height - side * of_width, of_height, of_width))
        found = cls(*(tuple(column) for column in zip(*numbers)))
        is_linear = all(
            math.isclose(a, b, rel_tol=1e-14, abs_tol=1e-12)
            for size, row in zip(_PROBES, rows)
            for a, b in zip(found.at(*size), row)
        )
        return found if is_linear else None

    def at(self, height: int, width: int) -> list[float]:
        """The numbers for a size."""
        return [a + height * b + width * c for a, b, c in zip(self.constant, self.of_height, self.of_width)]

    def of_each(self, sides: Sequence[int]) -> Tensor:
        """The numbers (B, N) for height and width of each image, float64 on the CPU."""
        own = torch.tensor(sides, dtype=torch.float64, device="cpu").view(-1, 2, 1)
        a, b, c = self.linear()
        return a + own[:, 0] * b + own[:, 1] * c

    def linear(self) -> Tensor:
        """The three rows (3, N), float64 on the CPU."""
        return torch.tensor(self, dtype=torch.float64, device="cpu")


class _Reading:
    """What augmentations draw, and the formulas of their matrices, for a size of images."""

    def __init__(self, modules: Sequence[Any], batch: int, channels: int, context: CallContext) -> None:
        self.modules, self.shape = modules, (batch, channels)
        self.is_certain, self.has_owners = context.is_certain, context.owners is not None

    def draws(self, size: Size) -> list[Any]:
        """Those of all augmentations, as `plan_run` asks for them."""
        shape = (*self.shape, *size)
        applied = [m for m in self.modules if self.is_certain or (m.p > 0 and m.p_batch > 0)]
        requests = [m._request(shape, self.is_certain, self.has_owners) for m in applied]
        return [draw for request in requests if request is not None for draw in request.draws]

    def chains(self, size: Size) -> list[Sequence[Transform]]:
        """The formulas of each augmentation; none of one without a matrix."""
        shape = (*self.shape, *size)
        chains = [m.matrix_transforms(shape, m.flags) if hasattr(m, "matrix_transforms") else () for m in self.modules]
        return [() if chain is None else chain for chain in chains]


class Sized:
    """The draws and the inputs of matrices that depend on the size of an image, among those of augmentations."""

    def __init__(self, reading: _Reading) -> None:
        self.reading = reading
        draws = list(map(reading.draws, _COMPARED))
        self.has_same_draws = all([_kind(a) for a in own] == [_kind(a) for a in draws[0]] for own in draws)
        self.draws = [i for i, (first, *others) in enumerate(zip(*draws)) if any(a != first for a in others)]
        chains = list(map(reading.chains, _COMPARED))
        forms = [[[(t.kind, len(t.inputs)) for t in chain] for chain in of_size] for of_size in chains]
        self.has_same_forms = all(form == forms[0] for form in forms)
        # Of each augmentation pairs of a transform and an input, by their numbers.
        self.inputs = [
            [
                (i, k)
                for i, transforms in enumerate(zip(*of_sizes))
                for k, (first, *others) in enumerate(zip(*[t.inputs for t in transforms]))
                if any(x != first for x in others)
            ]
            for of_sizes in zip(*chains)
        ]
        self.count = sum(map(len, self.inputs))

    def numbers(self, size: Size) -> list[float]:
        """Those of the draws, and then the inputs."""
        draws = self.reading.draws(size)
        numbers = [n for i in self.draws for n in draws[i].numbers]
        for chain, inputs in zip(self.reading.chains(size), self.inputs):
            numbers += [chain[i].inputs[k] for i, k in inputs]
        return numbers

    def bound(self, modules: Sequence[Any], calls: Sequence[Call], columns: int) -> Mapping[int, Sequence[Transform]]:
        """The chains, by the numbers of augmentations, with columns behind `columns` others in place of their inputs."""
        bound: dict[int, Sequence[Transform]] = {}
        for number, (chain, inputs) in enumerate(zip(self.reading.chains(SIZES[0]), self.inputs)):
            own = {place: Column(columns + i) for i, place in enumerate(inputs)}
            columns += len(own)
            if own:
                with_columns = [
                    Transform(t.kind, *[own.get((i, k), x) for k, x in enumerate(t.inputs)])
                    for i, t in enumerate(chain)
                ]
                bound[number] = modules[number]._bound(with_columns, calls[number].span)
        return bound


def _kind(draw: Any) -> Any:
    return (draw.kind, draw.columns) if isinstance(draw, Draw) else None


class _ListPlan(NamedTuple):
    """A run on lists, whatever their lengths and sizes."""

    run: RunPlan
    steps: int  # which read lists
    has_one_size: bool  # of the last of these
    draws: DrawPlan | None  # of all columns; None if there are none
    listed: Sequence[int]  # the draws with numbers of each image, by their positions among all
    numbers: SizedNumbers | None
    drawn: DrawnListPass | None  # the draws with the first step
    sized: SizedDraws | None  # the draws alone


# --- the plan -------------------------------------------------------------------------------------------------------


def _make_plan(
    images: Sequence[Tensor], modules: Sequence[Any], context: CallContext, position: int
) -> _ListPlan | None:
    """The plan of a run; None where it is not made of passes: others draw for the pixels of a batch, or are found in it."""
    batch, channels = _ANY, images[0].shape[0]
    found = find_sized(modules, channels, context)
    if found is None or not found[0].has_same_draws:
        return None
    sized, own = found
    has_one_size = own < len(modules)
    like = images[0].detach().new_empty(1).expand(batch, channels, *SIZES[0])
    run, _ = plan_run(like, modules, context, position, sized.bound)
    if len(run.draws) > 1 or any(draws.learned is not None for draws in run.draws):
        return None
    if not all(takes_list(step, modules, like.dtype) for step in run.steps):
        return None
    steps = count_list_steps(run.steps, own if has_one_size else None)
    if context.output.memory_format is not None and not has_one_size:
        return None
    numbers = SizedNumbers.of(sized.numbers) if sized.draws or sized.count else None
    if numbers is None and (sized.draws or sized.count):
        return None
    draws = run.draws[0] if run.draws else None
    listed = list(sized.draws)
    if sized.count:
        listed += [_count_draws(draws) + i for i in range(sized.count)]
        draws = _with_numbers(draws, sized.count)
    if draws is not None and (_count_draws(draws) > MAX_DRAWS or len(draws.numbers) > MAX_NUMBERS):
        return None
    drawn = sized_draws = None
    linear = torch.empty(3, 0, dtype=torch.float64, device="cpu") if numbers is None else numbers.linear()
    if draws is not None:
        sized_draws = SizedDraws(draws, listed, linear)
    first = run.steps[0] if run.steps else None
    has_list_first = context.owners is None and (steps > 1 or not has_one_size)
    if draws is not None and isinstance(first, Joined) and has_list_first:
        drawn = DrawnListPass(draws, listed, linear, first.image_pass, like.shape, like.dtype)
    return _ListPlan(run, steps, has_one_size, draws, listed, numbers, drawn, sized_draws)


def find_sized(modules: Sequence[Any], channels: int, context: CallContext) -> tuple[Sized, int] | None:
    """What depends on the sizes of images, and how many augmentations leave them these; None for what is no run on a list."""
    if any(decides(m) or m._derives or m.mixes_samples or not m.takes_lists for m in modules):
        return None
    own = _number_of_own_size(modules, _ANY, channels)
    if own is None:
        return None
    sized = Sized(_Reading(modules[: own + 1], _ANY, channels, context))
    return (sized, own) if sized.has_same_forms else None


def count_list_steps(steps: Sequence[Step], crop: int | None) -> int:
    """How many steps read lists: all, or those up to the one with the augmentation that gives one size."""
    if crop is None:
        return len(steps)
    return 1 + next(i for i, step in enumerate(steps) if isinstance(step, Joined) and crop in step.geometric)


def _number_of_own_size(modules: Sequence[Any], batch: int, channels: int) -> int | None:
    """How many augmentations give images their own sizes, before one that gives all the same; None where one gives others."""
    for own, module in enumerate(modules):
        shapes = [module.output_shape((batch, channels, *size), module.flags) for size in SIZES]
        if any(shape[:2] != (batch, channels) for shape in shapes):
            return None
        if shapes[0] == shapes[1]:
            return own
        if tuple(tuple(shape[2:]) for shape in shapes) != SIZES:
            return None
    return len(modules)


def takes_list(step: Step, modules: Sequence[Any], dtype: torch.dtype) -> bool:
    """Whether a step, of those of a run on images of a type, is one operator on the images of a list."""
    if not isinstance(step, Alone):
        return isinstance(step, Joined)
    for module in modules[: step.number]:
        dtype = module._result_dtype(dtype)
    takes: bool = modules[step.number]._operates_on(dtype)
    return takes


def _count_draws(draws: DrawPlan | None) -> int:
    """How many draws a plan has: what is left of it without the number of columns and the headers of requests."""
    return 0 if draws is None else sum(draws.plan[at + HEADER - 1] for at in _headers(draws.plan))


def _headers(plan: Sequence[int]) -> Iterator[int]:
    at = 1
    while at < len(plan):
        yield at
        at += HEADER + plan[at + HEADER - 1]


def _with_numbers(draws: DrawPlan | None, count: int) -> DrawPlan:
    """The same draws, and behind them columns of numbers."""
    more = make_plan([Request([Draw("number", (0.0,))] * count)])  # of the first key, which takes no part
    if draws is None:
        return DrawPlan(0, 1, more.plan, more.numbers, [], None)
    plan = [draws.plan[0] + count, *draws.plan[1:], *more.plan[1:]]
    return draws._replace(plan=plan, numbers=[*draws.numbers, *more.numbers])


def _draw(plan: _ListPlan, draws: DrawPlan, like: Tensor, keys: Keys, sides: Sequence[int]) -> Tensor:
    if plan.numbers is None:
        return draws.draw(like, keys)
    if is_compiling():  # a graph has no numbers of tensors
        numbers = [n for size in zip(sides[::2], sides[1::2]) for n in plan.numbers.at(*size)]
    else:
        numbers = plan.numbers.of_each(sides).flatten().tolist()
    return draws.draw_list(like, keys, plan.listed, numbers)


# --- the call -------------------------------------------------------------------------------------------------------


@dataclass
class _Call:
    """A run on a list: what it drew, for the calls of its parts."""

    op: str
    modules: Sequence[Any]
    names: Sequence[str]
    context: CallContext
    plan: _ListPlan
    columns: Tensor | None
    keys: Keys | None
    like: Tensor  # of the type and device of the images
    shape: tuple[int, int]  # (B, C)
    _sides: Any  # height and width of each image, or a tensor of them

    @property
    def sides(self) -> Sequence[int]:
        if isinstance(self._sides, Tensor):
            self._sides = self._sides.flatten().tolist()
        return self._sides

    @cached_property
    def _has_noise(self) -> bool:
        """Whether pixels have numbers of their own, which depend on the number of their image."""
        drawing = self.plan.run.drawing
        return any(m._param_generator is not None and m._param_generator.per_pixel for m in drawing)

    def rows(self) -> list[list[int]]:
        """The numbers of the images of each size; of one by one where these tell their pixels' noise apart."""
        if self._has_noise:
            return [[i] for i in range(self.shape[0])]
        by_size: dict[Size, list[int]] = {}
        for i, size in enumerate(zip(self.sides[::2], self.sides[1::2])):
            by_size.setdefault(size, []).append(i)
        return list(by_size.values())

    def record(self, rows: Sequence[int]) -> Record:
        """The call of images of one size, by their numbers."""
        first = rows[0]
        columns, shape = self.columns, (len(rows), self.shape[1], *self.sides[2 * first : 2 * first + 2])
        if columns is not None and len(rows) < len(columns):
            columns = columns.index_select(0, torch.tensor(rows, device="cpu").to(columns.device))
        executions, of_images = [], shape
        for module, (_, applies, is_certain, number, span, _) in zip(self.modules, self.plan.run.calls):
            own = None if number is None or span is None or columns is None else Columns(columns, span)
            execution = Execution(shape, own, applied=applies, is_certain=is_certain)
            execution.identity = matrix_type(self.like)
            if self._has_noise and number is not None and self.keys is not None:
                execution.noise = self._noise(module, self.plan.run.first + number, first)
            executions.append(execution)
            shape = module.output_shape(shape, module.flags) if applies else shape
        steps = plan_steps(self.modules, executions, self.context.once, self.like.dtype, self.context.output)
        running = Running(self.modules, executions, columns, self.context.has_labels)
        stages: list[Stage] = []
        for step in steps:
            if isinstance(step, Alone):
                stages.append(running.applied(step.number))
            elif isinstance(step, Joined) and (stage := step.replayed(self.like, running)) is not None:
                stages.append(stage)
        children = [Child(*child, None, record) for child, record in zip(zip(self.names, self.modules), executions)]
        record = Record(of_images, children, Chain(stages))
        record.size, record.identity = shape[2:], matrix_type(self.like)
        return record

    def _noise(self, module: Any, number: int, image: int) -> PixelNoise:
        """The source of the noise of an augmentation in an image."""
        keys = self.keys
        assert keys is not None
        if keys.seeds is not None:
            keys = keys._replace(seeds=row(keys.seeds, image))
        return PixelNoise(keys, number, module.same_on_batch, self.like.device, first=image)


class ListParts(Parts):
    """The parts of a run on a list, whose calls are made of the columns of the list when they are asked for."""

    def __init__(self, call: _Call, child: int | None = None) -> None:
        self.op, self.count, self._call, self._child = call.op, call.shape[0], call, child

    @cached_property
    def rows(self) -> list[list[int]]:  # type: ignore[override]
        return self._call.rows()

    @cached_property
    def calls(self) -> list[Any]:  # type: ignore[override]
        records = map(self._call.record, self.rows)
        return [record if self._child is None else record.children[self._child].record for record in records]

    @property
    def shape(self) -> tuple[int, ...]:
        sides = self._call.sides
        # A graph would be one of which image is the largest.
        size = sides[:2] if is_compiling() else (max(sides[::2]), max(sides[1::2]))
        return (*self._call.shape, *size)

    def done(self, i: int) -> tuple[Sequence[Child], Sequence[Stage]]:
        """What an image got, and what its labels have to follow."""
        record = self._call.record([i])
        return record.children, record.stages.stages

    def of_child(self, number: int) -> ListParts:
        """The calls of an augmentation of the run."""
        return ListParts(self._call, number)


def run_list(images: list[Tensor], children: Sequence[Child], context: CallContext) -> tuple[Any, ListParts] | None:
    """The results of a run, a list or a batch, and its parts; None where the run is not made of passes over lists."""
    if context.seed_of_samples is not context.seed:
        return None
    runs = runs_of(children, context.plans)
    if len(runs) != 1 or not runs[0][1] or children[0].params is not None:
        return None
    modules, first = [child.module for child in children], images[0]
    own = (
        first.shape[0],
        first.dtype,
        context.position,
        context.seed is None,
        context.once,
        context.output,
        context.is_certain,
        context.owners is None,
    )
    key = ("list run", *own, *map(id, modules))
    plan: _ListPlan | None = context.plans.made(key, lambda: _make_plan(images, modules, context, context.position))
    if plan is None:
        return None
    like = like_batch(images)
    y, columns, keys, sides = _execute(images, modules, context, plan, like)
    names = [child.name for child in children]
    call = _Call(
        context.op,
        modules,
        names,
        context,
        plan,
        columns,
        keys,
        like.new_empty(0),
        (len(images), first.shape[0]),
        sides,
    )
    parts = ListParts(call)
    for i, module in enumerate(modules):
        module.__dict__["_execution"] = ListExecution(parts.of_child(i))
    return y, parts


def _execute(
    images: list[Tensor], modules: Sequence[Any], context: CallContext, plan: _ListPlan, like: Tensor
) -> tuple[Any, Tensor | None, Keys | None, Any]:
    """The results, the drawn columns, their keys, and the heights and widths."""
    run, columns, drawn, keys = plan.run, None, None, None
    if plan.draws is not None:
        keys = context.keys(run.drawing, like) if run.drawing else Keys(torch.zeros(1, dtype=torch.int64, device="cpu"))
        context.check_seeds(keys, len(images))
        drawn = None if plan.drawn is None else plan.drawn.run(images, keys)
    x: Any = images
    sides: Any
    if drawn is not None:
        x, columns, sides = drawn
    else:
        of_sizes = None if plan.sized is None or keys is None or is_compiling() else plan.sized.run(images, keys)
        if of_sizes is not None:
            columns, sides = of_sizes
        else:
            sides = sides_of(images)  # which checks them
            if plan.draws is not None and keys is not None:
                columns = _draw(plan, plan.draws, like, keys, sides)
        if columns is not None:
            columns = plan.run.of_owners(columns, context.owners)
    needs_executions = len(run.steps) > plan.steps or any(isinstance(step, Alone) for step in run.steps)
    executions = run.executions(like, columns, keys) if needs_executions else []
    for execution in executions:
        execution.shape = (len(images), *execution.shape[1:])
    running = Running(modules, executions, columns, context.has_labels)
    done = 0 if drawn is None else 1
    x = run_list_steps(x, run.steps[done:], running, plan.steps - done, plan.has_one_size)
    return x, columns, keys, sides


def run_list_steps(x: Any, steps: Sequence[Step], running: Running, of_list: int, has_one_size: bool) -> Any:
    """What steps make of a list, which `of_list` of them read; the last of these may give a batch."""
    for i, step in enumerate(steps):
        if i >= of_list:
            x, _ = step.run(x, running)
        elif isinstance(step, Alone):
            x = running.modules[step.number]._run_list(x, running.executions[step.number])
        else:
            assert isinstance(step, Joined)
            columns, fill, size, *rest = step.image_pass.arguments(like_batch(x), running.columns)
            if has_one_size and i == of_list - 1:
                x, *_ = warp_and_color_list(x, columns, fill, size, *rest)
            else:
                x = list(warp_and_color_to_list(x, columns, fill, len(size) > 0, *rest)[: len(x)])
    return x
