"""Execution of containers: adjacent children are joined into few passes over the images.

A run of augmentations draws all its parameters in one launch. Then

    flips, quarter turns and whole-pixel crops, with at most one resampling that interpolates,  become one warp
    a crop with antialiasing, and the flips next to it,   become one resizing of a window
    neighboring color steps                               become one color program
    a warp and the color program behind it                become one pass, which writes the type and layout that are wanted
    everything else                                       runs by itself

What is computed is what the augmentations compute one after the other, up to rounding. Bytes are rounded behind each geometric
augmentation, behind each that runs by itself, and once behind neighboring color steps. With `resample="once"` all neighboring
geometric augmentations are resampled once: as a warp by the product of their matrices, or, with maps or antialiasing among them, at
the coordinates that they compose to. Which passes there are follows from the settings and the sizes of the images, so that it is
decided once for them.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor, nn

from kvision._dtype import as_dtype, compute_dtype
from kvision.augmentation.base import AugmentationBase, Execution, Shape, matrix_type, where_chosen
from kvision.augmentation.base.configuration import Plans
from kvision.augmentation.columns import Columns, DrawPlan, Span, plan_draws
from kvision.augmentation.container.record import Child
from kvision.augmentation.container.stages import Applied, Composed, MapLink, Stage, Warp
from kvision.augmentation.displacements import NoiseField
from kvision.augmentation.drawn_links import DrawnLinks
from kvision.augmentation.drawn_pass import DrawnPass
from kvision.augmentation.draws import Request
from kvision.augmentation.elastic import MapAugmentation
from kvision.augmentation.geometric_base import GeometricAugmentationBase2D
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D, color_part
from kvision.augmentation.keys import Keys, Seed, check_seeds, draw_keys, frame_seeds
from kvision.augmentation.transforms import MAX_TRANSFORMS, MatrixPlan, Transform, keeps_rows, transform_matrix
from kvision.augmentation.warp_and_color import (
    SAME,
    ColorPart,
    Output,
    Pass,
    Resampling,
    fits_one_program,
    make_pass,
)
from kvision.core.exceptions import ShapeError


class Randomness(NamedTuple):
    """Where the children of one call take their keys from; under a seed, the position of the next one in the chain."""

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
    masks: Callable[[Sequence[Stage]], Any] | None = None  # those of the images after stages, for what mixes by them
    default_generator: Generator | None = None  # of the container, for children without one of their own

    def generator_of(self, module: nn.Module) -> Generator | None:
        """The generator that draws for a module; None for torch's."""
        return self.generator or getattr(module, "generator", None) or self.default_generator

    def inside(self, module: nn.Module, once: bool, plans: Plans, output: Output) -> Randomness:
        """For the children of a container that is a child."""
        own = (self.frames, self.position, self.time, self.has_labels, self.masks, self.generator_of(module))
        return Randomness(self.op, self.seed, self.generator, once, plans, output, *own)  # faster than _replace

    @property
    def seed_of_samples(self) -> Seed:
        """The seed of a call; seeds of videos as those of their frames, where these have parameters of their own."""
        if isinstance(self.seed, Tensor) and self.seed.dim() == 1 and self.time > 0 and self.frames == 1:
            return frame_seeds(self.seed, self.time)
        return self.seed


def execute(
    x: Tensor, children: Sequence[Child], source: Randomness, position: int | None = None
) -> tuple[Tensor, list[Stage]]:
    """Run children on images (B, C, H, W); gives the result and what labels have to follow."""
    position = source.position if position is None else position
    key = _key(x, children, source, position)
    plan: _RunPlan | None = source.plans.get(key)
    if plan is not None:
        return _execute_run(x, children, source, position, plan)
    stages: list[Stage] = []
    runs = _runs(children, source.plans)
    for i, run in enumerate(runs):
        own = source if i == len(runs) - 1 or source.output is SAME else source._replace(output=SAME)
        module = run[0].module
        if isinstance(module, AugmentationBase) and not module.needs_masks:
            x, more = _execute_run(x, run, own, position)
            stages += more
        elif isinstance(module, AugmentationBase):
            x, stage = _execute_with_masks(x, run[0], source, stages, position)
            stages.append(stage)
        else:
            masks = None if source.masks is None else _masks_after(stages, source.masks)
            inside = source._replace(position=_position_inside(position), masks=masks)
            x, stage = _execute_module(x, run[0], inside)
            if own.output != SAME:
                x, _ = make_pass(None, output=own.output).run(x, None)
            stages.append(stage)
        position += len(run)
    if not runs and source.output != SAME:
        x, _ = make_pass(None, output=source.output).run(x, None)
    return x, stages


