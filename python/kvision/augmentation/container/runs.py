"""How containers execute: neighbors are joined into few passes over the images.

A run of augmentations draws all its parameters in one launch. Then

    neighboring color steps               become one color program
    flips, quarter turns and whole-pixel crops, with at most one resampling that interpolates,  become one warp
    everything else                       runs by itself

What is computed is what the augmentations compute one after the other, up to rounding. With `resample="once"` all neighboring
geometric augmentations become one warp, which interpolates once.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor, nn

from kvision.augmentation.base import AugmentationBase, Execution
from kvision.augmentation.columns import draw_columns
from kvision.augmentation.draws import Request
from kvision.augmentation.geometric_base import GeometricAugmentationBase2D, Resampling, warp
from kvision.augmentation.intensity_base import (
    ColorPart,
    IntensityAugmentationBase2D,
    color_part,
    fits_one_program,
    run_color,
)
from kvision.augmentation.keys import Keys, Seed, draw_keys
from kvision.augmentation.transforms import Transform, transform_matrix


class Child(NamedTuple):
    """A child of a container that is executed, with the parameters that it replays, if any."""

    name: str
    module: nn.Module
    params: Any = None


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
    frames: int = 1  # how many neighboring samples share their parameters: the frames of a video


def execute(x: Tensor, children: Sequence[Child], source: Randomness, position: int = 0) -> tuple[Tensor, list[Stage]]:
    """Run children on images (B, C, H, W); gives the result and what labels have to follow."""
    stages: list[Stage] = []
    for run in _runs(children):
        if isinstance(run[0].module, AugmentationBase):
            x, more = _execute_run(x, run, source, position)
            stages += more
        else:
            x, stage = _execute_module(x, run[0], source)
            stages.append(stage)
        position += len(run)
    return x, stages


def _runs(children: Iterable[Child]) -> list[list[Child]]:
    """Split children into augmentations that draw together, and modules that run by themselves."""
    runs: list[list[Child]] = []
    for child in children:
        replays = child.params is not None
        if (
            runs
            and replays == (runs[-1][-1].params is not None)
            and _has_known_size(child)
            and _has_known_size(runs[-1][-1])
        ):
            runs[-1].append(child)
        else:
            runs.append([child])
    return runs


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


def _execute_run(x: Tensor, run: Sequence[Child], source: Randomness, position: int) -> tuple[Tensor, list[Stage]]:
    modules: list[AugmentationBase] = [child.module for child in run]  # type: ignore[misc]  # by _runs
    if run[0].params is not None:
        executions = _replay(x, run)
    else:
        executions = _draw(x, modules, source, position)
        if source.frames > 1:
            executions = _repeated(executions, source.frames)
    pending = _Pending(x, source.once)
    for module, execution in zip(modules, executions):
        execution.shape = (x.shape[0], *pending.shape[1:])
        module._execution = execution
        pending.add(module, execution)
    return pending.finish()


def _repeated(executions: Sequence[Execution], count: int) -> list[Execution]:
    """The same for `count` neighboring samples of each, which are the frames of a video."""
    drawn: dict[int, Tensor] = {}
    repeated = []
    for e in executions:
        columns = e.columns
        if columns is not None:
            if id(columns.drawn) not in drawn:
                drawn[id(columns.drawn)] = columns.drawn.repeat_interleave(count, 0)
            columns = columns._replace(drawn=drawn[id(columns.drawn)])
        # Without the keys: drawn again, samples would be others.
        repeated.append(Execution((e.shape[0] * count, *e.shape[1:]), columns, None, e.applied))
    return repeated


def _replay(x: Tensor, run: Sequence[Child]) -> list[Execution]:
    """The executions of augmentations with given parameters."""
    executions, image = [], x
    for child in run:
        module: AugmentationBase = child.module  # type: ignore[assignment]  # by _runs
        execution = module._from_params(child.params, image)
        if execution.applied:
            image = x.new_empty(1).expand(module.output_shape(execution.shape, module.flags))  # of its shape only
        executions.append(execution)
    return executions


def _draw(x: Tensor, modules: Sequence[AugmentationBase], source: Randomness, position: int) -> list[Execution]:
    """The executions of augmentations, whose parameters are drawn by one launch."""
    if source.frames > 1:
        x = x[:: source.frames]
    shape = tuple(x.shape)
    shapes, indices, applied = [], [], []
    requests: list[Request] = []
    keys: Keys | None = None
    for module in modules:
        request = module._request(shape) if module.p > 0 and module.p_batch > 0 else None
        index = len(requests)
        if request is not None:
            requests.append(request)
            if module.whole_batch and module.p_batch < 1:
                # What changes sizes by chance decides with its key on the host, before those after it are planned.
                keys = _more_keys(keys, len(requests), x, source)
        number = position + index if keys is not None and keys.one_key else index
        applies = module._applies(keys if request is not None else None, number)
        shapes.append(shape)
        applied.append(applies)
        indices.append(None if request is None else index)
        if applies:
            shape = module.output_shape(shape, module.flags)
    if requests:
        keys = _more_keys(keys, len(requests), x, source)
    first = position if keys is not None and keys.one_key else 0
    columns = draw_columns(x, keys, requests, first) if keys is not None and requests else []
    executions = []
    for at, i, applies in zip(shapes, indices, applied):
        if i is None or keys is None:
            executions.append(Execution(at, applied=applies))
        else:
            executions.append(Execution(at, columns[i], applied=applies, redraw=(keys, first + i)))
    return executions


def _more_keys(keys: Keys | None, count: int, x: Tensor, source: Randomness) -> Keys:
    """`count` keys, of which some may have been drawn."""
    if keys is None:
        return draw_keys(source.op, count, x.device, source.seed, source.generator)
    known = len(keys.keys)
    if keys.one_key or known == count:
        return keys
    more = draw_keys(source.op, count - known, x.device, source.seed, source.generator)
    return keys._replace(keys=torch.cat([keys.keys, more.keys]))


class _Pending:
    """Images, and the neighboring augmentations that wait to be executed on them together."""

    def __init__(self, x: Tensor, once: bool) -> None:
        self.x, self.once = x, once
        self.stages: list[Stage] = []
        self.colors: list[ColorPart] = []
        self.geometric: list[tuple[GeometricAugmentationBase2D, Execution]] = []

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the images after what is pending."""
        shape = tuple(self.x.shape)
        for module, _ in self.geometric:
            shape = module.output_shape(shape, module.flags)
        return shape

    def add(self, module: AugmentationBase, execution: Execution) -> None:
        if not execution.applied:
            return
        customized = (execution.params is not None and execution.columns is None) or module._is_customized()
        if not customized and isinstance(module, IntensityAugmentationBase2D):
            part = color_part(module, execution, module.flags)
            if part is not None:
                self._flush_geometric()
                if not fits_one_program([*self.colors, part]):
                    self._flush_colors()
                self.colors.append(part)
                return
        self._flush_colors()
        if not customized and isinstance(module, GeometricAugmentationBase2D):
            if module.transforms(execution.shape, module.flags) is not None:
                if self.geometric and not self._joins(module):
                    self._flush_geometric()
                self.geometric.append((module, execution))
                return
        self._flush_geometric()
        self._execute(module, execution)

    def _execute(self, module: AugmentationBase, execution: Execution) -> None:
        """Execute an augmentation by itself."""
        self.x = module._run(self.x, execution, module.flags)
        self.stages.append(Applied(module, execution, module.flags))

    def _joins(self, module: GeometricAugmentationBase2D) -> bool:
        """Whether one warp gives what the pending ones and then `module` give."""
        if self.once:
            return True
        if all(m.permutes_pixels for m, _ in self.geometric):
            return True
        return module.moves_whole_pixels and module.stays_inside

    def _flush_colors(self) -> None:
        if self.colors:
            self.x = run_color(self.x, self.colors)
            self.colors = []

    def _flush_geometric(self) -> None:
        pending, self.geometric = self.geometric, []
        if not pending:
            return
        if len(pending) == 1:
            self._execute(*pending[0])
            return
        source = (self.x.shape[-2], self.x.shape[-1])
        drawn, chain = _joined(self.x, pending)
        matrix = transform_matrix(drawn, chain)
        last, execution = pending[-1]
        size = last.output_size(execution.shape, last.flags)
        interpolating = [m for m, _ in pending if not m.moves_whole_pixels]
        resampling = (interpolating or [last])[0].resampling((interpolating or [last])[0].flags)
        self.x = warp(self.x, matrix, size, resampling)
        self.stages.append(Warp(matrix, source, size, resampling))

    def finish(self) -> tuple[Tensor, list[Stage]]:
        self._flush_geometric()
        self._flush_colors()
        return self.x, self.stages


def _joined(
    x: Tensor, pending: Sequence[tuple[GeometricAugmentationBase2D, Execution]]
) -> tuple[Tensor, list[Transform]]:
    """The chain of several augmentations, and the tensor that has the columns of all."""
    chain: list[Transform] = []
    tensors: list[Tensor] = []
    for module, execution in pending:
        drawn, own = module._chain(x, execution, module.flags)
        first = 0
        for t in tensors:
            if t is drawn:
                break
            first += t.shape[1]
        else:
            tensors.append(drawn)
        chain += [t.moved(first) for t in own]
    return (torch.cat(tensors, 1) if len(tensors) > 1 else tensors[0]), chain
