"""Execution of containers: adjacent children are joined into few passes over the images.

A run of augmentations draws all its parameters in one launch. Then

    one warp               executes neighboring flips, quarter turns, crops of whole pixels, and one resampling that interpolates
    one window resized     executes a crop with antialiasing and the flips next to it
    one color program      executes neighboring color steps
    one pass               executes a warp and the color program behind it, and writes the type and layout that are wanted

and what is left runs by itself.

What is computed is what the augmentations compute one after the other, up to rounding. Bytes are rounded behind each geometric
augmentation, behind each that runs by itself, and once behind neighboring color steps. With `resample="once"` all neighboring
geometric augmentations are resampled once: as a warp by the product of their matrices, or, with maps or antialiasing among them, at
the coordinates that they compose to. Which passes there are follows from the settings and the sizes of the images, so that it is
decided once for them.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor, nn

from kvision._constants import constant
from kvision.augmentation.columns import Columns, DrawPlan, Span, identity_values, plan_draws
from kvision.augmentation.drawn_links import DrawnLinks
from kvision.augmentation.drawn_pass import DrawnPass
from kvision.augmentation.draws import Request
from kvision.augmentation.engine.augmentation import AugmentationBase
from kvision.augmentation.engine.call_labels import CallLabels
from kvision.augmentation.engine.configuration import Plans
from kvision.augmentation.engine.declaration import size_of
from kvision.augmentation.engine.execution import Execution, Shape, matrix_type
from kvision.augmentation.engine.frames import frames_pass
from kvision.augmentation.engine.list_calls import SIZES
from kvision.augmentation.engine.lists import ListImages, ListWarp, chain_of_list, execute_list
from kvision.augmentation.engine.passes import Alone, Joined, Planned, Running, Step, plan_steps
from kvision.augmentation.engine.record import Child
from kvision.augmentation.engine.stages import Applied, Chain, Stage
from kvision.augmentation.keys import Keys, Seed, check_seeds, draw_keys, frame_seeds
from kvision.augmentation.warp_and_color import SAME, Output, make_pass
from kvision.augmentation.warp_and_color_list import warp_and_color_list
from kvision.color.frames import Frames
from kvision.geometry.transform.lists.arguments import like_batch


class CallContext(NamedTuple):
    """What the children of a container have in common in one call: the randomness they draw from, and what is asked of results."""

    op: str
    seed: Seed
    generator: Generator | None  # of the call: it replaces those of all modules
    once: bool  # one resampling for neighboring geometric augmentations
    plans: Plans  # of the container
    output: Output = SAME  # the type and layout of the results
    frames: int = 1  # how many neighboring samples share their parameters: the frames of a video
    position: int = 0  # of the first child in the chain, under a seed
    time: int = 0  # how many neighboring samples are the frames of a video; 0 for images
    has_labels: bool = False  # which follow the images, so that maps are kept for them
    labels: CallLabels | None = None  # of the images, for draws that read them
    default_generator: Generator | None = None  # of the container, for children without one of their own
    is_certain: bool = False  # children are executed for all samples, whatever their probabilities say
    # (B,) on the CPU: the number of the only child that a sample gets, of a run which then is certain; None where it gets all.
    owners: Tensor | None = None
    source: Frames | None = None  # of which the images are, before the first child; these have no values then

    @classmethod
    def of_module(cls, op: str, seed: Seed, generator: Generator | None) -> CallContext:
        """That of a module by itself, without a container."""
        return cls(op, seed, generator, False, Plans())

    def generator_of(self, module: nn.Module) -> Generator | None:
        """The generator that draws for a module; None for torch's."""
        return self.generator or getattr(module, "generator", None) or self.default_generator

    def inside(self, module: nn.Module, once: bool, plans: Plans, output: Output) -> CallContext:
        """For the children of a container that is a child."""
        labels = None if self.labels is None else self.labels.inside(getattr(module, "_label_settings", None))
        own = (self.frames, self.position, self.time, self.has_labels, labels, self.generator_of(module))
        inside = CallContext(self.op, self.seed, self.generator, once, plans, output, *own)  # faster than _replace
        return inside if self.source is None else inside._replace(source=self.source)

    @property
    def seed_of_samples(self) -> Seed:
        """The seed of a call; seeds of videos as those of their frames, where these have parameters of their own."""
        if isinstance(self.seed, Tensor) and self.seed.dim() == 1 and self.time > 0 and self.frames == 1:
            return frame_seeds(self.seed, self.time)
        return self.seed


