"""Runs of augmentations on a list of images, by the launches of a batch, whatever the number of images.

The draws are those of a batch, in one launch. What a draw or a matrix takes from the size of its image is in columns of their own,
which the same launch writes: linear functions of height and width, or numbers that are read for each size. Each pass gives a list,
until a crop or resize gives all images one size; the rest is a run on a batch. Images for which other augmentations are applied,
as the host decides where sizes change, are runs of their own. What belongs to the images later, labels, parameters and the
inverse, asks for the calls of parts, which the columns of the list give.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision._constants import on_device
from kvision.augmentation.columns import DrawPlan
from kvision.augmentation.drawn_pass import DrawnListPass, SizedDraws
from kvision.augmentation.draws import HEADER, MAX_DRAWS, MAX_NUMBERS, Draw, Request, are_chosen_batches, make_plan
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.execution import Execution, ListExecution, Shape, matrix_type
from kvision.augmentation.engine.list_calls import SIZES, Parts, refuse_list, seeds_of_list
from kvision.augmentation.engine.passes import Alone, Joined, Running, Step, plan_steps
from kvision.augmentation.engine.record import Child, Record
from kvision.augmentation.engine.runs import RunPlan, decides, may_apply, plan_run, runs_of, with_derived
from kvision.augmentation.engine.sized import NumbersOfEach, Sized, SizedNumbers, find_sized, listed
from kvision.augmentation.engine.stages import Chain, Stage
from kvision.augmentation.keys import Keys
from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.sample_rows import numbers_by, read_rows
from kvision.augmentation.warp_and_color_list import warp_and_color_list, warp_and_color_to_list
from kvision.geometry.transform.lists.arguments import have_one_size, like_batch, row, some_of
from kvision.geometry.transform.lists.arguments import sizes as sides_of

_ANY = 2  # images of a batch in plans, which do not depend on it


class _ListPlan(NamedTuple):
    """A run on lists, whatever their lengths and sizes."""

    run: RunPlan
    steps: int  # which read lists
    sized: Sized
    draws: DrawPlan | None  # of all columns; None if there are none
    listed: Sequence[int]  # the draws with numbers of each image, by their positions among all
    numbers: SizedNumbers | NumbersOfEach | None
    drawn: DrawnListPass | None  # the draws with the first step
    drawn_alone: SizedDraws | None  # the draws


# --- the plan -------------------------------------------------------------------------------------------------------


def _make_plan(
    images: Sequence[Tensor], modules: Sequence[Any], applied: Sequence[bool], context: CallContext
) -> _ListPlan | None:
    """The plan of a run; None where it is not made of passes: others draw for the pixels of a batch, or are found in it."""
    batch, channels = _ANY, images[0].shape[0]
    sized = find_sized(modules, applied, channels, context)
    if sized is None or not sized.has_same_draws:
        return None
    has_one_size = sized.own < len(modules)
    like = images[0].detach().new_empty(1).expand(batch, channels, *SIZES[0])
    run, _ = plan_run(like, modules, context, context.position, sized.bound)
    if len(run.draws) > 1 or any(draws.learned is not None for draws in run.draws):
        return None
    if not all(takes_list(step, modules, like.dtype) for step in run.steps):
        return None
    steps = count_list_steps(run.steps, sized.own if has_one_size else None)
    if context.output.memory_format is not None and not has_one_size:
        return None
    by_matrix = [
        isinstance(s, Joined) or (isinstance(s, Alone) and modules[s.number].warps_lists_by_matrix) for s in run.steps
    ]
    has_inputs = any(by_matrix[:steps])  # others read sizes themselves
    numbers = sized.numbers(has_inputs=has_inputs)
    draws, places = run.draws[0] if run.draws else None, list(sized.draws)
    if sized.count and has_inputs:
        places += [_count_draws(draws) + i for i in range(sized.count)]
        draws = _with_numbers(draws, sized.count)
    if draws is not None and not draws.plan[0]:  # nothing but a chance, which the host knows
        draws = None
    if draws is not None and (_count_draws(draws) > MAX_DRAWS or len(draws.numbers) > MAX_NUMBERS):
        return None
    drawn = sized_draws = None
    if draws is not None and not isinstance(numbers, NumbersOfEach):
        sized_draws = SizedDraws(draws, places, _linear(numbers))
    first = run.steps[0] if run.steps else None
    has_list_first = context.owners is None and not run.derives and (steps > 1 or not has_one_size)
    if isinstance(first, Joined) and has_list_first:
        changes = sized.changes(first.geometric)
        if draws is not None or changes:
            of_pass = sized.numbers(draws is not None, then=first.geometric) if changes else numbers
            of_each = of_pass if isinstance(of_pass, NumbersOfEach) else _linear(of_pass)
            own = draws or _NO_DRAWS
            drawn = DrawnListPass(own, places, of_each, changes, first.image_pass, like.shape, like.dtype)
    return _ListPlan(run, steps, sized, draws, places, numbers, drawn, sized_draws)


def count_list_steps(steps: Sequence[Step], crop: int | None) -> int:
    """How many steps read lists: all, or those up to the one with the augmentation that gives one size."""
    if crop is None:
        return len(steps)
    numbers = [[step.number] if isinstance(step, Alone) else step.geometric for step in steps]
    return 1 + next(i for i, of_step in enumerate(numbers) if crop in of_step)


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


def _linear(numbers: SizedNumbers | None) -> Tensor:
    return torch.empty(3, 0, dtype=torch.float64, device="cpu") if numbers is None else numbers.linear()


_NO_DRAWS = DrawPlan(0, 1, [0], [], [], None)


def _draw(plan: _ListPlan, draws: DrawPlan, like: Tensor, keys: Keys, images: Sequence[Tensor]) -> Tensor:
    if plan.numbers is None:
        return draws.draw(like, keys)
    return draws.draw_list(like, keys, plan.listed, listed(plan.numbers, sides_of(images)))


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
    found: Tensor | None  # (B, 1, H, W) of the largest sides, what masks gave

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
        """The numbers of the images of each size; of one by one where these tell their pixels' noise apart, or draw sizes."""
        draws_sizes = any(m.draws_for_batch or not m.has_known_size for m in self.modules)
        if self._has_noise or draws_sizes:
            return [[i] for i in range(self.shape[0])]
        return list(numbers_by(zip(self.sides[::2], self.sides[1::2])).values())

    def record(self, rows: Sequence[int]) -> Record:
        """The call of images of one size, by their numbers."""
        first = rows[0]
        columns, shape = self.columns, (len(rows), self.shape[1], *self.sides[2 * first : 2 * first + 2])
        if columns is not None and len(rows) < len(columns):
            columns = columns.index_select(0, torch.tensor(rows, device="cpu").to(columns.device))
        run, of_shape = self.plan.run, shape
        executions = run.executions(self.like, columns, self.keys)
        has_seeds = self.keys is not None and self.keys.seeds is not None and len(rows) == 1
        for module, call, execution in zip(self.modules, run.calls, executions):
            execution.shape, redraw = shape, None
            if self.found is not None:
                execution.found = module._found(self.found[list(rows), :, : shape[2], : shape[3]])
            if self._has_noise and call.number is not None and self.keys is not None:
                execution.noise = self._noise(module, run.first + call.number, first)
            elif has_seeds and execution.redraw is not None and not call.derived_from:
                redraw = (self._keys_of(first), execution.redraw[1])
            execution.redraw = redraw
            shape = module.output_shape(shape, module.flags) if call.applies else shape
        children = [Child(*child, None, record) for child, record in zip(zip(self.names, self.modules), executions)]
        return record_of_run(of_shape, children, columns, self.like, self.context)

    def _noise(self, module: Any, number: int, image: int) -> PixelNoise:
        """The source of the noise of an augmentation in an image."""
        return PixelNoise(self._keys_of(image), number, module.same_on_batch, self.like.device, first=image)

    def _keys_of(self, image: int) -> Keys:
        keys = self.keys
        assert keys is not None
        return keys if keys.seeds is None else keys._replace(seeds=row(keys.seeds, image))


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
        elif isinstance(step, Joined) and (stage := step.replayed(like, running)) is not None:
            stages.append(stage)
    record = Record(shape, children, Chain(stages))
    for execution, module in zip(executions, modules):
        shape = module.output_shape(execution.shape, module.flags) if execution.applied else shape
    if not modules[-1].has_known_size:  # which ends a run
        shape = (*shape[:2], *modules[-1]._size_of(executions[-1], modules[-1].flags))
    record.size, record.identity = shape[2:], matrix_type(like)
    return record