def _masks_after(stages: Sequence[Stage], masks: Callable[[Sequence[Stage]], Any]) -> Callable[[Sequence[Stage]], Any]:
    """The masks for a container inside, whose stages follow those before it."""
    before = list(stages)
    return lambda inside: masks([*before, *inside])


def _execute_with_masks(
    x: Tensor, child: Child, source: Randomness, stages: Sequence[Stage], position: int
) -> tuple[Tensor, Stage]:
    """An augmentation of images by their masks."""
    module: Any = child.module
    masks = None if source.masks is None else source.masks(stages)
    seed = source.seed_of_samples
    if seed is not None:
        seed = seed + ((position + 1) << 32)  # as a seed is that of a chain of one
    y, child.record = module._run_with_masks(x, masks, child.params, seed, source.generator_of(module))
    return y, Applied(module, child.record, module.flags)


def _position_inside(position: int) -> int:
    """Where the chain of a container begins that is a child at a position, so that its draws are not those of others."""
    return (position + 1) * 256 % (1 << 20)


def _key(x: Tensor, children: Sequence[Child], source: Randomness, position: int) -> Hashable:
    """The key of the plan of a run: all that it depends on besides the settings of modules."""
    _, seed, _, once, _, output, frames, _, time, *_ = source
    modules = [(id(child.module), child.params is None) for child in children]
    return (x.shape, x.dtype, position, seed is None, once, output, frames, time, *modules)


def _runs(children: Sequence[Child], plans: Plans) -> list[list[Child]]:
    """Split children into augmentations that draw together, and modules that run by themselves."""
    key = ("runs", *[(id(child.module), child.params is None, child.runs_alone) for child in children])
    lengths: list[int] | None = plans.get(key)
    if lengths is None:
        lengths = _lengths_of_runs(children)
        plans.keep(key, lengths)
    runs, first = [], 0
    for length in lengths:
        runs.append(list(children[first : first + length]))
        first += length
    return runs


def _lengths_of_runs(children: Sequence[Child]) -> list[int]:
    lengths: list[int] = []
    before: Child | None = None
    for child in children:
        if (
            before is not None
            and (child.params is None) == (before.params is None)
            and not (child.runs_alone or before.runs_alone)
            and _has_known_size(child)
            and _has_known_size(before)
        ):
            lengths[-1] += 1
        else:
            lengths.append(1)
        before = child
    return lengths


def _has_known_size(child: Child) -> bool:
    """Whether the size of the result is known before the augmentation runs."""
    module = child.module
    return isinstance(module, AugmentationBase) and module.has_known_size and not module._is_customized()


def _execute_module(x: Tensor, child: Child, source: Randomness) -> tuple[Tensor, Stage]:
    """A module that is no augmentation: another container, or any nn.Module of images."""
    module: Any = child.module
    if hasattr(module, "_execute_nested"):
        y, stage, child.record = module._execute_nested(x, child.params, source)
        return y, stage
    y = module(x)
    child.foreign_params = getattr(module, "_params", None)
    return y, Applied(module, None, {})


# --- runs of augmentations ------------------------------------------------------------------------------------------


class _Joined(NamedTuple):
    """Augmentations that are executed in one pass."""

    image_pass: Pass
    geometric: Sequence[int]  # the augmentations that it warps for, by their numbers in the run
    chain: Sequence[Transform]
    source: tuple[int, int]
    size: tuple[int, int]
    resampling: Resampling | None


class _Composition(NamedTuple):
    """Augmentations that are executed by one resampling, some of which have no matrix or blur what becomes smaller."""

    links: Sequence[MatrixPlan | int]  # chains of matrices, and the numbers of maps in the run
    source: tuple[int, int]
    size: tuple[int, int]
    resampling: Resampling
    samples: int  # along each axis of a pixel


_Step = _Joined | _Composition | int  # passes, compositions, and the numbers of augmentations that run by themselves