def execute(
    x: Any, children: Sequence[Child], context: CallContext, position: int | None = None, before: int = 0
) -> tuple[Tensor, Chain]:
    """Run children on images (B, C, H, W), or a list of images; gives the result and what labels have to follow.

    `before` is how many children of the first run have run already, and have drawn nothing.
    """
    position = context.position if position is None else position
    if isinstance(x, list):
        x, first, ran, drawn = _execute_list(x, children, context, position)
        if ran == len(children):  # and has given the result its type and layout
            return x, Chain(first)
        x, rest = execute(x, children[ran:], _after(first, context), position + drawn, ran - drawn)
        return x, Chain([*first, *rest])
    key = _key(x, children, context, position)
    plan: _RunPlan | None = context.plans.get(key)
    if plan is not None:
        return _execute_run(x, children, context, position, plan)
    stages: list[Stage] = []
    runs = _runs(children, context.plans)
    if context.source is not None and not (runs and _reads_frames(*runs[0])):
        x, context = images_of(context.source), context._replace(source=None)
    for i, (run, kind) in enumerate(runs):
        own = context if i == len(runs) - 1 or context.output is SAME else context._replace(output=SAME)
        if kind == "joined":
            x, more = _execute_run(x, run, _after(stages, own), position)
            stages += more.stages
        elif kind == "with masks":
            x, stage = _execute_with_masks(x, run[0], _after(stages, context), position)
            stages.append(stage)
        else:
            inside = _after(stages, context)._replace(position=_position_inside(position))
            x, stage = _execute_module(x, run[0], inside)
            if own.output != SAME:
                x, _ = make_pass(None, output=own.output).run(x, None)
            stages.append(stage)
        position, before = position + len(run) + before, 0
        if context.source is not None:
            context = context._replace(source=None)
    if not runs and context.output != SAME:
        x, _ = make_pass(None, output=context.output).run(x, None)
    return x, Chain(stages)


def _reads_frames(run: Sequence[Child], kind: str) -> bool:
    """Whether the first run takes frames of video: augmentations, or a container of such."""
    return kind == "joined" or (kind == "alone" and getattr(run[0].module, "_reads_frames", False))


def _read_frames(
    frames: Frames,
    like: Tensor,
    step: Step,
    modules: Sequence[Any],
    executions: Sequence[Execution],
    columns: Tensor | None,
) -> tuple[Tensor, Tensor | None] | None:
    """What the first step makes of frames, where it reads their planes."""
    if isinstance(step, Joined):
        return frames_pass(frames, step.image_pass, columns)
    if isinstance(step, Alone) and hasattr(modules[step.number], "_resize_frames"):
        module, execution = modules[step.number], executions[step.number]
        execution.matrix = module._matrix_of(like, execution, module.flags)
        return module._resize_frames(frames, module.flags), None
    return None


def images_of(frames: Frames) -> Tensor:
    """The images (B, 3, H, W) that frames are."""
    rgb = frames.rgb()
    return rgb[None] if frames.is_single else rgb


