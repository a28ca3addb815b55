"""What the labels of a list of images follow: passes over all of its images, and the sizes of these in between."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._dtype import as_dtype, compute_dtype
from kvision.augmentation.engine.label_settings import LabelSettings
from kvision.augmentation.engine.lists import Link, ListMap, OnList, Round, SizeOfEach, with_sides
from kvision.augmentation.engine.passes import Alone, Composition, Step
from kvision.augmentation.engine.sized import SIZES, ImagesOfList
from kvision.augmentation.engine.stages import Stage
from kvision.augmentation.sample_rows import index_of
from kvision.augmentation.transforms import MatrixPlan, transform_matrix
from kvision.augmentation.warp_and_color import Resampling


class LabelStep(NamedTuple):
    """What labels follow in a run on a list: one warp, or an augmentation that runs by itself.

    Attributes:
        numbers: its augmentations, by their numbers in the run; none of a policy, whose steps have matrices.
        links: that move pixels; none of an augmentation that leaves labels, or changes them by its own methods.
        resampling: of images; None for one augmentation, which says how it reads masks.
        before: height and width of each image before it.
        after: those of its results.
    """

    numbers: Sequence[int]
    links: Sequence[Link]
    resampling: Resampling | None
    before: Sequence[int]
    after: Sequence[int]


def label_steps(
    modules: Sequence[Any],
    calls: Iterable[Any],
    steps: Sequence[Step],
    columns: Tensor | None,
    of_list: ImagesOfList,
    like: Tensor,
    execution: Callable[[int], Any],
) -> list[LabelStep]:
    """What labels follow of a run on images like a batch, in its order.

    `calls` say which augmentations are applied, and to images of which shape; `execution` gives what one of them did.
    """
    columns = as_dtype(like.new_empty(len(like), 0) if columns is None else columns, compute_dtype(like))
    sides, own = list(of_list.sides), of_list.sized.own
    step_of = {n: s for s in steps for n in ([s.number] if isinstance(s, Alone) else s.geometric)}
    found: list[LabelStep] = []
    for number, (module, (applies, shape)) in enumerate(zip(modules, calls)):
        step, resampling = step_of.get(number), None
        numbers: Sequence[int] = [number]
        if step is not None and not isinstance(step, Alone):
            numbers, resampling = step.geometric, step.resampling if len(step.geometric) > 1 else None
        if step is None or not applies or numbers[0] != number:
            continue
        after = sides
        if numbers[-1] >= own and not module.keeps_positions:
            size = module.output_shape(shape, module.flags)[2:] if isinstance(step, Alone) else step.size
            after = [*size] * len(like)
        elif of_list.sized.changes(numbers):
            after = of_list.sized.sides_after(numbers, sides)
        links = _links(step, modules, columns, of_list, execution)
        if hasattr(module, "_motion_of_list") and not module.has_known_size:
            matrix, after = module._motion_of_list(sides, execution(number), like)
            links = [matrix]
        found.append(LabelStep(numbers, links, resampling, sides, after))
        sides = after
    return found


def _links(
    step: Step,
    modules: Sequence[Any],
    columns: Tensor,
    of_list: ImagesOfList,
    execution: Callable[[int], Any],
) -> list[Link]:
    """What a step moves pixels by."""

    def map_of(number: int) -> ListMap:
        own, count = execution(number), len(columns)
        sides = of_list.sides_before(number, own.shape)

        def make(like: Tensor) -> Tensor:
            maps: Tensor = modules[number]._maps_of_list(sides, own, like.new_empty(count, 0))
            return maps

        return ListMap(make, None if own.chosen is None else own.chosen.expand(count), sides)

    if isinstance(step, Composition):
        return [link.matrix(columns) if isinstance(link, MatrixPlan) else map_of(link) for link in step.links]
    if isinstance(step, Alone) and modules[step.number].moves_by_map and modules[step.number]._knows_maps_of_lists:
        return [map_of(step.number)]
    return [transform_matrix(columns, step.chain)] if step.chain else []


class Move(NamedTuple):
    """A step on some images of a list: all, where `samples` is None. Sizes are height and width of all images around it.

    It has links, or none where nothing moves. `crops`, one bool of each, are the images of which boxes with centers outside of the
    results are removed.
    """

    links: Sequence[Link]
    before: Sequence[int]
    after: Sequence[int]
    samples: Sequence[int] | None = None
    crops: Tensor | None = None

    def of_some(self, samples: Sequence[int], sides: Sequence[int]) -> Move:
        """The same as a step on some images of a list of these sizes."""
        before, after = (with_sides(sides, samples, own) for own in (self.before, self.after))
        return self._replace(before=before, after=after, samples=_places(samples, self.samples))

    def of_rows(self, rows: Sequence[int]) -> Move:
        """The step on some of its images."""
        links = [
            link.index_select(0, index_of(rows, link)) if isinstance(link, Tensor) else link.of_rows(rows)
            for link in self.links
        ]
        crops = None if self.crops is None else self.crops.index_select(0, index_of(rows, self.crops))
        samples = rows if self.samples is None else [self.samples[i] for i in rows]
        return Move(links, self.before, self.after, samples, crops)

    def stage(self, device: torch.device) -> OnList:
        """The same as a stage of all images."""
        samples, sides, links, crops = self.samples, self.before, self.links, self.crops
        if samples is not None:
            count = len(sides) // 2
            links = [
                _among(samples, torch.eye(3, dtype=link.dtype, device=link.device).expand(count, 3, 3), link)
                if isinstance(link, Tensor)
                else link.among(samples, sides, device)
                for link in links
            ]
            if crops is not None:
                crops = _among(samples, crops.new_zeros(count), crops)
        return OnList(SizeOfEach(sides, device), SizeOfEach(self.after, device), samples, links, crops)


def _among(samples: Sequence[int], others: Tensor, own: Tensor) -> Tensor:
    """Rows of all images, of which those of samples are given."""
    return others.index_copy(0, index_of(samples, own), own)


class Inside(NamedTuple):
    """The moves in a container inside through which some images of a list went, where boxes are filtered in it."""

    moves: Sequence[Any]  # of Move and Inside
    after: Sequence[int]
    settings: LabelSettings
    samples: Sequence[int] | None = None

    def of_some(self, samples: Sequence[int], sides: Sequence[int]) -> Inside:
        """As that of :class:`Move`."""
        moves, places = [move.of_some(samples, sides) for move in self.moves], _places(samples, self.samples)
        return Inside(moves, with_sides(sides, samples, self.after), self.settings, places)

    @property
    def filters(self) -> bool:
        """Whether boxes are filtered at its end."""
        return not self.settings.box_filter.does_nothing

    def filtered(self) -> set[int]:
        """The images of which boxes are filtered in it."""
        members = range(len(self.after) // 2) if self.samples is None else self.samples
        if self.filters:
            return {*members}
        return {i for move in self.moves if isinstance(move, Inside) for i in move.filtered()}


def _places(samples: Sequence[int], inner: Sequence[int] | None) -> Sequence[int]:
    return samples if inner is None else [samples[i] for i in inner]


class Moves(NamedTuple):
    """What boxes and points of a list of images follow, and height and width of the results."""

    moves: Sequence[Move | Inside]
    after: Sequence[int]

    def then(self, others: Moves) -> Moves:
        """These, and then others."""
        return Moves([*self.moves, *others.moves], others.after)

    def of_some(self, samples: Sequence[int], sides: Sequence[int]) -> Moves:
        """The same as those of some images of a list of these sizes."""
        moves = [move.of_some(samples, sides) for move in self.moves]
        return Moves(moves, with_sides(sides, samples, self.after))

    def inside(self, settings: LabelSettings | None) -> Moves:
        """The same in a container that is a child, with its settings."""
        if settings is None:
            settings = LabelSettings()
        inside = Inside(self.moves, self.after, settings)
        return Moves([inside], self.after) if inside.filtered() else self

    def stages(self, device: torch.device) -> tuple[list[Stage], SizeOfEach]:
        """The same as stages of all images, and the sizes of results."""
        moves = self.moves
        stages: list[Stage] = []
        if any(isinstance(move, Inside) for move in moves):
            stages += _Rounds(len(self.after) // 2, device).of(moves)
        else:
            stages += [move.stage(device) for move in moves]  # type: ignore[union-attr]  # by the line above
        return stages, SizeOfEach(self.after, device)


class _Rounds:
    """Moves of images whose boxes are filtered at different times, as rounds.

    Each round has the moves of each image between two of its own filters, which labels follow together: between others an image
    by itself has one.
    """

    def __init__(self, count: int, device: torch.device) -> None:
        self._device, self._round = device, [0] * count  # of each image
        self._moves: dict[tuple[int, bool], list[Move]] = {}  # of each round those that clip each, and others
        self._filters: dict[int, list[Round]] = {}

    def of(self, moves: Sequence[Move | Inside]) -> list[Stage]:
        """The rounds of moves."""
        self._add(moves, False)
        rounds: list[Stage] = []
        for number in range(max(self._round) + 1):
            for clips in (False, True):
                own = self._moves.get((number, clips))
                if own is not None:
                    rounds.append(self._moved(own, clips))
            rounds += self._filters.get(number, [])
        return rounds

    def _moved(self, moves: Sequence[Move], clips: bool) -> Round:
        after = moves[0].after
        for move in moves[1:]:
            assert move.samples is not None
            after = with_sides(after, move.samples, [n for i in move.samples for n in move.after[2 * i : 2 * i + 2]])
        stages = [move.stage(self._device) for move in moves]
        return Round(stages, LabelSettings(clips), SizeOfEach(after, self._device))

    def _add(self, moves: Sequence[Move | Inside], clips: bool) -> None:
        for move in moves:
            if isinstance(move, Inside):
                filtered = sorted(move.filtered())
                self._end(filtered)
                self._add(move.moves, clips or move.settings.clips_each)
                for number, images in self._by_round(filtered if move.filters else []):
                    settings = LabelSettings(False, move.settings.box_filter)
                    rule = Round([], settings, SizeOfEach(move.after, self._device), images)
                    self._filters.setdefault(number, []).append(rule)
                self._end(filtered)
                continue
            samples = range(len(self._round)) if move.samples is None else move.samples
            row_of = {sample: row for row, sample in enumerate(samples)}
            rounds = self._by_round(samples)
            if len(rounds) > 1:
                links = [link if isinstance(link, Tensor) else link.shared() for link in move.links]
                move = move._replace(links=links)
            for number, images in rounds:
                is_whole = len(images) == len(samples)
                own = move._replace(samples=images) if is_whole else move.of_rows([row_of[i] for i in images])
                self._moves.setdefault((number, clips), []).append(own)

    def _by_round(self, samples: Sequence[int]) -> list[tuple[int, list[int]]]:
        groups: dict[int, list[int]] = {}
        for sample in samples:
            groups.setdefault(self._round[sample], []).append(sample)
        return list(groups.items())

    def _end(self, samples: Sequence[int]) -> None:
        for sample in samples:
            self._round[sample] += 1


def moves_of_run(run: Any) -> Moves | None:
    """Those of a run on a list; None where labels do not follow the matrices of its warps and its maps."""
    moves: list[Move | Inside] = []
    sides = run.sides
    for step in run.label_steps:
        crops: Tensor | None = None
        for number in step.numbers:
            module = run.modules[number]
            is_map = module.moves_by_map and module._knows_maps_of_lists
            if not (is_map or module.keeps_positions or (step.links and module._warps_points)):
                return None
            if module.removes_boxes:
                if not all(n == number or _permutes_pixels(run.modules[n]) for n in step.numbers):
                    return None  # a box may leave the image in another one
                chosen = run.execution(number).chosen
                count = len(step.before) // 2
                crops = torch.ones(count, dtype=torch.bool, device=run.device) if chosen is None else chosen
        moves.append(Move(step.links, step.before, step.after, None, crops))
        sides = step.after
    return Moves(moves, sides)


def _permutes_pixels(module: Any) -> bool:
    contribution = module._contribution((1, 3, *SIZES[0]), module.flags)
    return contribution is not None and contribution.motion is not None and contribution.motion.permutes_pixels


def joined_moves(sides: Sequence[int], parts: Iterable[tuple[Sequence[int], Moves | None]]) -> Moves | None:
    """The moves of images of these sizes of which each part has moved some, one after the other."""
    moves: list[Move | Inside] = []
    for samples, own in parts:
        if own is None:
            return None
        if 2 * len(samples) == len(sides):
            moves, sides = [*moves, *own.moves], own.after
            continue
        placed = own.of_some(samples, sides)
        moves, sides = [*moves, *placed.moves], placed.after
    return Moves(moves, sides)
