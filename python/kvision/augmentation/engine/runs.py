"""Execution of containers: adjacent children are joined into few passes over the images.

A run of augmentations draws all its parameters in one launch. Then

    one warp               executes neighboring flips, quarter turns, crops of whole pixels, and one resampling that interpolates
    one window resized     executes a crop with antialiasing and the flips next to it
    one color program      executes neighboring color steps
    one pass               executes a warp and the color program behind it, and writes the type and layout that are wanted

and what is left runs by itself.

What is computed is what the augmentations compute one after the other, up to rounding. Bytes are rounded behind each geometric
augmentation, behind each that runs by itself, and once behind neighboring color steps. With `resample="once"` all neighboring
geometric augmentations are resampled once: as a warp by the product of their matrices, antialiased if one of them is, or, with maps
among them, at the coordinates that they compose to. Which passes there are follows from the settings and the sizes of the images,
so that it is decided once for them.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import torch
from torch import Tensor

from kvision.augmentation.columns import Columns
from kvision.augmentation.drawn_pass import DrawnPass
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.configuration import Plans
from kvision.augmentation.engine.declaration import size_of
from kvision.augmentation.engine.execution import Execution, check_maps_of_params
from kvision.augmentation.engine.executor import Executor, decides
from kvision.augmentation.engine.passes import Alone, Joined, Running, Step, plan_steps
from kvision.augmentation.engine.record import Child
from kvision.augmentation.engine.run_plans import RunPlan, plan_run
from kvision.augmentation.engine.stages import Applied, Stage
from kvision.augmentation.keys import Keys, check_seeds
from kvision.augmentation.warp_and_color import SAME, frames_pass
from kvision.color.frames import Frames


def execute(
    x: Tensor, children: Sequence[Child], context: CallContext, position: int | None = None
) -> tuple[Tensor, list[Stage]]:
    """Run children on images (B, C, H, W); gives the result and what labels have to follow."""
    position = context.position if position is None else position
    key = _key(x, children, context, position)
    plan: RunPlan | None = context.plans.get(key)
    if plan is not None:
        return _execute_run(x, children, context, position, plan)
    stages: list[Stage] = []
    runs = runs_of(children, context.plans)
    if context.source is not None and not (runs and _reads_frames(*runs[0])):
        x, context = images_of(context.source), context._replace(source=None)
    for i, (run, is_joined) in enumerate(runs):
        own = context if i == len(runs) - 1 or context.output is SAME else context._replace(output=SAME)
        if is_joined:
            x, more = _execute_run(x, run, own.after(stages), position)
            stages += more
        else:
            x, stage = _execute_alone(x, run[0], context.after(stages), position)
            x = own.converted(x)
            stages.append(stage)
        position += len(run)
        if context.source is not None:
            context = context._replace(source=None)
    return x if runs else context.converted(x), stages


def _reads_frames(run: Sequence[Child], is_joined: bool) -> bool:
    """Whether the first run takes frames of video: augmentations, or a container of such."""
    return is_joined or getattr(run[0].module, "_reads_frames", False)


def _read_frames(frames: Frames, like: Tensor, step: Step, running: Running) -> tuple[Tensor, Tensor | None] | None:
    """What the first step makes of frames, where it reads their planes."""
    if isinstance(step, Joined):
        return frames_pass(frames, step.image_pass, running.columns)
    if isinstance(step, Alone) and hasattr(running.modules[step.number], "_resize_frames"):
        module, execution = running.modules[step.number], running.executions[step.number]
        execution.matrix = module._matrix_of(like, execution, module.flags)
        return module._resize_frames(frames, module.flags), None
    return None


def images_of(frames: Frames) -> Tensor:
    """The images (B, 3, H, W) that frames are."""
    rgb = frames.rgb()
    return rgb[None] if frames.is_single else rgb


def _execute_alone(x: Tensor, child: Child, context: CallContext, position: int) -> tuple[Tensor, Stage]:
    """An augmentation of images by their masks, another container, or any nn.Module of images."""
    module: Any = child.module
    if hasattr(module, "_execute_nested"):
        y, stage, child.record = module._execute_nested(x, child.params, inside_child(context, position))
        return y, stage
    if not hasattr(module, "_contribution"):
        y = module(x)
        if not isinstance(y, Tensor):  # as the views of TenCrop
            expected = f"{context.op}: expected children that return a tensor of images"
            raise TypeError(f"{expected}, got a {type(y).__name__} from {type(module).__name__}; call it on the result")
        child.foreign_params = getattr(module, "_params", None)
        return y, Stage()
    masks = None if context.labels is None else context.labels.first_masks()
    seed = context.seed_of_samples
    if seed is not None:
        seed = seed + ((position + 1) << 32)  # as a seed is that of a chain of one
    certain = {"is_certain": True} if context.is_certain else {}  # in choices, whose children mix no samples
    y, child.record = module._run_with_masks(x, masks, child.params, seed, context.generator_of(module), **certain)
    return y, Applied(module, child.record, module.flags)


def inside_child(context: CallContext, position: int) -> CallContext:
    """The context for the container at a position: its chain begins where its draws are not those of others."""
    return context._replace(position=(position + 1) * 256 % (1 << 20))


def _key(x: Tensor, children: Sequence[Child], context: CallContext, position: int) -> Hashable:
    """The key of the plan of a run: all that it depends on besides the settings of modules."""
    _, seed, _, once, _, output, frames, _, time, *_, is_certain, owners, source = context
    modules = [(id(child.module), child.params is None) for child in children]
    own = (x.shape, x.dtype, position, seed is None, once, output, frames, time, is_certain, owners is None)
    return (*own, *modules) if source is None else ("frames", *own, *modules)


def runs_of(children: Sequence[Child], plans: Plans) -> list[tuple[Sequence[Child], bool]]:
    """Split children into augmentations that draw together, with True, and what runs by itself."""
    key = ("runs", *[(id(child.module), child.params is None) for child in children])
    runs, first = [], 0
    for length, is_joined in plans.made(key, lambda: _lengths_of_runs(children)):
        runs.append((children[first : first + length], is_joined))
        first += length
    return runs


def _lengths_of_runs(children: Sequence[Child]) -> list[tuple[int, bool]]:
    lengths: list[tuple[int, bool]] = []
    before: Child | None = None
    for child in children:
        module: Any = child.module
        runs_alone = not hasattr(module, "_contribution") or module.needs_masks
        # What gives another size than expected ends a run.
        has_known_size = not runs_alone and module.has_known_size and not module._is_customized()
        if before is not None and has_known_size and (child.params is None) == (before.params is None):
            lengths[-1] = (lengths[-1][0] + 1, True)
        else:
            lengths.append((1, not runs_alone))
        before = child if has_known_size else None
    return lengths


def _execute_run(
    x: Tensor, run: Sequence[Child], context: CallContext, position: int, plan: RunPlan | None = None
) -> tuple[Tensor, list[Stage]]:
    modules: list[Executor] = [child.module for child in run]  # type: ignore[misc]  # by runs_of
    result: tuple[Tensor, Tensor | None] | None = None
    links: Sequence[Tensor] | None = None
    if run[0].params is not None:
        executions, columns = replayed(x, run)
        for child, execution in zip(run, executions):
            check_maps_of_params(child.module, child.params, execution.shape[1], execution.shape[-2:])
        steps: Sequence[Step] = plan_steps(modules, executions, context.once, x.dtype, context.output)
    else:
        keys = None
        if plan is None:
            plan, keys = _kept_plan(x, run, context, position)
        if keys is None and plan.draws:
            keys = context.keys(plan.drawing, x)
        if keys is not None and keys.seeds is not None:
            check_seeds(context.op, keys, x[:: context.frames].shape[0])
        if plan.drawn is None or keys is None or (context.source is not None and isinstance(plan.drawn, DrawnPass)):
            columns = plan.columns(x, keys, context)
        else:
            columns, result, links = plan.drawn.draw(x, keys)
        executions, steps = plan.executions(x, columns, keys, context.frames), plan.steps
        if columns is not None and plan.derives:
            columns = with_derived(modules, executions, columns, plan, context)
    running = Running(modules, executions, columns, context.has_labels, result, links)
    if context.source is not None:
        running.result = _read_frames(context.source, x, steps[0], running) if steps else None
        x = x if running.result is not None else images_of(context.source)
    keep_executions(run, executions)
    return run_steps(x, steps, running)


def keep_executions(run: Sequence[Child], executions: Sequence[Execution]) -> None:
    """Let these be what children did in the call."""
    for child, execution in zip(run, executions):
        child.record = child.module.__dict__["_execution"] = execution  # faster than Module.__setattr__


def run_steps(x: Any, steps: Sequence[Step], running: Running) -> tuple[Any, list[Stage]]:
    """Run steps of a plan on a batch or a list; gives the result and what labels have to follow."""
    stages: list[Stage] = []
    for step in steps:
        x, stage = step.run(x, running)
        if stage is not None:
            stages.append(stage)
    return x, stages


def replayed(x: Tensor, run: Sequence[Child]) -> tuple[list[Execution], Tensor | None]:
    """The executions of augmentations with the parameters that they replay, and the columns of all."""
    executions, shape, drawn = [], tuple(x.shape), []
    for child in run:
        module: Executor = child.module  # type: ignore[assignment]  # by runs_of
        execution = module._from_params(child.params, x.new_empty(1).expand(shape))  # of its shape only
        if execution.applied:
            shape = module.output_shape(execution.shape, module.flags)
        executions.append(execution)
        if execution.columns is not None:
            drawn.append(execution.columns.drawn)
    if not drawn:
        return executions, None
    columns, width = torch.cat(drawn, 1) if len(drawn) > 1 else drawn[0], 0
    for execution in executions:
        if execution.columns is not None:
            span = execution.columns.span
            execution.columns, width = Columns(columns, span.moved(width)), width + span.width
    return executions, columns


def _kept_plan(x: Tensor, run: Sequence[Child], context: CallContext, position: int) -> tuple[RunPlan, Keys | None]:
    """The cached or new plan of a run, and the keys that `plan_run` had to draw."""
    key = _key(x, run, context, position)
    plan: RunPlan | None = context.plans.get(key)
    if plan is not None:
        return plan, None
    modules: list[Executor] = [child.module for child in run]  # type: ignore[misc]  # by runs_of
    plan, keys = plan_run(x, modules, context, position)
    if (context.is_certain or not any(map(decides, modules))) and all(draws.learned is None for draws in plan.draws):
        context.plans.keep(key, plan)
    return plan, keys


def with_derived(
    modules: Sequence[Executor],
    executions: Sequence[Execution],
    columns: Tensor,
    plan: RunPlan,
    context: CallContext,
    of_list: Any = None,
) -> Tensor:
    """The columns of a run, and behind them those that augmentations derive from the labels that are there before each of them.

    A run `of_list` says `sizes_before` (B, 2) and `labels_before` each augmentation.
    """
    stages: list[Stage] = []
    parts = [columns]
    for number, (module, execution, call) in enumerate(zip(modules, executions, plan.calls)):
        if call.derived_from is not None:
            labels = None
            if module.reads_labels is not None and context.labels is not None:
                if of_list is None:
                    labels = context.labels.after(stages).read(module.reads_labels, execution.shape, context.frames)
                else:
                    labels = of_list.labels_before(number, torch.cat(parts, 1))
                labels = labels.to(columns.device) if isinstance(labels, Tensor) else labels
            drawn = Columns(columns, call.derived_from)
            sizes = size_of(execution.shape, columns) if of_list is None else of_list.sizes_before(number)
            execution.columns = module._derived(drawn, sizes, labels, context.frames)
            execution.redraw = None  # the host does not know the labels
            parts.append(execution.columns.drawn)
        if execution.applied or module.mixes_samples:
            stages.append(Applied(module, execution, module.flags))
    columns = torch.cat(parts, 1)
    for execution, call in zip(executions, plan.calls):
        if call.derived_from is not None and call.span is not None:
            execution.columns = Columns(columns, call.span)
    return columns