def _execute_list(
    images: list[Tensor], children: Sequence[Child], context: CallContext, position: int
) -> tuple[Tensor, list[Stage], int, int]:
    """The first children on a list of images, of which the first one makes it a batch: the result, the stages, how many they
    are, and how many positions in the chain of draws they take.
    """
    module: Any = children[0].module
    keys = None
    run, kind = _runs(children, context.plans)[0]
    if kind == "joined" and run[0].params is None:
        own = context if len(run) == len(children) else context._replace(output=SAME)
        plan = _list_plan(images, run, own, position)
        if plan is not None:
            x, stages = _execute_list_run(images, run, own, plan)
            return x, stages, len(run), len(run)
    if children[0].params is None and module._request((len(images), *images[0].shape)) is not None:
        keys = _more_keys(None, [module], images[0], context)
        if keys.seeds is not None:
            check_seeds(context.op, keys, len(images))
    x, stage = execute_list(images, children[0], module, keys, position, context.labels)
    if len(children) == 1 and context.output != SAME:
        x, _ = make_pass(None, output=context.output).run(x, None)
    return x, [stage], 1, int(keys is not None)


def _list_plan(images: list[Tensor], run: Sequence[Child], context: CallContext, position: int) -> _RunPlan | None:
    """The kept or new plan of a run on a list, whatever its sizes; None where the first child is executed by itself."""
    x = images[0]
    modules: list[Any] = [child.module for child in run]  # augmentations
    key = ("list", len(images), x.shape[0], x.dtype, position, context.seed is None, context.output, *map(id, modules))
    kept: tuple[_RunPlan | None] | None = context.plans.get(key)
    if kept is None:
        shape = (len(images), x.shape[0], *SIZES[0])
        # What decides in each call whether it is applied, or reads labels, is executed after the first one.
        decides = any((m.whole_batch and 0 < m.p_batch < 1) or m._derives for m in modules)
        plan = None
        if not decides and context.frames == 1 and context.owners is None and not context.is_certain:
            plan, _ = _plan_run(x.detach().new_empty(1).expand(shape), modules, context, position, True)
            step = plan.steps[0] if plan.steps else None
            is_joined = isinstance(step, Joined) and len(step.geometric) > 0 and step.geometric[0] == 0
            if not is_joined or len(plan.draws) > 1 or any(draws.learned is not None for draws in plan.draws):
                plan = None
        kept = (plan,)
        context.plans.keep(key, kept)
    return kept[0]


def _execute_list_run(
    images: list[Tensor], run: Sequence[Child], context: CallContext, plan: _RunPlan
) -> tuple[Tensor, list[Stage]]:
    modules: list[AugmentationBase] = [child.module for child in run]  # type: ignore[misc]  # by _runs
    like, step, keys = like_batch(images), plan.steps[0], None
    assert isinstance(step, Joined)
    if plan.draws:
        keys = _more_keys(None, plan.modules, like, context)
        if keys.seeds is not None:
            check_seeds(context.op, keys, len(images))
    own, result = ListImages(images, modules[0]), None
    draws = plan.requests[0] is not None
    if isinstance(plan.drawn, DrawnPass) and keys is not None and draws and own.only_windows_differ:
        result = plan.drawn.run_list(images, keys)
    columns: Tensor | None = None
    if result is not None:
        x, matrix, columns = result
    else:
        if keys is not None:
            columns = plan.draws[0].draw_list(like, keys, own.numbers_of_draws() if draws else ())
        columns = own.with_sizes(columns, like)
        x, matrix, _ = warp_and_color_list(images, *step.image_pass.arguments(like, columns))
    executions = _executions(like, plan, columns, keys, 1)
    drawn = like.new_empty(len(images), 0, dtype=torch.float32) if columns is None else columns
    span = plan.spans[0] or Span(0, 0, False)
    executions[0] = own.execution(drawn, span, matrix_type(like), matrix if len(step.geometric) == 1 else None)
    for child, module, execution in zip(run, modules, executions):
        child.record = module.__dict__["_execution"] = execution  # faster than Module.__setattr__
    assert step.resampling is not None
    stages: list[Stage] = [ListWarp(matrix, own.sides, list(step.size), step.resampling)]
    running = Running(modules, executions, columns, context.has_labels)
    for later in plan.steps[1:]:
        x, stage = later.run(x, running)
        if stage is not None:
            stages.append(stage)
    return x, stages