class _RunPlan(NamedTuple):
    """What a run of augmentations draws and executes, for images of one shape."""

    draws: Sequence[DrawPlan]
    requests: Sequence[int | None]  # of each augmentation, its number among those of the draws
    modules: Sequence[AugmentationBase]  # of each request
    spans: Sequence[Span | None]  # its columns among all
    shapes: Sequence[Shape]  # of its images
    applied: Sequence[bool]
    steps: Sequence[_Step]
    first: int  # number of the first key, or position in the chain
    certain: Sequence[bool]  # whether all samples are augmented
    drawn: DrawnPass | DrawnLinks | None  # the draws, and the first step or its links, by one operator


def _execute_run(
    x: Tensor, run: Sequence[Child], source: Randomness, position: int, plan: _RunPlan | None = None
) -> tuple[Tensor, list[Stage]]:
    modules: list[AugmentationBase] = [child.module for child in run]  # type: ignore[misc]  # by _runs
    # Of the first step, if it is computed with the draws: the result, or the links.
    first: tuple[Tensor, Tensor] | None = None
    links: list[Tensor] | None = None
    if run[0].params is not None:
        executions, columns = _replay(x, run)
        steps: Sequence[_Step] = _plan_steps(modules, executions, source, x.dtype)
    else:
        keys = None
        if plan is None:
            plan, keys = _kept_plan(x, run, source, position)
        if keys is None:
            keys = _keys(x, plan, source)
        if keys is not None and keys.seeds is not None:
            check_seeds(source.op, keys, x[:: source.frames].shape[0])
        if plan.drawn is None or keys is None:
            columns = _draw(x, plan, keys, source.frames)
        elif isinstance(plan.drawn, DrawnPass):
            y, matrix, columns = plan.drawn.run(x, keys)
            first = y, matrix
        else:
            columns, links = plan.drawn.run(x, keys)
        executions, steps = _executions(x, plan, columns, keys, source.frames), plan.steps
    for child, module, execution in zip(run, modules, executions):
        child.record = module.__dict__["_execution"] = execution  # faster than Module.__setattr__
    stages: list[Stage] = []
    for step in steps:
        if isinstance(step, int):
            module, execution = modules[step], executions[step]
            execution.keeps_map = source.has_labels
            x = module._run(x, execution, module.flags)
            stages.append(Applied(module, execution, module.flags))
            continue
        if isinstance(step, _Composition):
            composed = _compose(x, step, modules, executions, columns, links)
            links = None
            x = composed.run(x)
            stages.append(composed)
            continue
        x, matrix = step.image_pass.run(x, columns) if first is None else first
        first = None
        if len(step.geometric) == 1:
            module, execution = modules[step.geometric[0]], executions[step.geometric[0]]
            execution.keep_matrix(matrix)
            stages.append(Applied(module, execution, module.flags))
        elif step.geometric:
            if columns is not None and columns.requires_grad:
                matrix = transform_matrix(as_dtype(columns, compute_dtype(x)), step.chain)
            assert step.resampling is not None
            stages.append(Warp(matrix, step.source, step.size, step.resampling))
    return x, stages


def _compose(
    x: Tensor,
    step: _Composition,
    modules: Sequence[AugmentationBase],
    executions: Sequence[Execution],
    columns: Tensor | None,
    drawn: list[Tensor] | None,
) -> Composed:
    """What a composition does for drawn parameters; `drawn` are its links, if they were computed with the draws."""
    dtype = compute_dtype(x) if x.is_floating_point() else torch.float32
    columns = x.new_empty(x.shape[0], 0, dtype=dtype) if columns is None else as_dtype(columns, dtype)
    links: list[Tensor | MapLink] = []
    for i, link in enumerate(step.links):
        if isinstance(link, MatrixPlan):
            links.append(link.matrix(columns) if drawn is None else drawn[i])
            continue
        module, execution = modules[link], executions[link]
        assert isinstance(module, MapAugmentation)
        links.append(MapLink(module, execution, module.flags))
        if drawn is not None:
            drawn[i] = where_chosen(execution.chosen, drawn[i], 0.0)
    return Composed(links, step.source, step.size, step.resampling, step.samples, drawn)


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


