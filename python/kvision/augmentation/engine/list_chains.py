"""Containers of images of different sizes: runs by the launches of a batch, and the images that choose a child as one list.

Each image has a seed, and becomes what it becomes alone with it. Children that have no kernels for lists, and nothing else, are
called image by image. What was done to an image is put together when its labels, parameters or matrix are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from torch.compiler import is_compiling

from kvision.augmentation.engine.augmentation import AugmentationBase
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.call_labels import CallLabels
from kvision.augmentation.engine.execution import matrix_type
from kvision.augmentation.engine.label_settings import LabelSettings, MaskReading
from kvision.augmentation.engine.list_calls import refuse_list, seeds_of_list
from kvision.augmentation.engine.list_moves import Move, Moves, joined_moves
from kvision.augmentation.engine.list_runs import run_list
from kvision.augmentation.engine.parts import Parts, PartsOfImages, joined, params_of_rows
from kvision.augmentation.engine.record import Child, ParamItem, Record, SomeParamItem
from kvision.augmentation.engine.runs import execute, inside_child, runs_of
from kvision.augmentation.engine.stages import Chain, Nested, Stage
from kvision.augmentation.engine.turns import Turn, seed_of
from kvision.augmentation.warp_and_color import SAME
from kvision.geometry.transform.lists.arguments import sizes

Done = tuple[Sequence[Child], Sequence[Stage]]  # the children that an image got, and what labels have to follow


class ListStep(NamedTuple):
    """What some images of a list went through.

    Attributes:
        images: their numbers.
        done: the Done of image i among these; a replay need not say it.
        moving: has `moves` and `moved_masks` of these; None where labels follow image by image.
    """

    images: Sequence[int]
    done: Callable[[int], Done]
    moving: Any


class ChainParts(PartsOfImages):
    """A call of a container on a list."""

    def __init__(self, op: str, images: Sequence[Tensor], results: Sequence[Tensor], steps: Sequence[ListStep]) -> None:
        super().__init__(op, images)
        self._steps = steps
        self._sizes = [tuple(y.shape[-2:]) for y in results]
        self._identity = matrix_type(results[0])

    def moves(self) -> Moves | None:
        """As those of :class:`ListParts`."""
        if any(step.moving is None for step in self._steps):
            return None
        sides = [n for shape in self._shapes for n in shape[-2:]]
        return joined_moves(sides, ((step.images, step.moving.moves()) for step in self._steps))

    def moved_masks(self, masks: Any, reading: MaskReading) -> Sequence[Tensor] | None:
        """As those of :class:`ListParts`."""
        if any(step.moving is None for step in self._steps) or len(masks) != self.count:
            return None
        moved = list(masks)
        for images, _, moving in self._steps:
            own = moving.moved_masks([moved[i] for i in images], reading)
            if own is None:
                return None
            for i, mask in zip(images, own):
                moved[i] = mask
        return moved

    def params(self, read: Callable[[Any], Any]) -> list[Any]:
        """The parameters of children, as those of a batch: of each turn those of the images that it has."""
        items: list[Any] = []
        for images, done, _ in self._steps:
            of_child: dict[str, list[tuple[int, Child]]] = {}
            for i, sample in enumerate(images):
                for child in done(i)[0]:
                    of_child.setdefault(child.name, []).append((sample, child))
            for name, own in of_child.items():
                data = joined(
                    Parts(self.op, [[i] for i in range(len(own))], ()), [child.read_params() for _, child in own]
                )
                samples = torch.zeros(self.count, dtype=torch.bool, device="cpu")
                samples[[sample for sample, _ in own]] = True
                is_of_all = own[0][1].samples is None
                items.append(ParamItem(name, data) if is_of_all else SomeParamItem(name, data, samples))
        return items

    def _record(self, sample: int) -> Record:
        children: list[Child] = []
        stages: list[Stage] = []
        for images, done, _ in self._steps:
            if sample in images:
                own, more = done(images.index(sample))
                children += own
                stages += more
        record = Record(self._shapes[sample], children, Chain(stages))
        record.size, record.identity = self._sizes[sample], self._identity
        return record


def run_chain(
    module: Any, images: list[Tensor], params: Any, context: CallContext, generator: Generator | None
) -> tuple[Any, ChainParts] | None:
    """The results of a container on a list, a list or a batch, and its parts; None where others call it."""
    if not _runs(module, images, context):
        return None
    if params is None:
        modules = list(module.modules())
        refuse_list(context.op, modules)
        seeds = seeds_of_list(context.op, modules, len(images), context.seed, generator or module.generator)
        context = context._replace(seed=seeds, generator=None)
    y, steps = _run_container(module, images, params, context)
    return y, ChainParts(context.op, images, y, steps)


def _runs(module: Any, images: Sequence[Tensor], context: CallContext) -> bool:
    """Whether a container is run here on images, which have several sizes."""
    if len({x.shape for x in images}) == 1 or not module._plans.made("chains", lambda: _takes_lists(module)):
        return False
    if not all(m._takes_masks(images, context) for m in module.modules() if _needs_masks(m)):
        return False
    has_bytes_and_floats = images[0].dtype == torch.uint8 and any(
        m._result_dtype(torch.uint8) != torch.uint8 for m in module.modules() if isinstance(m, AugmentationBase)
    )
    return not has_bytes_and_floats and context.output == SAME and not is_compiling()


def _takes_lists(container: Any) -> bool:
    """Whether all that is in a container takes an image of a list alone, and keeps its type."""
    if not _is_plain(container) or any(getattr(m, "_output", SAME) != SAME for m in container.modules()):
        return False
    augmentations = [m for m in container.modules() if isinstance(m, AugmentationBase)]
    return not any(m.mixes_samples or not m.takes_lists for m in augmentations)


def _is_plain(module: Any) -> bool:
    """Whether a module is a container that runs children one after the other, or chooses them."""
    return bool(getattr(module, "_runs_lists", False))


def _needs_masks(module: Any) -> bool:
    """Whether a module changes images by their masks."""
    return bool(getattr(module, "needs_masks", False))


def _takes_whole_lists(module: Any, context: CallContext) -> bool:
    """Whether a module executes a list by itself, as policies do."""
    return hasattr(module, "_execute_list") and context.owners is None


# --- execution ------------------------------------------------------------------------------------------------------


def _run_container(module: Any, images: list[Tensor], params: Any, context: CallContext) -> tuple[Any, list[ListStep]]:
    """The children of a container on images, whose seeds the context has, or with given parameters."""
    in_turns = module._in_turns(images, params, context)
    if in_turns is None:
        return _run_children(images, module._children_of_call(params, context), context, context.position)
    turns, own = in_turns
    results, steps = list(images), list[ListStep]()
    for turn in turns:
        if turn.samples:
            now = _behind(own, turn.children, images, results, steps)
            steps += _run_turn(results, turn, now)
    return results, steps


def _run_turn(results: list[Tensor], turn: Turn, context: CallContext) -> list[ListStep]:
    """Run the children of a turn on its images among `results`, whose places the new ones take."""
    samples, owners = list(turn.samples), [-1] * len(turn.samples)
    labels = None if context.labels is None else context.labels.some(samples, sizes(results))
    own = context._replace(seed=seed_of(context.seed, samples, len(results)), labels=labels)
    if turn.parts is not None:
        for number, chosen in enumerate(turn.parts):
            for sample in chosen:
                owners[samples.index(sample)] = number
        own = own._replace(once=True, owners=torch.tensor(owners, device="cpu"))
    children = [replace(child, samples=None) for child in turn.children]
    y, steps = _run_children([results[i] for i in samples], children, own, turn.position)
    for i, result in zip(samples, y):
        results[i] = result
    return [ListStep([samples[i] for i in images], _of_turn(done, owners), moving) for images, done, moving in steps]


def _of_turn(done: Any, owners: Sequence[int]) -> Callable[[int], Done]:
    """What images of a turn got, of which each has the child that `owners` says, or all where that is -1."""

    def of_image(i: int) -> Done:
        (children, stages), owner = done(i), owners[i]
        if owner < 0:
            return [replace(child, samples=[0], batch=1) for child in children], stages
        return [replace(children[owner], samples=[0], batch=1, rows=[0])], stages

    return of_image


def _run_children(
    images: list[Tensor], children: Sequence[Child], context: CallContext, position: int
) -> tuple[Any, list[ListStep]]:
    """Children one after the other, each run and each container inside by itself."""
    everything, steps, given = range(len(images)), list[ListStep](), images
    y: Any = images
    for run, is_joined in runs_of(children, context.plans):
        images = y if isinstance(y, list) else list(y)
        module: Any = run[0].module
        own = _behind(context, run, given, images, steps)._replace(position=position)
        runs_list = (is_joined or _needs_masks(module)) and _follow_moves(run, own.labels, images)
        done = run_list(images, run, own) if runs_list else None
        if done is not None:
            y, parts = done
            steps.append(ListStep(everything, parts.done, parts))
        elif not is_joined and (_is_plain(module) or _takes_whole_lists(module, context)):
            inside, params = module._inside(inside_child(own, position)), run[0].params
            if own.labels is not None:
                inside = inside._replace(labels=own.labels.inside_list(module._label_settings))
            parts_inside: Any
            if _is_plain(module):
                y, more = _run_container(module, images, params, inside)
                parts_inside = ChainParts(context.op, images, y, more)
            else:
                y, parts_inside = module._execute_list(images, params, inside)
            if params is None:
                module._keep(Record(parts=parts_inside))
            moving = _Inside(parts_inside, module._label_settings)
            steps.append(ListStep(everything, _of_inside(run[0], parts_inside), moving))
        else:
            y, each = _run_each(images, run, own, position)
            steps.append(ListStep(everything, each.__getitem__, _moving_of_each(images, run, each)))
        position += len(run)
    return y, steps


def _behind(
    context: CallContext,
    children: Sequence[Child],
    images: list[Tensor],
    results: list[Tensor],
    steps: Sequence[ListStep],
) -> CallContext:
    """The context of children of images that became `results` by steps, with their labels if these children read any."""
    labels = context.labels
    if labels is None or not any(_kind_of_labels(m) for child in children for m in child.module.modules()):
        return context._replace(labels=None)
    return context._replace(
        labels=labels.through(ChainParts(context.op, images, results, [*steps])) if steps else labels
    )


def _kind_of_labels(module: Any) -> str | None:
    """What a module reads, boxes or masks."""
    kind: str | None = getattr(module, "reads_labels", None)
    return kind or ("masks" if _needs_masks(module) else None)


def _follow_moves(children: Sequence[Child], labels: CallLabels | None, images: list[Tensor]) -> bool:
    """Whether the boxes that children read, if any, follow what moves all images before them."""
    if labels is None or not any(_kind_of_labels(child.module) == "boxes" for child in children):
        return True
    return labels.moved(Moves([], sizes(images))).moves is not None


class _Inside(NamedTuple):
    """What labels follow in a container that is a child."""

    parts: Any  # a ChainParts, or the parts of a policy
    settings: LabelSettings | None

    def moves(self) -> Moves | None:
        moves: Moves | None = self.parts.moves()
        return None if moves is None else moves.inside(self.settings)

    def moved_masks(self, masks: Any, reading: MaskReading) -> Sequence[Tensor] | None:
        return self.parts.moved_masks(masks, reading.inside(self.settings))


class _Still(NamedTuple):
    """What labels follow where augmentations leave them: sides of images, and those that went through a step."""

    sides: Sequence[int]
    samples: Sequence[int]

    def moves(self) -> Moves:
        return Moves([Move((), self.sides, self.sides, self.samples)] if self.samples else [], self.sides)

    def moved_masks(self, masks: Any, reading: MaskReading) -> Any:
        return masks


def _moving_of_each(images: Sequence[Tensor], children: Sequence[Child], each: Sequence[Done]) -> _Still | None:
    """What labels follow of children that ran on each image alone, if these leave them; None for others."""
    modules: list[Any] = [child.module for child in children]
    if not all(isinstance(m, AugmentationBase) and m._leaves_labels for m in modules):
        return None
    return _Still([n for x in images for n in x.shape[-2:]], [i for i, (_, stages) in enumerate(each) if stages])


def _of_inside(child: Child, parts: Parts) -> Callable[[int], Done]:
    """What a container that is a child did to images."""
    module: Any = child.module

    def of_image(i: int) -> Done:
        record = parts.calls[i]
        return [replace(child, record=record)], [Nested(record.stages.stages, module._label_settings)]

    return of_image


def _run_each(
    images: list[Tensor], children: Sequence[Child], context: CallContext, position: int
) -> tuple[list[Tensor], list[Done]]:
    """Children that have no kernels for lists, on each image alone."""
    results: list[Tensor] = []
    each: list[Done] = []
    for b, x in enumerate(images):
        own = [replace(child, params=params_of_rows(child.params, [b], len(images))) for child in children]
        owners = context.owners
        alone = context._replace(seed=seed_of(context.seed, [b], len(images)))
        if owners is not None:
            alone = alone._replace(owners=owners[b : b + 1])
        if context.labels is not None:
            alone = alone._replace(labels=context.labels.of_image(b))
        y, stages = execute(x[None], own, alone, position)
        results.append(y[0])
        each.append((own, stages))
    return results, each
