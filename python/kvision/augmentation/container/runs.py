"""How containers execute: neighbors are joined into few passes over the images.

A run of augmentations draws all its parameters in one launch. Then

    flips, quarter turns and whole-pixel crops, with at most one resampling that interpolates,  become one warp
    neighboring color steps                               become one color program
    a warp and the color program behind it                become one pass, which writes the type and layout that are wanted
    everything else                                       runs by itself

What is computed is what the augmentations compute one after the other, up to rounding. With `resample="once"` all neighboring
geometric augmentations become one warp, which interpolates once. Which passes there are follows from the settings and the sizes of
the images, so that it is decided once for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor, nn

from kvision.augmentation.base import AugmentationBase, Execution, Shape
from kvision.augmentation.columns import Columns, DrawPlan, Span, plan_draws
from kvision.augmentation.configuration import Plans
from kvision.augmentation.draws import Request
from kvision.augmentation.geometric_base import GeometricAugmentationBase2D
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D, color_part
from kvision.augmentation.keys import Keys, Seed, check_seeds, draw_keys, frame_seeds
from kvision.augmentation.transforms import MAX_TRANSFORMS, Transform, transform_matrix
from kvision.augmentation.warp_and_color import (
    SAME,
    ColorPart,
    Output,
    Pass,
    Resampling,
    fits_one_program,
    make_pass,
)


@dataclass
class Child:
    """A child of a container that is executed, with the parameters that it replays, if any."""

    name: str
    module: nn.Module
    params: Any = None
    execution: Any = None  # of an augmentation; a module that a call has twice keeps the last one only

    def read_params(self) -> Any:
        """The parameters that it was executed with."""
        if self.execution is not None:
            return self.module._read_params(self.execution)  # type: ignore[operator]  # of AugmentationBase
        return getattr(self.module, "_params", None)


class Warp(NamedTuple):
    """Neighboring geometric augmentations that were executed as one warp."""

    matrix: Tensor
    source: Sequence[int]
    size: Sequence[int]
    resampling: Resampling


class Applied(NamedTuple):
    """A module that ran by itself; an augmentation with its execution."""

    module: nn.Module
    execution: Execution | None
    flags: dict[str, Any]


Stage = Warp | Applied  # what masks, boxes and points have to follow


class Randomness(NamedTuple):
    """Where the children of one call take their keys from; under a seed, the position of the next one in the chain."""

    op: str
    seed: Seed
    generator: Generator | None
    once: bool  # one resampling for neighboring geometric augmentations
    plans: Plans  # of the container
    output: Output = SAME  # the type and layout of the results
    frames: int = 1  # how many neighboring samples share their parameters: the frames of a video
    position: int = 0  # of the first child in the chain, under a seed
    time: int = 0  # how many neighboring samples are the frames of a video; 0 for images

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
    stages: list[Stage] = []
    position = source.position if position is None else position
    runs = _runs(children, source.plans)
    for run in runs:
        output = source.output if run is runs[-1] else SAME
        if isinstance(run[0].module, AugmentationBase):
            x, more = _execute_run(x, run, source._replace(output=output), position)
            stages += more
        else:
            x, stage = _execute_module(x, run[0], source._replace(position=_position_inside(position)))
            if output != SAME:
                x, _ = make_pass(None, output=output).run(x, None)
            stages.append(stage)
        position += len(run)
    if not runs and source.output != SAME:
        x, _ = make_pass(None, output=source.output).run(x, None)
    return x, stages


def _position_inside(position: int) -> int:
    """Where the chain of a container begins that is a child at a position, so that its draws are not those of others."""
    return (position + 1) * 256 % (1 << 20)


def _runs(children: Sequence[Child], plans: Plans) -> list[list[Child]]:
    """Split children into augmentations that draw together, and modules that run by themselves."""
    key = ("runs", *((id(child.module), child.params is None) for child in children))
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
    return isinstance(child.module, AugmentationBase) and not child.module._is_customized()


def _execute_module(x: Tensor, child: Child, source: Randomness) -> tuple[Tensor, Stage]:
    """A module that is no augmentation: another container, or any nn.Module of images."""
    module: Any = child.module
    if hasattr(module, "_execute_nested"):
        nested: tuple[Tensor, Stage] = module._execute_nested(x, child.params, source)
        return nested
    return module(x), Applied(module, None, {})


# --- runs of augmentations ------------------------------------------------------------------------------------------


class _Joined(NamedTuple):
    """Augmentations that are executed in one pass."""

    own: Pass
    geometric: Sequence[int]  # the augmentations that it warps for, by their numbers in the run
    chain: Sequence[Transform]
    source: tuple[int, int]
    size: tuple[int, int]
    resampling: Resampling | None


class _RunPlan(NamedTuple):
    """What a run of augmentations draws and executes, for images of one shape."""

    draws: Sequence[DrawPlan]
    requests: Sequence[int | None]  # of each augmentation, its number among those of the draws
    spans: Sequence[Span | None]  # its columns among all
    shapes: Sequence[Shape]  # of its images
    applied: Sequence[bool]
    steps: Sequence[_Joined | int]  # passes, and the numbers of augmentations that run by themselves
    first: int  # number of the first key, or position in the chain


def _execute_run(x: Tensor, run: Sequence[Child], source: Randomness, position: int) -> tuple[Tensor, list[Stage]]:
    modules: list[AugmentationBase] = [child.module for child in run]  # type: ignore[misc]  # by _runs
    if run[0].params is not None:
        executions, columns = _replay(x, run)
        steps: Sequence[_Joined | int] = _plan_steps(modules, executions, source)
    else:
        executions, columns, steps = _draw(x, modules, source, position)
    for child, module, execution in zip(run, modules, executions):
        child.execution = module._execution = execution
    stages: list[Stage] = []
    for step in steps:
        if isinstance(step, int):
            module, execution = modules[step], executions[step]
            x = module._run(x, execution, module.flags)
            stages.append(Applied(module, execution, module.flags))
            continue
        x, matrix = step.own.run(x, columns)
        if len(step.geometric) == 1:
            module, execution = modules[step.geometric[0]], executions[step.geometric[0]]
            execution.keep_matrix(matrix)
            stages.append(Applied(module, execution, module.flags))
        elif step.geometric:
            if columns is not None and columns.requires_grad:
                matrix = transform_matrix(columns, step.chain)
            assert step.resampling is not None
            stages.append(Warp(matrix, step.source, step.size, step.resampling))
    return x, stages


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


def _draw(
    x: Tensor, modules: Sequence[AugmentationBase], source: Randomness, position: int
) -> tuple[list[Execution], Tensor | None, Sequence[_Joined | int]]:
    """The executions of augmentations whose parameters are drawn by one launch, the columns of all, and what to execute."""
    key = (x.shape, *(id(module) for module in modules), position, source.seed is None, *source[3:4], *source[5:])
    plan: _RunPlan | None = source.plans.get(key)
    keys: Keys | None = None
    if plan is None:
        plan, keys = _plan_run(x, modules, source, position)
        decides = any(m.whole_batch and 0 < m.p_batch < 1 for m in modules)  # on the host, in each call
        if not decides and all(own.learned is None for own in plan.draws):
            source.plans.keep(key, plan)
    samples = x[:: source.frames] if source.frames > 1 else x
    columns = None
    if plan.draws:
        if keys is None:
            keys = draw_keys(
                source.op, plan.draws[-1].end - plan.draws[0].begin, x.device, source.seed_of_samples, source.generator
            )
        check_seeds(source.op, keys, samples.shape[0])
        if len(plan.draws) == 1:
            columns = plan.draws[0].draw(samples, keys)
        else:
            columns = torch.cat([own.draw(samples, keys) for own in plan.draws], 1)
        if source.frames > 1:
            columns = columns.repeat_interleave(source.frames, 0)
    executions = []
    for request, span, shape, applies in zip(plan.requests, plan.spans, plan.shapes, plan.applied):
        if request is None or columns is None or span is None or keys is None:
            executions.append(Execution(shape, applied=applies))
        else:
            drawn, redraw = Columns(columns, span), (keys, plan.first + request)
            executions.append(Execution(shape, drawn, applied=applies, redraw=redraw, frames=source.frames))
    return executions, columns, plan.steps


def _plan_run(
    x: Tensor, modules: Sequence[AugmentationBase], source: Randomness, position: int
) -> tuple[_RunPlan, Keys | None]:
    """The plan of a run, and the keys that it had to draw, which are those of all its requests then."""
    one_key = source.seed is not None
    first = position if one_key else 0
    shape: Shape = tuple(x.shape)
    batch = shape[0]
    samples = len(range(0, batch, source.frames))
    shapes, numbers, applied = [], [], []
    requests: list[Request] = []
    keys: Keys | None = None
    for module in modules:
        of_samples = (samples, *shape[1:])
        request = module._request(of_samples) if module.p > 0 and module.p_batch > 0 else None
        number = len(requests)
        if request is not None:
            requests.append(request)
            if module.whole_batch and module.p_batch < 1:
                # What changes sizes by chance decides with its key on the host, before those after it are planned.
                keys = _more_keys(keys, len(requests), x, source)
        applies = module._applies(keys if request is not None else None, first + number if one_key else number)
        shapes.append(shape)
        applied.append(applies)
        numbers.append(None if request is None else number)
        if applies:
            shape = module.output_shape(shape, module.flags)
    if keys is not None:
        keys = _more_keys(keys, len(requests), x, source)
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
    steps = _plan_steps(modules, planned, source)
    return _RunPlan(draws, numbers, spans, shapes, applied, steps, first), keys


def _more_keys(keys: Keys | None, count: int, x: Tensor, source: Randomness) -> Keys:
    """`count` keys, of which some may have been drawn."""
    if keys is None:
        return draw_keys(source.op, count, x.device, source.seed_of_samples, source.generator)
    known = len(keys.keys)
    if keys.one_key or known == count:
        return keys
    more = draw_keys(source.op, count - known, x.device, source.seed, source.generator)
    return keys._replace(keys=torch.cat([keys.keys, more.keys]))


# --- passes ---------------------------------------------------------------------------------------------------------


def _plan_steps(
    modules: Sequence[AugmentationBase], executions: Sequence[Execution], source: Randomness
) -> list[_Joined | int]:
    """What is executed for these executions, of whose columns only the spans count."""
    pending = _Pending(source.once)
    for number, (module, execution) in enumerate(zip(modules, executions)):
        pending.add(number, module, execution)
    return pending.finish(source.output)


class _Pending:
    """Neighboring augmentations that wait to be joined in one pass."""

    def __init__(self, once: bool) -> None:
        self.once = once
        self.steps: list[_Joined | int] = []
        self.geometric: list[tuple[int, GeometricAugmentationBase2D, Execution]] = []
        self.chain: list[Transform] = []
        self.parts: list[ColorPart] = []

    def add(self, number: int, module: AugmentationBase, execution: Execution) -> None:
        if not execution.applied:
            return
        span = None if execution.columns is None else execution.columns.span
        customized = (execution.params is not None and span is None) or module._is_customized()
        if not customized and isinstance(module, IntensityAugmentationBase2D):
            part = color_part(module, execution.shape, span, module.flags)
            if part is not None:
                if not fits_one_program([*self.parts, part]) or len(self.chain) > MAX_TRANSFORMS:
                    self._flush()
                self.parts.append(part)
                return
        if not customized and isinstance(module, GeometricAugmentationBase2D):
            chain = module.transforms(execution.shape, module.flags)
            if chain is not None:
                if self.parts or (self.geometric and not self._joins(module)):
                    self._flush()
                first = 0 if span is None else span.first_value
                self.geometric.append((number, module, execution))
                self.chain += [t.moved(first) for t in chain]
                return
        self._flush()
        self.steps.append(number)

    def _joins(self, module: GeometricAugmentationBase2D) -> bool:
        """Whether one warp gives what the pending ones and then `module` give."""
        if self.once:
            return True
        if all(m.permutes_pixels for _, m, _ in self.geometric):
            return True
        return module.moves_whole_pixels and module.stays_inside

    def _flush(self, output: Output = SAME) -> None:
        geometric, chain, parts = self.geometric, self.chain, self.parts
        self.geometric, self.chain, self.parts = [], [], []
        if not geometric:
            if parts or output != SAME:
                self.steps.append(_Joined(make_pass(None, parts=parts, output=output), (), (), (0, 0), (0, 0), None))
            return
        height, width = geometric[0][2].shape[-2:]
        _, last, execution = geometric[-1]
        size = last.output_size(execution.shape, last.flags)
        interpolating = [m for _, m, _ in geometric if not m.moves_whole_pixels]
        reading = (interpolating or [last])[0]
        resampling = reading.resampling(reading.flags)
        own = make_pass(chain, size, resampling, parts, output)
        numbers = [number for number, _, _ in geometric]
        self.steps.append(_Joined(own, numbers, chain, (height, width), (size[0], size[1]), resampling))

    def finish(self, output: Output) -> list[_Joined | int]:
        self._flush(output)
        return self.steps
