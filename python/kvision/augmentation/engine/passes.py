"""Plans of neighboring augmentations: which of them share a pass over the images.

The planner knows no class. It asks each augmentation for its contribution (contribution.py), and lets neighbors wait
until the next one cannot join them. Four kinds of steps come out of it: passes, antialiased warps, resamplings at composed
coordinates, and augmentations that run by themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._dtype import as_dtype, compute_dtype
from kvision.augmentation.columns import DrawPlan
from kvision.augmentation.displacements import NoiseField
from kvision.augmentation.drawn_links import DrawnLinks
from kvision.augmentation.drawn_pass import DrawnPass
from kvision.augmentation.engine.contribution import Motion
from kvision.augmentation.engine.execution import Execution, check_images
from kvision.augmentation.engine.executor import Executor
from kvision.augmentation.engine.lists import ListWarp
from kvision.augmentation.engine.sized import ImagesOfList, Sized
from kvision.augmentation.engine.stages import Applied, ByMatrix, Composed, Stage, Warp
from kvision.augmentation.lists.conversions import run_on_list
from kvision.augmentation.maps import read_composed_list, warp_covered, warp_covered_each
from kvision.augmentation.samples import where_chosen
from kvision.augmentation.transforms import MAX_TRANSFORMS, MatrixPlan, Transform, keeps_rows, transform_matrix
from kvision.augmentation.warp_and_color import SAME, ColorPart, Output, Pass, Resampling, fits_one_program, make_pass
from kvision.augmentation.warp_and_color_list import warp_and_color_list, warp_and_color_to_list
from kvision.geometry.transform.lists.arguments import images_of, like_batch

# Gives the map of an augmentation of a run for kernels that draw its noise; None if it is another map.
NoiseFields = Callable[[int], NoiseField | None]

# --- steps ----------------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class Running:
    """A run of augmentations while it is executed."""

    modules: Sequence[Any]  # augmentations
    executions: Sequence[Execution]
    columns: Tensor | None  # of all
    has_labels: bool  # which follow the images, so that maps are kept for them
    # Of the first step, where a kernel computed it with the draws:
    result: tuple[Any, Tensor | None] | None = None  # images, and matrices of a pass
    links: Sequence[Tensor] | None = None  # of a composition
    pieces: Tensor | None = None  # of the images, copies of which the next step reads
    of_list: ImagesOfList | None = None  # of images that are a list, until a step makes them a batch

    def parts(self, numbers: Sequence[int]) -> Sequence[Stage]:
        """Augmentations that are one step by themselves, where one of them removes boxes."""
        if not any(self.modules[n].removes_boxes for n in numbers):
            return ()
        return [self.applied(n) for n in numbers]

    def applied(self, number: int) -> Applied:
        """An augmentation by itself, by its number in the run."""
        return Applied(self.modules[number], self.executions[number], self.modules[number].flags)

    def columns_for(self, like: Tensor, count: int) -> Tensor:
        """The columns of `count` images in the type in which images like a tensor are computed."""
        dtype = compute_dtype(like)
        return like.new_empty(count, 0, dtype=dtype) if self.columns is None else as_dtype(self.columns, dtype)

    @property
    def begins_with_batch(self) -> bool:
        """Whether the first augmentation makes a list a batch."""
        return self.of_list is not None and self.of_list.sized.own == 0

    def warp_of_list(
        self, numbers: Sequence[int], matrix: Tensor | None, size: Sequence[int], resampling: Any
    ) -> ListWarp | None:
        """The stage of augmentations by their numbers, if the first one has made a list a batch with images of a size."""
        if not self.begins_with_batch:
            return None
        assert matrix is not None
        if len(numbers) == 1:
            self.executions[0].keep_matrix(matrix)
        return ListWarp(matrix, self.of_list, list(size), resampling, parts=self.parts(numbers))


class Alone(NamedTuple):
    """An augmentation that runs by itself."""

    number: int  # in the run
    chain: Sequence[Transform] = ()  # of its matrix, if it has one, bound to its columns
    read_by: Pass | None = None  # the pass behind it, which may read pieces of images where these are

    def _run_list(self, images: Sequence[Tensor], running: Running) -> tuple[Any, Stage | None]:
        """The same of a list, which stays one or becomes a batch."""
        module, execution = running.modules[self.number], running.executions[self.number]
        if module.warps_lists_by_matrix or running.begins_with_batch:
            execution.matrix = transform_matrix(running.columns_for(images[0], len(images)), self.chain)
        y = module._run_list(images, module._with_maps(images, execution))
        if not running.begins_with_batch:
            return y, None
        y = torch.stack(y) if isinstance(y, list) else y  # as of LongestMaxSize(1), whose results are one pixel
        return y, running.warp_of_list([self.number], execution.matrix, y.shape[2:], module.resampling(module.flags))

    def run(self, x: Any, running: Running) -> tuple[Any, Stage | None]:
        if running.of_list is not None and isinstance(x, list):
            return self._run_list(x, running)
        applied = running.applied(self.number)
        if self.read_by is not None and self.read_by.reads_pieces(x):
            running.pieces = applied.module._copied_pieces(applied.execution)
            if running.pieces is not None:
                return x, applied
        applied.execution.keeps_map = running.has_labels
        y = running.result[0] if running.result else applied.module._run(x, applied.execution, applied.flags)
        running.result = None
        return y, applied

    def drawn_with(self, draws: DrawPlan, x: Tensor, noise_field: NoiseFields) -> None:
        return None


class Joined(NamedTuple):
    """Augmentations that are executed in one pass."""

    image_pass: Pass
    geometric: Sequence[int]  # the augmentations that it warps for, by their numbers in the run
    chain: Sequence[Transform]
    source: tuple[int, int]
    size: tuple[int, int]
    resampling: Resampling | None

    def run(self, x: Any, running: Running) -> tuple[Any, Stage | None]:
        if running.of_list is not None and isinstance(x, list):
            y, matrix = running.result or self._run_list(x, running.columns, running.of_list.sized)
            running.result = None
            return y, running.warp_of_list(self.geometric, matrix, self.size, self.resampling)
        y, matrix = running.result or self.image_pass.run(x, running.columns, running.pieces)
        running.result = running.pieces = None
        return y, self.stage(x, matrix, running)

    def _run_list(self, images: list[Tensor], columns: Tensor | None, sized: Sized) -> tuple[Any, Tensor | None]:
        """What the pass makes of a list: a batch with its matrices where an augmentation gives all images one size, or a list."""
        if not self.image_pass.warps:
            return run_on_list(self.image_pass, images, columns), None
        columns, fill, size, *rest = self.image_pass.arguments(like_batch(images), columns)
        if sized.own in self.geometric:
            y, matrix, _ = warp_and_color_list(images, columns, fill, size, *rest)
            return y, matrix
        sizes = sized.sizes_after(self.geometric, images) if sized.changes(self.geometric) else []
        return list(warp_and_color_to_list(images, columns, fill, len(size) > 0, sizes, *rest)[: len(images)]), None

    def replayed(self, like: Tensor, running: Running) -> Stage | None:
        """The stage of images that were moved already, like a batch of their type and device."""
        if not self.geometric:
            return None
        columns = running.columns_for(like, running.executions[0].shape[0])
        return self.stage(like, transform_matrix(columns, self.chain), running)

    def stage(self, x: Tensor, matrix: Tensor | None, running: Running) -> Stage | None:
        """What labels have to follow, by the matrices of the warp of images like x; None for colors."""
        columns = running.columns
        if not self.geometric:
            return None
        assert matrix is not None
        if len(self.geometric) == 1:
            applied = running.applied(self.geometric[0])
            applied.execution.keep_matrix(matrix)
            return applied
        if columns is not None and columns.requires_grad:
            matrix = transform_matrix(as_dtype(columns, compute_dtype(x)), self.chain)
        assert self.resampling is not None
        return Warp(matrix, self.source, self.size, self.resampling, parts=running.parts(self.geometric))

    def drawn_with(self, draws: DrawPlan, x: Tensor, noise_field: NoiseFields) -> DrawnPass:
        """The draws with the pass over images like x by one kernel."""
        return DrawnPass(draws, self.image_pass, tuple(x.shape), x.dtype)


class Covering(NamedTuple):
    """Augmentations that are executed by one warp, which averages what a pixel of the result covers."""

    geometric: Sequence[int]  # the augmentations, by their numbers in the run
    chain: Sequence[Transform]
    plan: MatrixPlan  # of the chain
    source: tuple[int, int]
    size: tuple[int, int]
    resampling: Resampling

    def run(self, x: Any, running: Running) -> tuple[Any, Stage | None]:
        links, running.links = running.links, None
        like = x[0] if isinstance(x, list) else x
        matrix = links[0] if links else self.plan.matrix(running.columns_for(like, len(x)))
        if running.of_list is None or not isinstance(x, list):
            return warp_covered(x, matrix, self.size, self.resampling), self._stage(matrix, running)
        sized = running.of_list.sized
        if sized.own in self.geometric:
            (y,) = warp_covered_each(x, matrix, self.size, self.resampling)
            return y, running.warp_of_list(self.geometric, matrix, self.size, self.resampling)
        results = warp_covered_each(x, matrix, sized.sizes_after(self.geometric, x), self.resampling)
        return images_of(results), None

    def replayed(self, like: Tensor, running: Running) -> Stage:
        """As that of :class:`Joined`."""
        return self._stage(self.plan.matrix(running.columns_for(like, running.executions[0].shape[0])), running)

    def _stage(self, matrix: Tensor, running: Running) -> Warp:
        return Warp(matrix, self.source, self.size, self.resampling, parts=running.parts(self.geometric))

    def drawn_with(self, draws: DrawPlan, x: Tensor, noise_field: NoiseFields) -> DrawnLinks:
        """The draws with the matrix by one kernel."""
        return DrawnLinks(draws, [self.plan])


class Composition(NamedTuple):
    """Augmentations that are executed by one resampling, some of which have no matrix."""

    # Chains of matrices, and augmentations that are maps, by their numbers in the run.
    links: Sequence[MatrixPlan | int]
    geometric: Sequence[int]  # the augmentations, by their numbers in the run
    source: tuple[int, int]
    size: tuple[int, int]
    resampling: Resampling
    antialias: bool

    def run(self, x: Any, running: Running) -> tuple[Any, Stage | None]:
        if running.of_list is not None and isinstance(x, list):
            return self._run_list(x, running, running.of_list), None
        composed = self.replayed(x, running)
        return composed.run(x), composed

    def _run_list(self, images: list[Tensor], running: Running, of_list: ImagesOfList) -> Any:
        """The results of a list: a list, or a batch where an augmentation gives all images one size."""
        count, columns = len(images), running.columns_for(images[0], len(images))
        links: list[tuple[Tensor, Sequence[int]]] = []
        for link in self.links:
            if isinstance(link, MatrixPlan):
                links.append((link.matrix(columns), ()))
                continue
            execution = running.executions[link]
            sides = of_list.sides_before(link, execution.shape)
            maps = running.modules[link]._maps_of_list(sides, execution, columns.new_empty(count, 0))
            links.append((maps, sides))
        sized = of_list.sized
        if sized.own in self.geometric:
            return torch.stack(read_composed_list(images, links, [*self.size] * count, self.resampling))
        return read_composed_list(images, links, sized.sizes_after(self.geometric, images), self.resampling)

    def replayed(self, like: Tensor, running: Running) -> Composed:
        """As that of :class:`Joined`."""
        columns = running.columns_for(like, running.executions[0].shape[0])
        drawn = None if running.links is None else list(running.links)
        running.links = None
        links: list[ByMatrix | Applied] = []
        for i, link in enumerate(self.links):
            if isinstance(link, MatrixPlan):
                links.append(ByMatrix(link.matrix(columns) if drawn is None else drawn[i]))
                continue
            links.append(running.applied(link))
            if drawn is not None:
                drawn[i] = where_chosen(running.executions[link].chosen, drawn[i], 0.0)
        sizes, parts = (self.source, self.size), running.parts(self.geometric)
        return Composed(*sizes, self.resampling, links, self.antialias, drawn, parts=parts)

    def drawn_with(self, draws: DrawPlan, x: Tensor, noise_field: NoiseFields) -> DrawnLinks | None:
        """The draws with the links by one kernel; None if it does not serve all."""
        each = [link if isinstance(link, MatrixPlan) else noise_field(link) for link in self.links]
        served = [link for link in each if link is not None]
        return DrawnLinks(draws, served) if len(served) == len(each) else None


Step = Joined | Covering | Composition | Alone


# --- the planner ----------------------------------------------------------------------------------------------------


def plan_steps(
    modules: Sequence[Executor],
    executions: Sequence[Execution],
    once: bool,
    dtype: torch.dtype,
    output: Output,
    chains: Mapping[int, Sequence[Transform]] = MappingProxyType({}),
) -> list[Step]:
    """What is executed for these executions, of whose columns only the spans count, on images of a type.

    `once`: neighboring geometric augmentations are resampled once. `output` is the type and layout of the result. `chains`
    replace those of augmentations, by their numbers, bound to their columns.
    """
    planner = _Planner(once, dtype, chains)
    for number, (module, execution) in enumerate(zip(modules, executions)):
        planner.add(number, module, execution)
    return planner.finish(output)


class _Geometric(NamedTuple):
    """A geometric augmentation that waits to be joined."""

    number: int  # in the run
    motion: Motion
    chain: Sequence[Transform]  # bound to its columns; empty for a map
    source: tuple[int, int]


class _Planner:
    """Neighboring augmentations that wait to be joined in one pass, and the steps before them."""

    def __init__(self, once: bool, dtype: torch.dtype, chains: Mapping[int, Sequence[Transform]]) -> None:
        self.once, self.chains = once, chains
        self.dtype = dtype  # of the images that come next
        self.converted: torch.dtype | None = None  # of the result of the pending color steps, if it is another one
        self.steps: list[Step] = []
        self.geometric: list[_Geometric] = []
        self.parts: list[ColorPart] = []

    def add(self, number: int, module: Executor, execution: Execution) -> None:
        if not execution.applied and not module.mixes_samples:  # what mixes gives labels the shape of mixed ones
            return
        shape, columns = execution.shape, execution.columns
        span = None if columns is None else columns.span
        result = module._result_dtype(self.dtype)
        contribution = module._contribution(shape, module.flags)
        motion = None if contribution is None else contribution.motion
        colors = None if contribution is None else contribution.colors
        if contribution is not None and not contribution.takes_volumes:
            check_images(type(module).__name__, shape, module.axes + 1)
        has_columns = execution.params is None or span is not None
        chain: Sequence[Transform] = ()
        if motion is not None and has_columns:
            chain = self.chains.get(number) or module._bound(motion.chain or (), span)
        if colors is not None and has_columns:
            constants = module._constants(shape, execution.params)
            part = module._color_part(colors, span, constants)
            if (
                self.geometric and shape[1] not in (1, 3) and part.has_contrast
            ):  # which no kernel of warps has for these
                self._end_warp()
            self._add_colors(part, result)
        elif motion is not None and (motion.is_map or has_columns) and (self.once or motion.reads_by_matrix):
            self._add_motion(_Geometric(number, motion, chain, (shape[-2], shape[-1])))
        else:
            self._flush()
            self.steps.append(Alone(number, chain))
            self.dtype = result

    def _add_colors(self, part: ColorPart, result: torch.dtype) -> None:
        if not fits_one_program([*self.parts, part]):
            self._continue_colors()
        elif len(_chain(self.geometric)) > MAX_TRANSFORMS:
            self._flush()
        self.parts.append(part)
        if result != self.dtype:
            self.dtype = self.converted = result

    def _end_warp(self) -> None:
        """End a pass before a color program of its own."""
        if self.parts:
            self._continue_colors()
        else:
            self._flush()

    def _add_motion(self, geometric: _Geometric) -> None:
        if self.parts or (self.geometric and not self._joins(geometric)):
            self._flush()
        self.geometric.append(geometric)

    def _joins(self, geometric: _Geometric) -> bool:
        """Whether one warp gives what the pending ones and then `geometric` give."""
        if self.once:
            return True
        together = [*self.geometric, geometric]
        if any(g.motion.is_antialiased for g in together):
            return _is_window(together)
        if all(g.motion.permutes_pixels for g in self.geometric):
            return True
        return geometric.motion.moves_whole_pixels and geometric.motion.stays_inside

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
        alone = [at for at, g in enumerate(geometric) if g.motion.is_map or g.motion.is_antialiased]
        if not alone or _is_window(geometric):
            self._join(geometric, parts, output)
        elif sum(g.motion.interpolates for g in geometric) == 1 and _reads_all(geometric, alone[0]):
            (at,) = alone
            self._join(geometric[:at])
            self.steps.append(Alone(geometric[at].number, geometric[at].chain))
            self._join(geometric[at + 1 :], parts, output)
        else:
            self._compose(geometric)
            self._join([], parts, output)

    def _join(self, geometric: Sequence[_Geometric], parts: Sequence[ColorPart] = (), output: Output = SAME) -> None:
        """One pass for geometric augmentations and color steps."""
        if not geometric:
            if parts or output != SAME:
                self.steps.append(Joined(make_pass(None, parts=parts, output=output), (), (), (0, 0), (0, 0), None))
            return
        source, size, resampling = _sizes_and_resampling(geometric)
        chain = _chain(geometric)
        image_pass = make_pass(chain, size, resampling, parts, output)
        if self.steps and isinstance(self.steps[-1], Alone):
            self.steps[-1] = self.steps[-1]._replace(read_by=image_pass)
        self.steps.append(Joined(image_pass, [g.number for g in geometric], chain, source, size, resampling))

    def _compose(self, geometric: Sequence[_Geometric]) -> None:
        numbers, sampling = [g.number for g in geometric], _sizes_and_resampling(geometric)
        if not any(g.motion.is_map for g in geometric):
            matrices = _chain(geometric)
            self.steps.append(Covering(numbers, matrices, MatrixPlan(matrices), *sampling))
            return
        links: list[MatrixPlan | int] = []
        chain: list[Transform] = []
        for g in geometric:
            chain += g.chain
            if g.motion.is_map:
                links += [MatrixPlan(chain)] if chain else []
                links.append(g.number)
                chain = []
        links += [MatrixPlan(chain)] if chain else []
        antialias = any(g.motion.is_antialiased for g in geometric)
        self.steps.append(Composition(links, numbers, *sampling, antialias))

    def finish(self, output: Output) -> list[Step]:
        self._flush(output)
        return self.steps


def _reads_all(geometric: Sequence[_Geometric], at: int) -> bool:
    """Whether one by itself, the only one that interpolates, reads what it reads composed with its neighbors.

    A map also reads beyond the edges of what it gets: there is the image where a crop is before it, which is read once.
    """
    others = [g.motion for g in geometric[at + 1 :]]
    own, before = geometric[at].motion, [g.motion for g in geometric[:at]]
    return not own.is_map or (
        all(motion.permutes_pixels for motion in before) and all(motion.stays_inside for motion in others)
    )


def _is_window(geometric: Sequence[_Geometric]) -> bool:
    """Whether neighbors are a window that is resized with antialiasing, before or after flips, which mirror it."""
    own = [g.motion for g in geometric if g.motion.is_antialiased]
    if len(own) != 1 or not own[0].resampling.antialias:
        return False
    others_flip = all(g.motion.is_antialiased or g.motion.permutes_pixels for g in geometric)
    return others_flip and keeps_rows(_chain(geometric))


def _chain(geometric: Sequence[_Geometric]) -> list[Transform]:
    """The transforms of augmentations without maps."""
    return [t for g in geometric for t in g.chain]


def _sizes_and_resampling(geometric: Sequence[_Geometric]) -> tuple[tuple[int, int], tuple[int, int], Resampling]:
    """The sizes before and behind neighbors, and how the images are read: as by the first one that interpolates."""
    first, last = geometric[0], geometric[-1]
    reading = next((g.motion for g in geometric if g.motion.interpolates), last.motion)
    return first.source, last.motion.size, reading.resampling