_Samples = tuple[Sequence[int], _Call]  # the numbers of images, and the run of these


class ListParts(Parts):
    """The parts of runs on a list, whose calls are made of the columns of the runs when they are asked for.

    Each run has some of the images, of which `samples` are the numbers.
    """

    def __init__(self, op: str, runs: Sequence[_Samples], child: int | None = None) -> None:
        self.op, self._runs, self._child = op, runs, child
        self.count = sum(len(samples) for samples, _ in runs)

    @cached_property
    def rows(self) -> list[list[int]]:  # type: ignore[override]
        return [[samples[i] for i in rows] for samples, run in self._runs for rows in run.rows()]

    @cached_property
    def calls(self) -> list[Any]:
        records = [run.record(rows) for _, run in self._runs for rows in run.rows()]
        return [record if self._child is None else record.children[self._child].record for record in records]

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

    def of_child(self, number: int) -> ListParts:
        """The calls of an augmentation of the runs."""
        return ListParts(self.op, self._runs, number)


def run_list(images: list[Tensor], children: Sequence[Child], context: CallContext) -> tuple[Any, ListParts] | None:
    """The results of a run, a list or a batch, and its parts; None where the run is not made of passes over lists."""
    if context.seed_of_samples is not context.seed:
        return None
    runs = runs_of(children, context.plans)
    modules: list[Any] = [child.module for child in children]
    if len(runs) != 1 or children[0].params is not None:
        return None
    if not runs[0][1]:
        first = modules[0]
        if not getattr(first, "needs_masks", False) or first.mixes_samples or not first._takes_masks(images, context):
            return None
        if context.plans is not first._plans and context.seed is not None:  # that of a child which runs by itself
            context = context._replace(seed=context.seed + ((context.position + 1) << 32), position=0)
    names = [child.name for child in children]
    done: tuple[Any, Sequence[_Samples]] | None
    if context.is_certain or not any(decides(m) or not m.has_known_size for m in modules):
        plan = _kept_plan(images, modules, [may_apply(m, context.is_certain) for m in modules], context)
        done = None if plan is None else _run_planned(images, modules, names, context, plan)
    else:
        done = _run_decided(images, modules, names, context)
    if done is None:
        return None
    y, calls = done
    parts = ListParts(context.op, calls)
    for i, module in enumerate(modules):
        module.__dict__["_execution"] = ListExecution(parts.of_child(i))
    return y, parts