def _kept_plan(x: Tensor, run: Sequence[Child], source: Randomness, position: int) -> tuple[_RunPlan, Keys | None]:
    """The cached or new plan of a run, and the keys that `_plan_run` had to draw."""
    key = _key(x, run, source, position)
    plan: _RunPlan | None = source.plans.get(key)
    if plan is not None:
        return plan, None
    modules: list[AugmentationBase] = [child.module for child in run]  # type: ignore[misc]  # by _runs
    plan, keys = _plan_run(x, modules, source, position)
    decides = any(m.whole_batch and 0 < m.p_batch < 1 for m in modules)  # on the host, in each call
    if not decides and all(draws.learned is None for draws in plan.draws):
        source.plans.keep(key, plan)
    return plan, keys


def _keys(x: Tensor, plan: _RunPlan, source: Randomness) -> Keys | None:
    """The keys of all requests of a run, if there are any."""
    if not plan.draws:
        return None
    return _more_keys(None, plan.modules, x, source)


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
            drawn, redraw = Columns(columns, span), (keys, plan.first + request)
            executions.append(Execution(shape, drawn, None, applies, None, redraw, frames, certain))
        executions[-1].identity = identity
    return executions


def _plan_run(
    x: Tensor, modules: Sequence[AugmentationBase], source: Randomness, position: int
) -> tuple[_RunPlan, Keys | None]:
    """The plan of a run. If it depends on keys, these are drawn and returned for all requests; otherwise they are None."""
    one_key = source.seed is not None
    first = position if one_key else 0
    shape: Shape = tuple(x.shape)
    batch = shape[0]
    samples = len(range(0, batch, source.frames))
    shapes, numbers, applied = [], [], []
    requests: list[Request] = []
    drawing: list[AugmentationBase] = []  # of each request
    keys: Keys | None = None
    for module in modules:
        of_samples = (samples, *shape[1:])
        request = module._request(of_samples) if module.p > 0 and module.p_batch > 0 else None
        number = len(requests)
        if request is not None:
            requests.append(request)
            drawing.append(module)
            if module.whole_batch and module.p_batch < 1:
                # What changes sizes by chance decides with its key on the host, before those after it are planned.
                keys = _more_keys(keys, drawing, x, source)
        applies = module._applies(keys if request is not None else None, first + number if one_key else number)
        shapes.append(shape)
        applied.append(applies)
        numbers.append(None if request is None else number)
        if applies:
            shape = module.output_shape(shape, module.flags)
    if keys is not None:
        keys = _more_keys(keys, drawing, x, source)
    draws = plan_draws(requests, one_key, first) if requests else []
    spans_of_requests: list[Span] = []
    width = 0
    for draw in draws:
        spans_of_requests += [span.moved(width) for span in draw.spans]
        width += draw.plan[0]
    spans = [None if number is None else spans_of_requests[number] for number in numbers]
    planned = [
        Execution(shape, None if span is None else Columns(x, span), applied=applies)  # of its span only
        for shape, span, applies in zip(shapes, spans, applied)
    ]
    steps = _plan_steps(modules, planned, source, x.dtype)
    certain = [module._is_certain for module in modules]
    start = steps[0] if steps and len(draws) == 1 and source.frames == 1 else None
    drawn: DrawnPass | DrawnLinks | None = None
    if isinstance(start, _Joined):
        drawn = DrawnPass(draws[0], start.image_pass, tuple(x.shape), x.dtype)
    elif isinstance(start, _Composition):
        keys_of = [None if number is None else first + number for number in numbers]
        links = _drawn_links(start.links, modules, shapes, keys_of, one_key)
        drawn = None if links is None else DrawnLinks(draws[0], links)
    return _RunPlan(draws, numbers, drawing, spans, shapes, applied, steps, first, certain, drawn), keys


def _drawn_links(
    links: Sequence[MatrixPlan | int],
    modules: Sequence[AugmentationBase],
    shapes: Sequence[Shape],
    numbers: Sequence[int | None],  # of the keys of augmentations, or their positions in the chain
    one_key: bool,
) -> list[MatrixPlan | NoiseField] | None:
    """The links of a composition for the kernel that computes them with the draws; None if it does not serve all."""
    drawn: list[MatrixPlan | NoiseField] = []
    for link in links:
        if isinstance(link, MatrixPlan):
            drawn.append(link)
            continue
        module, number = modules[link], numbers[link]
        assert isinstance(module, MapAugmentation)
        field = None if number is None else module._noise_field(shapes[link], number, one_key)
        if field is None:
            return None
        drawn.append(field)
    return drawn


