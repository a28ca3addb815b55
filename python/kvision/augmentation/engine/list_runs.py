"""Runs of augmentations on a list of images, by the launches of a batch, whatever the number of images.

The draws are those of a batch, in one launch (list_plans.py). Steps give a list, until a crop or resize gives all images one size;
the rest is a run on a batch. Images for which other augmentations are applied, as the host decides where sizes change, are runs of
their own. What belongs to the images later, labels, parameters and the inverse, asks for the calls of parts, which the columns of
the list give. Where the first augmentation makes the list a batch, labels and the inverse follow that as one stage.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from itertools import repeat
from typing import Any

import torch
from torch import Tensor
from torch.compiler import is_compiling
from torch.nn.functional import pad

from kvision._constants import on_device
from kvision.augmentation.columns import Columns
from kvision.augmentation.draws import are_chosen_batches
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.drawing import decides, may_apply
from kvision.augmentation.engine.execution import Execution, ListExecution, Params, check_maps_of_params
from kvision.augmentation.engine.list_calls import refuse_list, seeds_of_list
from kvision.augmentation.engine.list_moves import LabelStep, label_steps, moves_of_run
from kvision.augmentation.engine.list_plans import (
    ListPlan,
    ReplayPlan,
    columns_of_sizes,
    kept_plan,
    kept_replay,
    takes_list,
    with_numbers,
)
from kvision.augmentation.engine.list_records import ListParts, record_of_run
from kvision.augmentation.engine.parts import Parts, params_of_rows
from kvision.augmentation.engine.passes import Running, Step, plan_steps
from kvision.augmentation.engine.record import Child, Record
from kvision.augmentation.engine.runs import execute, keep_executions, replayed, run_steps, runs_of, with_derived
from kvision.augmentation.engine.sized import SIZES, ImagesOfList, find_sized
from kvision.augmentation.engine.stages import Stage, Warp
from kvision.augmentation.keys import Keys
from kvision.augmentation.lists.masks import masks_of_one_type, move_masks
from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.sample_rows import index_of, numbers_by, read_rows
from kvision.augmentation.transforms import Transform
from kvision.augmentation.warp_and_color import SAME
from kvision.geometry.transform.lists.arguments import have_one_size, like_batch, row, some_of
from kvision.geometry.transform.lists.arguments import sizes as sides_of


class ListRun(ImagesOfList):
    """A run on a list: it draws, and has what it drew for the calls of its parts."""

    _drawn = 0  # columns before any are derived
    found: Tensor | None = None  # (B, 1, H, W) of the largest sides, what masks gave
    _label_steps: list[LabelStep] | None = None  # no cached property, whose lock has no graph before Python 3.12

    def __init__(self, images: list[Tensor], children: Sequence[Child], context: CallContext, plan: ListPlan) -> None:
        self.context, self.plan = context, plan
        self.modules: list[Any] = [child.module for child in children]
        self.names = [child.name for child in children]  # and not the children, whose records have this
        x = images[0]
        self.shape, self._type = (len(images), x.shape[0]), (x.dtype, x.device)  # (B, C)

    def run(self, images: list[Tensor]) -> tuple[Any, list[Stage], list[Execution]]:
        """The results, a list or a batch; of a list that the first augmentation makes a batch the stages and what each did."""
        plan, run, modules = self.plan, self.plan.run, self.modules
        keys = self.keys = plan.keys(images, self.context)
        result, columns, sides = plan.draw(images, keys, self.context.owners)
        super().__init__(plan.sized, sides)
        executions = plan.executions(images, columns, keys) if plan.reads_executions else []
        if run.derives and columns is not None:
            self._drawn = columns.shape[1]
            columns = with_derived(modules, executions, columns, run, self.context, self)
            columns = self._in_order(columns)
            executions = plan.executions(images, columns, keys)
        self.columns = columns
        if modules[0].needs_masks:
            self.found = modules[0]._find_in_list(images, executions[0], self.context)
        if plan.begins_with_batch:
            count = self.shape[0]
            parts = ListParts(self.context.op, count, [(range(count), self)], 0)
            executions[0] = ListExecution(parts, executions[0].columns)
        running = Running(modules, executions, columns, self.context.has_labels, result, of_list=self)
        y, stages = run_steps(images, run.steps, running)
        if self.context.labels is not None:
            self.context = self.context._replace(labels=None)  # which have the images, that would be kept
        return y if run.steps else list(images), stages, executions

    def sizes_before(self, number: int) -> Tensor:
        """Height and width (B, 2) of images before an augmentation."""
        sides = torch.tensor(self._sides_before(number), dtype=torch.float32, device="cpu")
        return on_device(sides.view(-1, 2), self.device)

    def _sides_before(self, number: int) -> Sequence[int]:
        return self.sides_before(number, self.plan.run.calls[number].shape)

    def labels_before(self, number: int, columns: Tensor) -> Any:
        """What an augmentation reads of the labels, with the columns of the run that are known by then."""
        labels, kind = self.context.labels, self.modules[number].reads_labels
        assert labels is not None
        before = copy(self)
        before.modules, before.columns = self.modules[:number], self._in_order(columns)
        before._label_steps = before._steps_of_labels(self.plan.before[number])
        if kind == "boxes":
            moves = moves_of_run(before)
            assert moves is not None  # by `find_sized`
            return labels.moved(moves).boxes((*self.shape, *self._sides_before(number)[:2]))
        masks, reading = labels.masks_of_samples(), labels.settings.masks
        return masks and [move_masks(masks_of_one_type(own, self.sides), before, reading) for own in masks]

    def _in_order(self, columns: Tensor) -> Tensor:
        """The columns in their order: those that are drawn, derived ones, 0 for those that are not known yet, numbers of sizes."""
        run, sized = self.plan.run, self._drawn
        width, missing = run.draws[0].plan[0], run.derived_columns - (columns.shape[1] - sized)
        return torch.cat([columns[:, :width], pad(columns[:, sized:], (0, missing)), columns[:, width:sized]], 1)

    @property
    def device(self) -> torch.device:
        """That of the images."""
        return self._type[1]

    @property
    def like(self) -> Tensor:
        """What has the type and the device of the images."""
        dtype, device = self._type
        return torch.empty(0, dtype=dtype, device=device)

    @property
    def label_steps(self) -> list[LabelStep]:
        """What labels follow, in their order."""
        if self._label_steps is None:
            self._label_steps = self._steps_of_labels(self.plan.run.steps)
        return self._label_steps

    def _steps_of_labels(self, steps: Sequence[Step]) -> list[LabelStep]:
        like = torch.empty(self.shape[0], 0, dtype=self._type[0], device=self.device)
        calls, columns = [(call.applies, call.shape) for call in self.plan.run.calls], self.columns
        if self.plan.numbers_of_labels is not None:
            columns = with_numbers(columns, self.plan.numbers_of_labels, self.sides, like)
        return label_steps(self.modules, calls, steps, columns, self, like, self.execution)

    def execution(self, number: int, rows: Sequence[int] | None = None) -> Execution:
        """What an augmentation did to all images, or to some of them, whatever their size."""
        execution = self.plan.run.executions(self.like, self.columns, self.keys)[number]
        execution.shape = (self.shape[0], *execution.shape[1:])
        execution = execution if rows is None else execution.of_rows(rows)
        if self.found is not None:
            found = self.found if rows is None else self.found.index_select(0, index_of(rows, self.found))
            execution.found = self.modules[number]._found(found)
        return execution

    @property
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

    def executions(self, rows: Sequence[int]) -> tuple[list[Execution], Tensor | None]:
        """What each augmentation did to images of one size, by their numbers, and the columns of these."""
        first = rows[0]
        columns, shape = self.columns, (len(rows), self.shape[1], *self.sides[2 * first : 2 * first + 2])
        if columns is not None and len(rows) < len(columns):
            columns = columns.index_select(0, torch.tensor(rows, device="cpu").to(columns.device))
        run = self.plan.run
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
        return executions, columns

    def record(self, rows: Sequence[int]) -> Record:
        """The call of images of one size."""
        executions, columns = self.executions(rows)
        children = [Child(*child) for child in zip(self.names, self.modules, repeat(None), executions)]
        return record_of_run(executions[0].shape, children, columns, self.like, self.context)

    def params_of_first(self) -> Params:
        """The parameters of the augmentation that makes the list a batch, read from the device at once."""
        module, span = self.modules[0], self.plan.run.calls[0].span
        generator, shapes = (
            module._param_generator,
            [(1, self.shape[1], h, w) for h, w in zip(self.sides[::2], self.sides[1::2])],
        )
        params: Params = {}
        if generator is not None:
            values = torch.empty(len(shapes), 0, device="cpu")
            if self.columns is not None and span is not None:
                values = Columns(self.columns, span).values.detach().cpu()
            each = [generator.to_params(row, shape) for row, shape in zip(values.split(1), shapes)]
            params = {name: torch.cat([own[name] for own in each]) for name in each[0]}
        params["batch_prob"] = torch.ones(len(shapes), device="cpu")
        params["forward_input_shape"] = torch.tensor(shapes, device="cpu")
        given: Params = module._as_given(params)
        return given

    def _noise(self, module: Any, number: int, image: int) -> PixelNoise:
        """The source of the noise of an augmentation in an image."""
        return PixelNoise(self._keys_of(image), number, module.same_on_batch, self.like.device, first=image)

    def _keys_of(self, image: int) -> Keys:
        keys = self.keys
        assert keys is not None
        return keys if keys.seeds is None else keys._replace(seeds=row(keys.seeds, image))


# --- calls ----------------------------------------------------------------------------------------------------------


def execute_list(images: list[Tensor], children: Sequence[Child], context: CallContext) -> tuple[Tensor, list[Stage]]:
    """Run children on a list of images that the first one makes a batch; gives that and what labels have to follow."""
    count, position, first = len(children), context.position, images[0]
    run = runs_of(children, context.plans)[0][0]
    ran, drawing, plan = len(run), 0, None
    if run[0].params is None:
        modules = [id(child.module) for child in children]
        key = ("list", first.shape[0], first.dtype, position, context.seed is None, context.output, *modules)
        ran, plan = context.plans.made(key, lambda: _plan_of_first(images, run, context, count))
        drawing = len(plan.run.drawing)
    own = context if ran == count else context._replace(output=SAME)
    begin = _replay_of_batch(images, run, own) if plan is None else ListRun(images, run[:ran], own, plan)
    x, stages, executions = begin.run(images)
    keep_executions(run, executions)
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
    """The results of a run, a list or a batch, and its parts; None where others run or replay it."""
    if not _is_run(images, children, context):
        return None
    modules: list[Any] = [child.module for child in children]
    count, seeds, first = len(images), None, modules[0]
    if children[0].params is not None:
        children = [_with_readable_chances(child) for child in children]
        groups = _given_groups(children, count)
    elif context.is_certain or not any(decides(m) or not m.has_known_size for m in modules):
        groups = [(range(count), [may_apply(m, context.is_certain) for m in modules])]
        if first.needs_masks and context.plans is not first._plans and context.seed is not None:  # as it runs by itself
            context = context._replace(seed=context.seed + ((context.position + 1) << 32), position=0)
    elif is_compiling() or have_one_size(images):  # a batch, which is decided for as one
        return None
    else:
        refuse_list(context.op, modules)
        seeds = seeds_of_list(context.op, modules, count, context.seed, context.generator_of(first))
        if any(map(decides, modules)):
            groups = _decided_groups(modules, seeds, context)
        else:
            groups = [(range(count), [may_apply(m, context.is_certain) for m in modules])]
    runs: list[tuple[Sequence[int], Any]] = []
    for samples, applied in groups:
        some, own, of_some = images, children, context
        if len(groups) > 1:
            some = some_of(images, samples)
            own = [replace(child, params=params_of_rows(child.params, samples, count)) for child in children]
        if seeds is not None:
            labels = None if context.labels is None else context.labels.some(samples, sides_of(images))
            of_some = context._replace(seed=read_rows(seeds, samples), generator=None, labels=labels)
        run = _prepared(some, own, applied, of_some)
        if run is None:
            return None
        runs.append((samples, run))
    if len(runs) == 1:  # with seeds a list, as all images may have been in one group by chance
        y, stages, _ = runs[0][1].run(images)
        y, stages = (y, stages) if seeds is None else (list(y), [])
    else:
        y, stages = list(images), []
        for samples, run in runs:
            for i, result in zip(samples, run.run(some_of(images, samples))[0]):
                y[i] = result
    parts = ListParts(context.op, count, runs)
    if children[0].params is not None:
        return y, parts
    executions = [ListExecution(parts.of_child(i)) for i in range(len(modules))]
    if len(modules) == 1 and stages and isinstance(stages[0], Warp):
        executions[0].matrix = stages[0].matrix
    keep_executions(children, executions)
    return y, parts


def _is_run(images: Sequence[Tensor], children: Sequence[Child], context: CallContext) -> bool:
    """Whether children draw together in one run, or one reads masks."""
    runs = runs_of(children, context.plans)
    if len(runs) != 1 or context.seed_of_samples is not context.seed:
        return False
    module: Any = children[0].module
    takes_masks = getattr(module, "needs_masks", False) and not module.mixes_samples
    if children[0].params is None:
        return runs[0][1] or bool(takes_masks and module._takes_masks(images, context))
    return (runs[0][1] or takes_masks) and not is_compiling() and all(child.samples is None for child in children)


def _prepared(
    images: list[Tensor], children: Sequence[Child], applied: Sequence[bool], context: CallContext
) -> ListRun | ListReplay | None:
    """What runs children on images for which the same ones are applied; None where others do."""
    if children[0].params is None:
        plan = kept_plan(images, [child.module for child in children], applied, context)
        return None if plan is None else ListRun(images, children, context, plan)
    given = kept_replay(images, children, applied, context)
    if given is None:
        return None
    replay = ListReplay(images, children, context, given)
    takes = all(takes_list(step, replay.running.modules, images[0].dtype) for step in replay.steps)
    return replay if takes else None


def _decided_groups(
    modules: Sequence[Any], seeds: Tensor, context: CallContext
) -> list[tuple[Sequence[int], Sequence[bool]]]:
    """The numbers of images for which the same augmentations are applied, and which these are, as `plan_run` decides by seeds."""
    number, columns = 0, list[list[bool]]()
    for module in modules:
        if not decides(module):
            columns.append([may_apply(module, context.is_certain)] * len(seeds))
        else:
            columns.append(are_chosen_batches(seeds, context.position + number, module.p_batch))
        number += may_apply(module, False) and module._request((1, 3, *SIZES[0])) is not None
    return _grouped(columns)


def _given_groups(children: Sequence[Child], count: int) -> list[tuple[Sequence[int], Sequence[bool]]]:
    """The same of given parameters, for augmentations that are applied to a batch or not."""
    columns: list[list[bool]] = []
    for child in children:
        module: Any = child.module
        chosen: Any = child.params.get("batch_prob") if module.whole_batch else None
        is_of_each = isinstance(chosen, Tensor) and len(chosen) == count
        columns.append((chosen > 0.5).tolist() if is_of_each else [True] * count)
    return _grouped(columns)


def _with_readable_chances(child: Child) -> Child:
    """A child with given parameters, of which the host reads to which images it is applied where that may change sizes."""
    module: Any = child.module
    chosen = child.params.get("batch_prob")
    if not module.whole_batch or not isinstance(chosen, Tensor) or not chosen.is_cuda:
        return child
    return replace(child, params={**child.params, "batch_prob": chosen.cpu()})


def _grouped(columns: Sequence[Sequence[bool]]) -> list[tuple[Sequence[int], Sequence[bool]]]:
    return [(samples, applied) for applied, samples in numbers_by(zip(*columns)).items()]


# --- with given parameters ------------------------------------------------------------------------------------------


class ListReplay:
    """A run on a list with given parameters."""

    def __init__(self, images: list[Tensor], children: Sequence[Child], context: CallContext, plan: ReplayPlan) -> None:
        modules: list[Any] = [child.module for child in children]
        like = like_batch(images)
        chains: Mapping[int, Sequence[Transform]] = {}
        shape = (len(images), images[0].shape[0], *SIZES[0])
        executions, columns = replayed(like.new_empty(1).expand(shape), children)
        of_list = ImagesOfList(plan.sized, sides_of(images))
        for number, (child, execution) in enumerate(zip(children, executions)):
            own = of_list.sides_before(number, execution.shape)
            check_maps_of_params(child.module, child.params, execution.shape[1], own)
        if columns is not None:
            columns = columns_of_sizes(plan.sized, children, executions, columns, of_list.sides)
            for execution in executions:
                if execution.columns is not None:
                    execution.columns = execution.columns._replace(drawn=columns)
        if plan.numbers is not None:
            width = 0 if columns is None else columns.shape[1]
            columns = with_numbers(columns, plan.numbers, of_list.sides, like)
            spans = [None if execution.columns is None else execution.columns.span for execution in executions]
            chains = plan.sized.bound(modules, spans, width)
        self.steps = plan_steps(modules, executions, context.once, images[0].dtype, context.output, chains)
        self.running = Running(modules, executions, columns, context.has_labels, of_list=of_list)
        self.modules, self.sides, self._like = modules, of_list.sides, like.new_empty(len(images), 0)

    @property
    def device(self) -> torch.device:
        """That of the images."""
        return self._like.device

    @property
    def label_steps(self) -> list[LabelStep]:
        """As those of :class:`ListRun`."""
        running = self.running
        calls = [(execution.applied, execution.shape) for execution in running.executions]
        assert running.of_list is not None
        return label_steps(
            self.modules, calls, self.steps, running.columns, running.of_list, self._like, self.execution
        )

    def execution(self, number: int, rows: Sequence[int] | None = None) -> Execution:
        """As that of :class:`ListRun`."""
        execution = self.running.executions[number]
        if rows is None:
            return execution
        own = execution.of_rows(rows)
        own.params = params_of_rows(execution.params, rows, execution.shape[0])
        return own

    def run(self, images: list[Tensor]) -> tuple[Any, list[Stage], Sequence[Execution]]:
        """As that of :class:`ListRun`."""
        y, stages = run_steps(images, self.steps, self.running)
        return y if self.steps else list(images), stages, self.running.executions


def _replay_of_batch(images: list[Tensor], run: Sequence[Child], context: CallContext) -> ListReplay:
    """What replays a run that makes a list a batch, wherever its parameters are."""
    child, op, channels = run[0], context.op, images[0].shape[0]
    module: Any = child.module
    given = {name: value for name, value in child.params.items() if name != "batch_prob"}  # 1 of all that makes batches

    def plan() -> ReplayPlan:
        sized = find_sized([module], [True], channels, context)
        assert sized is not None  # of what makes a list a batch
        return ReplayPlan(sized, sized.numbers(has_draws=False))

    planned = module._plans.made(("replay of a list", channels), plan)
    replay = ListReplay(images, [replace(child, params=given), *run[1:]], context, planned)
    parts = Parts.of_params(op, child.params, [x.shape for x in images], images, module._execution_of_part)
    first, *others = replay.running.executions
    replay.running.executions = [ListExecution(parts, first.columns), *others]
    return replay