def _run_planned(
    images: list[Tensor], modules: Sequence[Any], names: Sequence[str], context: CallContext, plan: _ListPlan
) -> tuple[Any, list[_Samples]]:
    """The results of a run, and its call."""
    like, shape = like_batch(images), (len(images), images[0].shape[0])
    y, columns, keys, sides, found = _execute(images, modules, context, plan, like)
    call = _Call(context.op, modules, names, context, plan, columns, keys, like.new_empty(0), shape, sides, found)
    return y, [(range(len(images)), call)]


def _run_decided(
    images: list[Tensor], modules: Sequence[Any], names: Sequence[str], context: CallContext
) -> tuple[list[Any], list[_Samples]] | None:
    """The results of a run whose augmentations are applied to some images, and its calls: one for each choice of them."""
    if is_compiling() or have_one_size(images):  # a batch, which is decided for as one
        return None
    refuse_list(context.op, modules)
    seeds = seeds_of_list(context.op, modules, len(images), context.seed, context.generator_of(modules[0]))
    planned = []
    for samples, applied in _decided(modules, seeds, context):
        labels = None if context.labels is None else context.labels.some(samples)
        own = context._replace(seed=read_rows(seeds, samples), generator=None, labels=labels)
        plan = _kept_plan(images, modules, applied, own)
        if plan is None:
            return None
        planned.append((samples, own, plan))
    results: list[Any] = list(images)
    calls = []
    for samples, own, plan in planned:
        y, ((_, call),) = _run_planned(some_of(images, samples), modules, names, own, plan)
        calls.append((samples, call))
        for i, result in zip(samples, y):
            results[i] = result
    return results, calls


def _decided(modules: Sequence[Any], seeds: Tensor, context: CallContext) -> list[tuple[Sequence[int], Sequence[bool]]]:
    """The numbers of images for which the same augmentations are applied, and which these are, as `plan_run` decides by seeds."""
    number, columns = 0, list[list[bool]]()
    for module in modules:
        if not decides(module):
            columns.append([may_apply(module, context.is_certain)] * len(seeds))
        else:
            columns.append(are_chosen_batches(seeds, context.position + number, module.p_batch))
        number += may_apply(module, False) and module._request((1, 3, *SIZES[0])) is not None
    return grouped(columns)