def _after(stages: Sequence[Stage], context: CallContext) -> CallContext:
    """The context of what comes after stages, with the labels that they leave."""
    if context.labels is None or not stages:
        return context
    return context._replace(labels=context.labels.after(stages))


def _execute_with_masks(x: Tensor, child: Child, context: CallContext, position: int) -> tuple[Tensor, Stage]:
    """An augmentation of images by their masks."""
    module: Any = child.module
    masks = [] if context.labels is None else context.labels.masks()
    seed = context.seed_of_samples
    if seed is not None:
        seed = seed + ((position + 1) << 32)  # as a seed is that of a chain of one
    first = masks[0] if masks else None
    y, child.record = module._run_with_masks(x, first, child.params, seed, context.generator_of(module))
    return y, Applied(module, child.record, module.flags)


def _position_inside(position: int) -> int:
    """Where the chain of a container begins that is a child at a position, so that its draws are not those of others."""
    return (position + 1) * 256 % (1 << 20)


def _key(x: Tensor, children: Sequence[Child], context: CallContext, position: int) -> Hashable:
    """The key of the plan of a run: all that it depends on besides the settings of modules."""
    _, seed, _, once, _, output, frames, _, time, *_, is_certain, owners, source = context
    modules = [(id(child.module), child.params is None) for child in children]
    own = (x.shape, x.dtype, position, seed is None, once, output, frames, time, is_certain, owners is None)
    return (*own, *modules) if source is None else ("frames", *own, *modules)


def _runs(children: Sequence[Child], plans: Plans) -> list[tuple[Sequence[Child], str]]:
    """Split children into augmentations that draw together, and modules that run by themselves, each with how it is executed."""
    key = ("runs", *[(id(child.module), child.params is None) for child in children])
    lengths: list[tuple[int, str]] | None = plans.get(key)
    if lengths is None:
        lengths = _lengths_of_runs(children)
        plans.keep(key, lengths)
    runs, first = [], 0
    for length, kind in lengths:
        runs.append((children[first : first + length], kind))
        first += length
    return runs


def _lengths_of_runs(children: Sequence[Child]) -> list[tuple[int, str]]:
    lengths: list[tuple[int, str]] = []
    before: Child | None = None
    for child in children:
        module: Any = child.module
        is_augmentation = hasattr(module, "_contribution")
        if before is not None and is_augmentation and _draw_together(before, child):
            lengths[-1] = (lengths[-1][0] + 1, "joined")
        else:
            kind = "alone" if not is_augmentation else "with masks" if module.needs_masks else "joined"
            lengths.append((1, kind))
        # What has another size than expected ends a run.
        before = child if is_augmentation and _has_known_size(module) else None
    return lengths


def _draw_together(before: Child, child: Child) -> bool:
    return _has_known_size(child.module) and (child.params is None) == (before.params is None)


def _has_known_size(module: Any) -> bool:
    """Whether the size of the result is known before the augmentation runs, and so are the labels that it reads."""
    return module.has_known_size and not module.needs_masks and not module._is_customized()


def _execute_module(x: Tensor, child: Child, context: CallContext) -> tuple[Tensor, Stage]:
    """A module that is no augmentation: another container, or any nn.Module of images."""
    module: Any = child.module
    if hasattr(module, "_execute_nested"):
        y, stage, child.record = module._execute_nested(x, child.params, context)
        return y, stage
    y = module(x)
    child.foreign_params = getattr(module, "_params", None)
    return y, Stage()


# --- runs of augmentations ------------------------------------------------------------------------------------------