def _more_keys(keys: Keys | None, modules: Sequence[AugmentationBase], x: Tensor, source: Randomness) -> Keys:
    """A key of each module, each from its generator; `keys` has those of the first ones, if they have been drawn."""
    if source.seed is not None:
        return keys or draw_keys(source.op, len(modules), x.device, source.seed_of_samples, None)
    if keys is None and (source.generator is not None or not any([module.generator for module in modules])):
        return draw_keys(source.op, len(modules), x.device, None, source.generator or source.default_generator)
    generators = [source.generator_of(module) for module in modules[0 if keys is None else len(keys.keys) :]]
    each = [draw_keys(source.op, 1, x.device, None, generator).keys for generator in generators]
    parts = each if keys is None else [keys.keys, *each]
    on_device = next((part.device for part in parts if part.is_cuda), parts[0].device)
    return Keys(torch.cat([part.to(on_device) for part in parts]))


# --- passes ---------------------------------------------------------------------------------------------------------


def _plan_steps(
    modules: Sequence[AugmentationBase], executions: Sequence[Execution], source: Randomness, dtype: torch.dtype
) -> list[_Step]:
    """What is executed for these executions, of whose columns only the spans count, on images of a type."""
    pending = _Pending(source.once, dtype)
    for number, (module, execution) in enumerate(zip(modules, executions)):
        pending.add(number, module, execution)
    return pending.finish(source.output)


def _check_takes_volumes(module: AugmentationBase, shape: Shape) -> None:
    """Raise unless an augmentation of images is one of volumes (B, C, D, H, W), too."""
    if isinstance(module, IntensityAugmentationBase2D):
        if module.takes_volumes or module.color_steps(shape, module.flags) is not None:
            return
    raise ShapeError(f"{type(module).__name__}: expected images of shape (B, C, H, W), got {shape}")


class _Geometric(NamedTuple):
    """A geometric augmentation that waits to be joined."""

    number: int  # in the run
    module: GeometricAugmentationBase2D | MapAugmentation
    execution: Execution
    chain: Sequence[Transform] | None  # of its matrix; None for a map
    antialiased: bool = False
    shrinks: int = 1  # how many pixels along an axis are blurred to one at most

    @property
    def interpolates(self) -> bool:
        return self.chain is None or not self.module.moves_whole_pixels