def grouped(columns: Sequence[Sequence[bool]]) -> list[tuple[Sequence[int], Sequence[bool]]]:
    """The numbers of images for which the same augmentations are applied, and which these are, of a column for each."""
    return [(samples, applied) for applied, samples in numbers_by(zip(*columns)).items()]


def _kept_plan(
    images: Sequence[Tensor], modules: Sequence[Any], applied: Sequence[bool], context: CallContext
) -> _ListPlan | None:
    first = images[0]
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
    key = ("list run", *own, *applied, *map(id, modules))
    plan: _ListPlan | None = context.plans.made(key, lambda: _make_plan(images, modules, applied, context))
    return plan


def _execute(
    images: list[Tensor], modules: Sequence[Any], context: CallContext, plan: _ListPlan, like: Tensor
) -> tuple[Any, Tensor | None, Keys | None, Any, Tensor | None]:
    """The results, the drawn columns, their keys, the heights and widths, and what masks gave."""
    run, columns, drawn, keys, found = plan.run, None, None, None, None
    if plan.draws is not None:
        keys = context.keys(run.drawing, like) if run.drawing else Keys(torch.zeros(1, dtype=torch.int64, device="cpu"))
        context.check_seeds(keys, len(images))
    if plan.drawn is not None and plan.drawn.serves(images):
        drawn = plan.drawn.run(images, keys)
    x: Any = images
    sides: Any
    if drawn is not None:
        x, columns, sides = drawn
        columns = None if plan.draws is None else columns
    else:
        alone = plan.drawn_alone
        of_sizes = None if alone is None or keys is None or is_compiling() else alone.run(images, keys)
        if of_sizes is not None:
            columns, sides = of_sizes
        else:
            sides = sides_of(images)  # which checks them
            if plan.draws is not None and keys is not None:
                columns = _draw(plan, plan.draws, like, keys, images)
        if columns is not None:
            columns = plan.run.of_owners(columns, context.owners)
    needs_executions = run.derives or len(run.steps) > plan.steps or any(isinstance(s, Alone) for s in run.steps)
    executions = _executions(len(images), run, like, columns, keys) if needs_executions else []
    if run.derives and columns is not None:
        width, sized = run.draws[0].plan[0], columns.shape[1]  # the numbers of sizes follow what is derived
        columns = with_derived(modules, executions, columns, run, context, partial(_sizes_before, plan.sized, images))
        columns = torch.cat([columns[:, :width], columns[:, sized:], columns[:, width:sized]], 1)
        executions = _executions(len(images), run, like, columns, keys)
    if modules[0].needs_masks:
        found = modules[0]._find_in_list(images, executions[0], context)
    running = Running(modules, executions, columns, context.has_labels)
    done = 0 if drawn is None else 1
    x = run_list_steps(x, run.steps[done:], running, plan.steps - done, plan.sized)
    return x, columns, keys, sides, found


def _executions(count: int, run: RunPlan, like: Tensor, columns: Tensor | None, keys: Keys | None) -> list[Execution]:
    """What a run executes for so many images."""
    executions = run.executions(like, columns, keys)
    for execution in executions:
        execution.shape = (count, *execution.shape[1:])
    return executions


def _sizes_before(sized: Sized, images: Sequence[Tensor], number: int) -> Tensor:
    """Height and width (B, 2) of images before an augmentation of a run."""
    sizes = torch.tensor(sized.sizes_after(range(number), images), dtype=torch.float32, device="cpu")
    return on_device(sizes.view(-1, 2), images[0].device)


def run_list_steps(x: Any, steps: Sequence[Step], running: Running, of_list: int, sized: Sized) -> Any:
    """What steps make of a list, which `of_list` of them read; the last of these may give a batch."""
    if not steps:
        return list(x)
    has_one_size = sized.own < len(running.modules)
    for i, step in enumerate(steps):
        if i >= of_list:
            x, _ = step.run(x, running)
        elif isinstance(step, Alone):
            x = step.run_list(x, running)
        else:
            assert isinstance(step, Joined)
            columns, fill, size, *rest = step.image_pass.arguments(like_batch(x), running.columns)
            if has_one_size and i == of_list - 1:
                x, *_ = warp_and_color_list(x, columns, fill, size, *rest)
            else:
                sizes = sized.sizes_after(step.geometric, x) if sized.changes(step.geometric) else []
                x = list(warp_and_color_to_list(x, columns, fill, len(size) > 0, sizes, *rest)[: len(x)])
    return x