class _RunPlan(NamedTuple):
    """What a run of augmentations draws and executes, for images of one shape."""

    draws: Sequence[DrawPlan]
    requests: Sequence[int | None]  # of each augmentation, its number among those of the draws
    modules: Sequence[AugmentationBase]  # of each request
    spans: Sequence[Span | None]  # its columns among all, those that are derived behind all that are drawn
    derived_from: Sequence[Span | None]  # the drawn columns of each whose columns are derived
    shapes: Sequence[Shape]  # of its images
    applied: Sequence[bool]
    steps: Sequence[Step]
    first: int  # number of the first key, or position in the chain
    certain: Sequence[bool]  # whether all samples are augmented
    derives: bool  # whether any has columns that are derived
    drawn: DrawnPass | DrawnLinks | None  # the draws together with the first step or its links, by one operator
    owners: Tensor | None = None  # (P,) on the CPU: the number of the augmentation that each column belongs to
    identity: tuple[float, ...] = ()  # what the columns hold for samples that do not get that augmentation


def _execute_run(
    x: Tensor, run: Sequence[Child], context: CallContext, position: int, plan: _RunPlan | None = None
) -> tuple[Tensor, Chain]:
    modules: list[AugmentationBase] = [child.module for child in run]  # type: ignore[misc]  # by _runs
    result: tuple[Tensor, Tensor | None] | None = None
    links: Sequence[Tensor] | None = None
    if run[0].params is not None:
        executions, columns = _replay(x, run)
        steps: Sequence[Step] = plan_steps(modules, executions, context.once, x.dtype, context.output)
    else:
        keys = None
        if plan is None:
            plan, keys = _kept_plan(x, run, context, position)
        if keys is None and plan.draws:
            keys = _more_keys(None, plan.modules, x, context)
        if keys is not None and keys.seeds is not None:
            check_seeds(context.op, keys, x[:: context.frames].shape[0])
        if plan.drawn is None or keys is None or (context.source is not None and isinstance(plan.drawn, DrawnPass)):
            columns = _draw(x, plan, keys, context.frames)
            if plan.owners is not None and columns is not None and context.owners is not None:
                own = (context.owners[:, None] == plan.owners).to(columns.device, non_blocking=True)
                columns = torch.where(own, columns, constant(plan.identity, columns))
        else:
            columns, result, links = plan.drawn.draw(x, keys)
        executions, steps = _executions(x, plan, columns, keys, context.frames), plan.steps
        if columns is not None and plan.derives:
            columns = _with_derived(modules, executions, columns, plan, context)
    for child, module, execution in zip(run, modules, executions):
        child.record = module.__dict__["_execution"] = execution  # faster than Module.__setattr__
    if context.source is not None:
        result = _read_frames(context.source, x, steps[0], modules, executions, columns) if steps else None
        x = x if result is not None else images_of(context.source)
    running = Running(modules, executions, columns, context.has_labels, result, links)
    stages: list[Stage] = []
    for step in steps:
        x, stage = step.run(x, running)
        if stage is not None:
            stages.append(stage)
    return x, Chain(stages)


def _replay(x: Tensor, run: Sequence[Child]) -> tuple[list[Execution], Tensor | None]:
    """The executions of augmentations with given parameters, and the columns of all."""
    executions, image = [], x
    drawn: list[Tensor] = []
    width = 0
    for child in run:
        module: AugmentationBase = child.module  # type: ignore[assignment]  # by _runs
        execution = module._from_params(child.params, image)
        if execution.applied:
            image = x.new_empty(1).expand(module.output_shape(execution.shape, module.flags))  # of its shape only
        if execution.columns is not None:
            own, span = execution.columns
            execution.columns = Columns(own, span.moved(width))
            drawn.append(own)
            width += own.shape[1]
        executions.append(execution)
    if not drawn:
        return executions, None
    columns = torch.cat(drawn, 1) if len(drawn) > 1 else drawn[0]
    for execution in executions:
        if execution.columns is not None:
            execution.columns = execution.columns._replace(drawn=columns)
    return executions, columns


