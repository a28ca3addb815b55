"""Runs of augmentations on a list of images, by the launches of a batch, whatever the number of images.

The draws are those of a batch, in one launch (list_plans.py). Steps give a list, until a crop or resize gives all images one size;
the rest is a run on a batch. Images for which other augmentations are applied, as the host decides where sizes change, are runs of
their own. What belongs to the images later, labels, parameters and the inverse, asks for the calls of parts, which the columns of
the list give. Where the first augmentation makes the list a batch, labels and the inverse follow that as one stage.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import repeat
from typing import Any

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision._constants import on_device
from kvision._dtype import compute_dtype
from kvision.augmentation.draws import are_chosen_batches
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.execution import Execution, ListExecution, Shape, matrix_type
from kvision.augmentation.engine.list_calls import Parts, params_of_rows, refuse_list, seeds_of_list
from kvision.augmentation.engine.list_plans import ListPlan, ReplayPlan, kept_plan, kept_replay, takes_given
from kvision.augmentation.engine.passes import Alone, Joined, Running, Step, plan_steps
from kvision.augmentation.engine.record import Child, Record
from kvision.augmentation.engine.runs import (
    decides,
    execute,
    keep_executions,
    may_apply,
    replayed,
    run_steps,
    runs_of,
    with_derived,
)
from kvision.augmentation.engine.sized import SIZES, ImagesOfList, find_sized
from kvision.augmentation.engine.stages import Chain, Stage, Warp
from kvision.augmentation.keys import Keys
from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.sample_rows import numbers_by, read_rows
from kvision.augmentation.transforms import Transform
from kvision.augmentation.warp_and_color import SAME
from kvision.geometry.transform.lists.arguments import have_one_size, like_batch, row, some_of
from kvision.geometry.transform.lists.arguments import sizes as sides_of


class ListRun(ImagesOfList):
    """A run on a list: it draws, and has what it drew for the calls of its parts."""

    found: Tensor | None = None  # (B, 1, H, W) of the largest sides, what masks gave

    def __init__(self, images: list[Tensor], children: Sequence[Child], context: CallContext, plan: ListPlan) -> None:
        self.context, self.plan = context, plan
        self.modules: list[Any] = [child.module for child in children]
        self.names = [child.name for child in children]  # and not the children, whose records have this
        x = images[0]
        self.shape, self._type = (len(images), x.shape[0]), (x.dtype, x.device)  # (B, C)

    def run(self, images: list[Tensor]) -> tuple[Any, list[Stage], list[Execution]]:
        """The results, a list or a batch; of a list that the first augmentation makes a batch the stages and what each did."""
        plan, run, modules, like = self.plan, self.plan.run, self.modules, like_batch(images)
        count = self.shape[0]
        keys = self.keys = plan.keys(like, count, self.context)
        result, columns, sides = plan.draw(images, like, keys, self.context.owners)
        super().__init__(plan.sized, sides)
        executions = plan.executions(like, count, columns, keys) if plan.reads_executions else []
        if run.derives and columns is not None:
            width, sized = run.draws[0].plan[0], columns.shape[1]  # the numbers of sizes follow what is derived
            sizes_before = partial(self._sizes_before, images)
            columns = with_derived(modules, executions, columns, run, self.context, sizes_before)
            columns = torch.cat([columns[:, :width], columns[:, sized:], columns[:, width:sized]], 1)
            executions = plan.executions(like, count, columns, keys)
        self.columns = columns
        if modules[0].needs_masks:
            self.found = modules[0]._find_in_list(images, executions[0], self.context)
        if plan.begins_with_batch:
            executions[0] = ListExecution(self.parts(0), executions[0].columns)
        running = Running(modules, executions, columns, self.context.has_labels, result, of_list=self)
        y, stages = run_steps(images, run.steps, running)
        return y if run.steps else list(images), stages, executions

    def parts(self, child: int | None = None) -> ListParts:
        """The parts of a call with all images in this run, or those of one child."""
        return ListParts(self.context.op, [(range(self.shape[0]), self)], child)

    def _sizes_before(self, images: Sequence[Tensor], number: int) -> Tensor:
        """Height and width (B, 2) of images before an augmentation."""
        sizes = torch.tensor(self.sized.sizes_after(range(number), images), dtype=torch.float32, device="cpu")
        return on_device(sizes.view(-1, 2), images[0].device)

    @cached_property
    def like(self) -> Tensor:
        """What has the type and the device of the images."""
        dtype, device = self._type
        return torch.empty(0, dtype=dtype, device=device)

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
        children = [Child(*child) for child in zip(self.names, self.modules, repeat(None), executions)]
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


_Samples = tuple[Sequence[int], ListRun]  # the numbers of images, and the run of these


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


# --- calls ----------------------------------------------------------------------------------------------------------


def execute_list(images: list[Tensor], children: Sequence[Child], context: CallContext) -> tuple[Tensor, list[Stage]]:
    """Run children on a list of images that the first one makes a batch; gives that and what labels have to follow."""
    count, position, first = len(children), context.position, images[0]
    run = runs_of(children, context.plans)[0][0]
    if run[0].params is not None:
        own = context if count == 1 else context._replace(output=SAME)
        (x, stages), ran, drawing = _replay_batch(images, run[0], own), 1, 0
    else:
        modules = [id(child.module) for child in children]
        key = ("list", first.shape[0], first.dtype, position, context.seed is None, context.output, *modules)
        ran, plan = context.plans.made(key, lambda: _plan_of_first(images, run, context, count))
        own = context if ran == count else context._replace(output=SAME)
        x, stages, executions = ListRun(images, run[:ran], own, plan).run(images)
        keep_executions(run, executions)
        drawing = len(plan.run.drawing)
    for end, at in ((len(run), position + drawing), (count, position + len(run))):
        if ran < end:
            own = context if end == count else context._replace(output=SAME)
            x, more = execute(x, children[ran:end], own.after(stages), at)
            stages, ran = [*stages, *more], end
    return x, stages


def _plan_of_first(
    images: list[Tensor], run: Sequence[Child], context: CallContext, count: int
) -> tuple[int, ListPlan]:
    """How many of `count` children run on a list that the first one makes a batch, and their plan."""
    modules: list[Any] = [child.module for child in run]
    # What decides in each call whether it is applied, or reads labels, is executed after the first one.
    is_planned = not any(decides(m) or m._derives for m in modules)
    for ran in (len(run), 1) if is_planned else (1,):
        own = context if ran == count else context._replace(output=SAME)
        plan = kept_plan(images, modules[:ran], [may_apply(m, False) for m in modules[:ran]], own)
        if plan is not None:
            return ran, plan
    raise AssertionError("expected an augmentation that makes a list a batch")


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
    warps: Sequence[Stage] = ()
    if context.is_certain or not any(decides(m) or not m.has_known_size for m in modules):
        plan = kept_plan(images, modules, [may_apply(m, context.is_certain) for m in modules], context)
        if plan is None:
            return None
        run = ListRun(images, children, context, plan)
        y, warps, _ = run.run(images)
        parts = run.parts()
    else:
        decided = _run_decided(images, children, context)
        if decided is None:
            return None
        y, parts = decided
    executions = [ListExecution(parts.of_child(i)) for i in range(len(modules))]
    if len(modules) == 1 and warps and isinstance(warps[0], Warp):
        executions[0].matrix = warps[0].matrix
    keep_executions(children, executions)
    return y, parts


def _run_decided(
    images: list[Tensor], children: Sequence[Child], context: CallContext
) -> tuple[list[Any], ListParts] | None:
    """The results of a run whose augmentations are applied to some images, and its parts: a run for each choice of them."""
    if is_compiling() or have_one_size(images):  # a batch, which is decided for as one
        return None
    modules: list[Any] = [child.module for child in children]
    refuse_list(context.op, modules)
    seeds = seeds_of_list(context.op, modules, len(images), context.seed, context.generator_of(modules[0]))
    runs: list[_Samples] = []
    for samples, applied in _decided(modules, seeds, context):
        labels = None if context.labels is None else context.labels.some(samples)
        own = context._replace(seed=read_rows(seeds, samples), generator=None, labels=labels)
        some, plan = some_of(images, samples), kept_plan(images, modules, applied, own)
        if plan is None:
            return None
        runs.append((samples, ListRun(some, children, own, plan)))
    results: list[Any] = list(images)
    for samples, run in runs:
        y, _, _ = run.run(some_of(images, samples))
        for i, result in zip(samples, y):
            results[i] = result
    return results, ListParts(context.op, runs)


def _decided(modules: Sequence[Any], seeds: Tensor, context: CallContext) -> list[tuple[Sequence[int], Sequence[bool]]]:
    """The numbers of images for which the same augmentations are applied, and which these are, as `plan_run` decides by seeds."""
    number, columns = 0, list[list[bool]]()
    for module in modules:
        if not decides(module):
            columns.append([may_apply(module, context.is_certain)] * len(seeds))
        else:
            columns.append(are_chosen_batches(seeds, context.position + number, module.p_batch))
        number += may_apply(module, False) and module._request((1, 3, *SIZES[0])) is not None
    return _grouped(columns)


def _grouped(columns: Sequence[Sequence[bool]]) -> list[tuple[Sequence[int], Sequence[bool]]]:
    """The numbers of images for which the same augmentations are applied, and which these are, of a column for each."""
    return [(samples, applied) for applied, samples in numbers_by(zip(*columns)).items()]


# --- with given parameters ------------------------------------------------------------------------------------------


def run_or_replay(
    images: list[Tensor], children: Sequence[Child], context: CallContext
) -> tuple[Any, ListParts | None] | None:
    """The results of a run and its parts, None of a replay; None where others run or replay it."""
    if children[0].params is None:
        return run_list(images, children, context)
    y = replay_list(images, children, context)
    return None if y is None else (y, None)


def replayed_record(
    children: Sequence[Child], context: CallContext, like: Tensor, shape: Shape, params: Sequence[Any]
) -> Record:
    """The record of a run on images of a shape with the parameters of its children, without running it."""
    own = [replace(child, params=item.data) for child, item in zip(children, params)]
    executions, columns = replayed(like.expand(shape), own)
    of_run = [replace(child, record=execution) for child, execution in zip(own, executions)]
    return record_of_run(shape, of_run, columns, like, context)


def replay_list(images: list[Tensor], children: Sequence[Child], context: CallContext) -> Any:
    """The results of a run with the parameters of its children, a list or a batch; None where others replay it."""
    runs = runs_of(children, context.plans)
    if is_compiling() or len(runs) != 1 or not runs[0][1] or any(child.samples is not None for child in children):
        return None
    if any(isinstance(x, Tensor) and x.is_cuda for child in children for x in child.params.values()):
        return None
    groups = _groups(children, len(images))
    if len(groups) > 1:
        return _replay_groups(images, children, context, groups)
    ((_, applied),) = groups
    plan = kept_replay(images, children, applied, context)
    replay = None if plan is None else _replayed(images, children, context, plan)
    if plan is None or replay is None:
        return None
    steps, running = replay
    if plan.has_sized_identity and any(execution.chosen is not None for execution in running.executions):
        return None
    if not all(takes_given(step, running.modules, images[0].dtype) for step in steps):
        return None
    return run_steps(images, steps, running)[0] if steps else list(images)


def _replayed(
    images: list[Tensor], children: Sequence[Child], context: CallContext, plan: ReplayPlan
) -> tuple[list[Step], Running]:
    """What executes children with their parameters."""
    modules: list[Any] = [child.module for child in children]
    like = like_batch(images)
    chains: Mapping[int, Sequence[Transform]] = {}
    executions, columns = replayed(like.new_empty(1).expand(len(images), images[0].shape[0], *SIZES[0]), children)
    if plan.numbers is not None:
        own = on_device(plan.numbers.of_each(images).to(compute_dtype(like)), like.device)
        width = 0 if columns is None else columns.shape[1]
        columns = own if columns is None else torch.cat([columns.to(own), own], 1)
        spans = [None if execution.columns is None else execution.columns.span for execution in executions]
        chains = plan.sized.bound(modules, spans, width)
    steps = plan_steps(modules, executions, context.once, images[0].dtype, context.output, chains)
    return steps, Running(modules, executions, columns, False, of_list=ImagesOfList(plan.sized, sides_of(images)))


def _replay_batch(images: list[Tensor], child: Child, context: CallContext) -> tuple[Tensor, list[Stage]]:
    """The batch that an augmentation makes of a list with its parameters, and what labels have to follow."""
    module: Any = child.module
    given = {name: value for name, value in child.params.items() if name != "batch_prob"}  # 1 of all that makes batches
    channels = images[0].shape[0]

    def plan() -> ReplayPlan:
        sized = find_sized([module], [True], channels, context)
        assert sized is not None  # of what makes a list a batch
        return ReplayPlan(sized, sized.numbers(has_draws=False))

    planned = module._plans.made(("replay of a list", channels), plan)
    steps, running = _replayed(images, [replace(child, params=given)], context, planned)
    parts = Parts.of_params(context.op, child.params, [x.shape for x in images], images, module._execution_of_part)
    running.executions = [ListExecution(parts, running.executions[0].columns, is_certain=True)]
    keep_executions([child], running.executions)
    return run_steps(images, steps, running)


def _groups(children: Sequence[Child], count: int) -> list[tuple[Sequence[int], Sequence[bool]]]:
    """The images for which the same augmentations are applied, of those that are applied to a batch or not."""
    columns: list[list[bool]] = []
    for child in children:
        module: Any = child.module
        chosen: Any = child.params.get("batch_prob") if module.whole_batch else None
        is_of_each = isinstance(chosen, Tensor) and len(chosen) == count
        columns.append((chosen > 0.5).tolist() if is_of_each else [True] * count)
    return _grouped(columns)


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