class _Pending:
    """Neighboring augmentations that wait to be joined in one pass."""

    def __init__(self, once: bool, dtype: torch.dtype) -> None:
        self.once = once
        self.dtype = dtype  # of the images that come next
        self.converted: torch.dtype | None = None  # of the result of the pending color steps, if it is another one
        self.steps: list[_Step] = []
        self.geometric: list[_Geometric] = []
        self.parts: list[ColorPart] = []

    def add(self, number: int, module: AugmentationBase, execution: Execution) -> None:
        if not execution.applied:
            return
        span = None if execution.columns is None else execution.columns.span
        result = module._result_dtype(self.dtype)
        customized = module._is_customized()
        if len(execution.shape) != module.axes + 1 and not customized:
            _check_takes_volumes(module, execution.shape)
        if isinstance(module, MapAugmentation) and self.once and not customized:
            if self.parts:
                self._flush()
            self.geometric.append(_Geometric(number, module, execution, None))
            return
        customized = customized or (execution.params is not None and span is None)
        if not customized and isinstance(module, IntensityAugmentationBase2D):
            part = color_part(module, execution.shape, span, module.flags)
            if part is not None:
                if not fits_one_program([*self.parts, part]):
                    self._continue_colors()
                elif len(_chain(self.geometric)) > MAX_TRANSFORMS:
                    self._flush()
                self.parts.append(part)
                if result != self.dtype:
                    self.dtype = self.converted = result
                return
        if not customized and isinstance(module, GeometricAugmentationBase2D):
            chain = module.transforms(execution.shape, module.flags)
            antialiased = chain is None or module.resampling(module.flags).antialias
            if chain is None and self.once:
                chain = module.matrix_transforms(execution.shape, module.flags)
            if chain is not None:
                names = module._names_of_columns(0 if span is None else span.first_value)
                bound = [t._bound(names) for t in chain]
                shrinks = 1
                if antialiased:
                    size = module.output_size(execution.shape, module.flags)
                    shrinks = max(-(-n // m) for n, m in zip(execution.shape[-2:], size))
                geometric = _Geometric(number, module, execution, bound, antialiased, shrinks)
                if self.parts or (self.geometric and not self._joins(geometric)):
                    self._flush()
                self.geometric.append(geometric)
                return
        self._flush()
        self.steps.append(number)
        self.dtype = result

    def _joins(self, geometric: _Geometric) -> bool:
        """Whether one warp gives what the pending ones and then `geometric` give."""
        if self.once:
            return True
        together, module = [*self.geometric, geometric], geometric.module
        if any(g.antialiased for g in together):
            return _is_window(together)
        if all(g.module.permutes_pixels for g in self.geometric):
            return True
        assert isinstance(module, GeometricAugmentationBase2D)
        return module.moves_whole_pixels and module.stays_inside

    def _continue_colors(self) -> None:
        """End a color program that another one continues: bytes are rounded behind neighboring color steps, not between."""
        if self.dtype != torch.uint8:
            self._flush()
            return
        self._flush(Output(torch.float32))
        self.converted = self.dtype

    def _flush(self, output: Output = SAME) -> None:
        geometric, parts = self.geometric, self.parts
        if output.dtype is None:
            output = output._replace(dtype=self.converted)
        self.geometric, self.parts, self.converted = [], [], None
        alone = [at for at, g in enumerate(geometric) if g.chain is None or g.antialiased]
        if not alone or _is_window(geometric):
            self._join(geometric, parts, output)
        elif sum(g.interpolates for g in geometric) == 1:  # which nothing else has to be composed with
            (at,) = alone
            self._join(geometric[:at])
            self.steps.append(geometric[at].number)
            self._join(geometric[at + 1 :], parts, output)
        else:
            self._compose(geometric)
            self._join([], parts, output)

    def _join(self, geometric: Sequence[_Geometric], parts: Sequence[ColorPart] = (), output: Output = SAME) -> None:
        """One pass for geometric augmentations and color steps."""
        if not geometric:
            if parts or output != SAME:
                self.steps.append(_Joined(make_pass(None, parts=parts, output=output), (), (), (0, 0), (0, 0), None))
            return
        source, size, resampling = _sizes_and_resampling(geometric)
        chain = _chain(geometric)
        image_pass = make_pass(chain, size, resampling, parts, output)
        self.steps.append(_Joined(image_pass, [g.number for g in geometric], chain, source, size, resampling))

    def _compose(self, geometric: Sequence[_Geometric]) -> None:
        links: list[MatrixPlan | int] = []
        chain: list[Transform] = []
        samples = 1
        for g in geometric:
            samples *= g.shrinks
            if g.chain is not None:
                chain += g.chain
                continue
            links += [MatrixPlan(chain), g.number] if chain else [g.number]
            chain = []
        links += [MatrixPlan(chain)] if chain else []
        self.steps.append(_Composition(links, *_sizes_and_resampling(geometric), samples))

    def finish(self, output: Output) -> list[_Step]:
        self._flush(output)
        return self.steps


def _is_window(geometric: Sequence[_Geometric]) -> bool:
    """Whether neighbors are a window that is resized with antialiasing, before or after flips, which mirror it."""
    own = [g.module for g in geometric if g.antialiased]
    if len(own) != 1 or isinstance(own[0], MapAugmentation) or not own[0].resampling(own[0].flags).antialias:
        return False
    others_flip = all(g.antialiased or g.module.permutes_pixels for g in geometric)
    return others_flip and keeps_rows(_chain(geometric))


def _chain(geometric: Sequence[_Geometric]) -> list[Transform]:
    """The transforms of augmentations without maps."""
    return [t for g in geometric for t in g.chain or ()]


def _sizes_and_resampling(geometric: Sequence[_Geometric]) -> tuple[tuple[int, int], tuple[int, int], Resampling]:
    """The sizes before and behind neighbors, and how the images are read: as by the first one that interpolates."""
    first, last = geometric[0], geometric[-1]
    height, width = first.execution.shape[-2:]
    shape = last.execution.shape
    size = last.module.output_shape(shape, last.module.flags)[-2:]
    reading = next((g.module for g in geometric if g.interpolates), last.module)
    return (height, width), (size[0], size[1]), reading.resampling(reading.flags)