def _kept_plan(x: Tensor, run: Sequence[Child], context: CallContext, position: int) -> tuple[_RunPlan, Keys | None]:
    """The cached or new plan of a run, and the keys that `_plan_run` had to draw."""
    key = _key(x, run, context, position)
    plan: _RunPlan | None = context.plans.get(key)
    if plan is not None:
        return plan, None
    modules: list[AugmentationBase] = [child.module for child in run]  # type: ignore[misc]  # by _runs
    plan, keys = _plan_run(x, modules, context, position)
    decides = not context.is_certain and any(
        m.whole_batch and 0 < m.p_batch < 1 for m in modules
    )  # on the host, in each call
    if not decides and all(draws.learned is None for draws in plan.draws):
        context.plans.keep(key, plan)
    return plan, keys


def _draw(x: Tensor, plan: _RunPlan, keys: Keys | None, frames: int) -> Tensor | None:
    """The columns of all augmentations of a run."""
    if keys is None:
        return None
    samples = x[::frames] if frames > 1 else x
    drawn = [draws.draw(samples, keys) for draws in plan.draws]
    columns = drawn[0] if len(drawn) == 1 else torch.cat(drawn, 1)
    return columns.repeat_interleave(frames, 0) if frames > 1 else columns


def _executions(x: Tensor, plan: _RunPlan, columns: Tensor | None, keys: Keys | None, frames: int) -> list[Execution]:
    executions, identity = [], matrix_type(x)
    for request, span, shape, applies, certain in zip(
        plan.requests, plan.spans, plan.shapes, plan.applied, plan.certain
    ):
        if request is None or span is None or columns is None or keys is None:
            executions.append(Execution(shape, applied=applies))
        else:
            drawn = Columns(columns, span)
            redraw = (
                (keys, plan.first + request) if plan.owners is None else None
            )  # which would give them to all samples
            executions.append(Execution(shape, drawn, None, applies, None, redraw, frames, certain))
        executions[-1].identity = identity
    return executions


def _with_derived(
    modules: Sequence[AugmentationBase],
    executions: Sequence[Execution],
    columns: Tensor,
    plan: _RunPlan,
    context: CallContext,
) -> Tensor:
    """The columns of a run, and behind them those that augmentations derive from the labels that are there before each of them."""
    stages: list[Stage] = []
    parts = [columns]
    for module, execution, span in zip(modules, executions, plan.derived_from):
        if span is not None:
            labels = None
            if module.reads_labels is not None and context.labels is not None:
                labels = context.labels.after(stages).read(module.reads_labels, execution.shape, context.frames)
                labels = labels.to(columns.device) if isinstance(labels, Tensor) else labels
            drawn, sizes = Columns(columns, span), size_of(execution.shape, columns)
            execution.columns = module._derived(drawn, sizes, labels, context.frames)
            execution.redraw = None  # the host does not know the labels
            parts.append(execution.columns.drawn)
        stages.append(Applied(module, execution, module.flags))
    columns = torch.cat(parts, 1)
    for execution, span, source in zip(executions, plan.spans, plan.derived_from):
        if source is not None and span is not None:
            execution.columns = Columns(columns, span)
    return columns


def _plan_run(
    x: Tensor, modules: Sequence[AugmentationBase], context: CallContext, position: int, of_list: bool = False
) -> tuple[_RunPlan, Keys | None]:
    """The plan of a run. If it depends on keys, these are drawn and returned for all requests; otherwise they are None.

    `of_list`: x stands for a list, and the matrix of the first augmentation reads what depends on the sizes from columns.
    """
    has_seed, has_owners = context.seed is not None, context.owners is not None
    first = position if has_seed else 0
    shape: Shape = tuple(x.shape)
    batch = shape[0]
    samples = -(-batch // context.frames)  # which stays symbolic in a graph
    shapes, numbers, applied = [], [], []
    requests: list[Request] = []
    drawing: list[AugmentationBase] = []  # of each request
    keys: Keys | None = None
    for module in modules:
        of_samples = (samples, *shape[1:])
        may_apply = context.is_certain or (module.p > 0 and module.p_batch > 0)
        request = module._request(of_samples, context.is_certain, has_owners) if may_apply else None
        number = len(requests)
        if request is not None:
            requests.append(request)
            drawing.append(module)
            if module.whole_batch and module.p_batch < 1 and not context.is_certain:
                # What changes sizes by chance decides with its key on the host, before those after it are planned.
                keys = _more_keys(keys, drawing, x, context)
        decider = keys if request is not None else None
        applies = context.is_certain or module._applies(decider, first + number if has_seed else number)
        shapes.append(shape)
        applied.append(applies)
        numbers.append(None if request is None else number)
        if applies:
            shape = module.output_shape(shape, module.flags)
    if keys is not None:
        keys = _more_keys(keys, drawing, x, context)
    draws = plan_draws(requests, has_seed, first) if requests else []
    spans_of_requests: list[Span] = []
    width = 0
    for draw in draws:
        spans_of_requests += [span.moved(width) for span in draw.spans]
        width += draw.plan[0]
    spans = [None if number is None else spans_of_requests[number] for number in numbers]
    derived_from: list[Span | None] = []
    for i, (module, span) in enumerate(zip(modules, spans)):
        derived_from.append(span if module._derives and applied[i] else None)
        if span is not None and module._derives:
            count = len(module._identity_values(shapes[i], torch.empty(0, device="cpu"))[0]) + span.has_chosen
            spans[i] = Span(width, count, span.has_chosen) if applied[i] else None
            width += count if applied[i] else 0
    planned = [
        Execution(shape, None if span is None else Columns(x, span), applied=applies)  # of its span only
        for shape, span, applies in zip(shapes, spans, applied)
    ]
    first_chain = chain_of_list(modules[0], spans[0], width) if of_list else None
    steps = plan_steps(modules, planned, context.once, x.dtype, context.output, first_chain)
    certain = [not has_owners and (context.is_certain or module._is_certain) for module in modules]
    drawn = None
    derives = any(span is not None for span in derived_from)
    if steps and len(draws) == 1 and context.frames == 1 and not has_owners and not derives:
        keys_of = [None if number is None else (first + number, has_seed) for number in numbers]
        drawn = steps[0].drawn_with(draws[0], Planned(modules, shapes, x.dtype, keys_of))
    owners, identity = _owners_of_columns(requests, spans_of_requests) if has_owners else (None, ())
    return _RunPlan(
        draws,
        numbers,
        drawing,
        spans,
        derived_from,
        shapes,
        applied,
        steps,
        first,
        certain,
        derives,
        drawn,
        owners,
        identity,
    ), keys


def _owners_of_columns(requests: Sequence[Request], spans: Sequence[Span]) -> tuple[Tensor, tuple[float, ...]]:
    """The number of the request of each column, and what the column holds for samples that are not chosen."""
    owners = [number for number, span in enumerate(spans) for _ in range(span.width)]
    identity = [value for request in requests for value in (0.0, *identity_values(request.draws[1:]))]
    return torch.tensor(owners, device="cpu"), tuple(identity)


def _more_keys(keys: Keys | None, modules: Sequence[AugmentationBase], x: Tensor, context: CallContext) -> Keys:
    """A key of each module, each from its generator; `keys` has those of the first ones, if they have been drawn."""
    if context.seed is not None:
        return keys or draw_keys(context.op, len(modules), x.device, context.seed_of_samples, None)
    if keys is None and (context.generator is not None or not any([module.generator for module in modules])):
        return draw_keys(context.op, len(modules), x.device, None, context.generator or context.default_generator)
    generators = [context.generator_of(module) for module in modules[0 if keys is None else len(keys.keys) :]]
    each = [draw_keys(context.op, 1, x.device, None, generator).keys for generator in generators]
    parts = each if keys is None else [keys.keys, *each]
    on_device = next((part.device for part in parts if part.is_cuda), parts[0].device)
    return Keys(torch.cat([part.to(on_device) for part in parts]))
