"""The labels of one call: they follow its stages, and boxes that leave the image take what belongs to them along."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import Any

from torch import Tensor

from kvision.augmentation import labels
from kvision.augmentation.engine.label_moves import LabelMoves, move_boxes_back
from kvision.augmentation.engine.label_settings import LabelSettings, MaskReading
from kvision.augmentation.engine.stages import Applied, Chain, Nested, Stage
from kvision.augmentation.labels import BOX_FORMATS
from kvision.augmentation.samples import inverse_at
from kvision.constants import DataKey
from kvision.core.exceptions import ShapeError

_OP = "AugmentationSequential"
Shape = tuple[int, ...]
Size = Sequence[Any]  # height and width, of a list of images (B, 1) of each
Kept = dict[int, Any]  # which boxes stay, for each input of boxes: bool (B, N), or a list of (N,)


class LabelRecord:
    """How the labels of one call move.

    Args:
        settings: those of the container.
        shape: of the images of the call, (B, C, H, W); None where it is not known.
        size: of its results.
        masks: how many masks and boxes there are of all images, where this is about some of a list; default: of its own.
    """

    def __init__(
        self,
        settings: LabelSettings,
        shape: Shape | None,
        size: Size,
        masks: dict[int, labels.MaskCounts] | None = None,
    ) -> None:
        self.settings, self.shape, self.size, self._masks = settings, shape, size, masks
        self.kept_boxes: list[Any] = []
        # Of each input of key points and each part of the call that moved them: the moved ones, their moves, and which of them
        # are visible if the moves have told.
        self._points: dict[int, list[tuple[Any, LabelMoves, Tensor | None]]] = {}
        self._fractions: dict[int, Tensor | None] = {}  # of each input of boxes, the visible parts of their areas
        self._moves: dict[tuple[Any, ...], LabelMoves] = {}

    def move(
        self, keys: Sequence[DataKey], values: Sequence[Any], stages: Chain, moved_masks_at: Sequence[int] = ()
    ) -> list[Any]:
        """What belongs to images, after all stages; the images as they are, and masks that others moved."""
        moved, has_others = list(values), False
        for i, key in enumerate(keys):
            if key == DataKey.MASK:
                if i in moved_masks_at:
                    continue
                moved[i] = moved_masks(moved[i], stages, self.settings.masks, self.shape)
            elif key != DataKey.INPUT:
                has_others = True
        if not has_others:
            return moved
        if self._masks is None:
            self._masks = labels.count_masks(keys, values)
        kept = self._move_through(keys, moved, stages, self.size, self.settings)
        for i, key in enumerate(keys):
            if key == DataKey.KEYPOINTS and not self._points.get(i):
                moved[i] = self._move_points(i, moved[i], Chain(), self.size, self.settings)
            if key == DataKey.KEYPOINTS and labels.has_visibility(moved[i], self._numbers_of_points):
                moved[i] = labels.hide_points(moved[i], self._visible(i), self._numbers_of_points)
        if self.settings.may_remove_boxes:
            for i, key in enumerate(keys):
                if key in BOX_FORMATS and i not in kept:
                    kept[i] = labels.all_kept(moved[i], BOX_FORMATS[key])
        self.kept_boxes = [kept[i] for i in sorted(kept)]
        for moves in self._moves.values():
            moves.forget_map()
        return moved

    def visible_points(self) -> list[Any]:
        """Which points of each input are in the results, and were in all before."""
        return [self._visible(i) for i in sorted(self._points)]

    # --- through the stages ---

    def _move_through(
        self,
        keys: Sequence[DataKey],
        values: list[Any],
        stages: Chain,
        size: Size,
        settings: LabelSettings,
        samples: Sequence[int] | None = None,
    ) -> Kept:
        """Move all but masks through the stages of a container, and filter them as it says; gives the boxes that stay.

        Those of some `samples` alone, if only these have been in the container.
        """
        kept: Kept = {}
        has_boxes = any(key in BOX_FORMATS for key in keys)
        for part, after in _parts(stages, has_boxes):
            part_size = part.result_size() or after.source_size() or size
            if isinstance(part, Chain) and not isinstance(part, Nested):
                if removed := self._kept_by_centers(keys, values, part):
                    self._leave(keys, values, removed)
                    kept = labels.kept_by_both(kept, removed)
                for i, key in enumerate(keys):
                    values[i] = self._moved(i, key, values[i], part, part_size, settings)
            elif isinstance(part, Applied):
                self._mix(keys, values, part)
            else:
                own = part.labels or LabelSettings()
                own = own._replace(clips_each=own.clips_each or settings.clips_each)
                inner = self._move_through(keys, values, part, part_size, own, part.members())
                kept = labels.kept_by_both(kept, inner)
        was_kept = bool(kept)
        if has_boxes and not settings.box_filter.does_nothing:
            kept = labels.kept_by_both(kept, self._filter(keys, values, size, settings.box_filter, samples))
        for i, of_input in kept.items() if was_kept else ():  # zeros have moved since
            values[i] = labels.clear_boxes(values[i], of_input)
        return kept

    def _mix(self, keys: Sequence[DataKey], values: list[Any], stage: Applied) -> None:
        """What belongs to images whose samples are mixed."""
        module: Any = stage.module
        boxes = next((v.shape[1] for k, v in zip(keys, values) if k in BOX_FORMATS and isinstance(v, Tensor)), None)
        for i, key in enumerate(keys):
            if key not in (DataKey.INPUT, DataKey.MASK):
                values[i] = module._mixed_labels(key, values[i], stage.execution, boxes)
                self._points.pop(i, None)
                self._fractions.pop(i, None)

    def _filter(
        self,
        keys: Sequence[DataKey],
        values: list[Any],
        size: Size,
        rule: labels.BoxFilter,
        samples: Sequence[int] | None,
    ) -> Kept:
        """Leave the boxes that a rule keeps, with their class labels and masks; all of others than some `samples`."""
        kept: Kept = {}
        for i, key in enumerate(keys):
            if key in BOX_FORMATS:
                fraction = self._fractions.pop(i, None)
                mode = BOX_FORMATS[key]
                values[i], kept[i] = labels.filter_boxes(values[i], mode, size, rule, fraction, samples)
                if samples is not None and fraction is not None:
                    self._fractions[i] = labels.leave_fractions(fraction, kept[i], samples)
        self._leave_of_boxes(keys, values, kept)
        return kept

    def _leave_of_boxes(self, keys: Sequence[DataKey], values: list[Any], kept: Kept) -> None:
        """Leave the class labels and masks of boxes that are kept."""
        for i, key in enumerate(keys):
            if key in (DataKey.CLASS, DataKey.MASK):
                at = labels.boxes_of(i, list(kept))
                assert at is not None and self._masks is not None
                if key == DataKey.CLASS:
                    values[i] = labels.filter_labels(values[i], kept[at])
                else:
                    values[i] = labels.filter_masks(values[i], kept[at], self._masks.get(i))

    def _leave(self, keys: Sequence[DataKey], values: list[Any], kept: Kept) -> None:
        """Leave the boxes that are kept, with their class labels and masks."""
        for i, of_input in kept.items():
            values[i] = labels.leave_boxes(values[i], of_input)
            fraction = self._fractions.get(i)
            if fraction is not None:
                self._fractions[i] = labels.leave_fractions(fraction, of_input)
        self._leave_of_boxes(keys, values, kept)

    def _kept_by_centers(self, keys: Sequence[DataKey], values: list[Any], stages: Chain) -> Kept:
        """The boxes whose centers are in the results of those of the stages that remove others; nothing where none does."""
        kept: Kept = {}
        for i, key in enumerate(keys) if stages.removes_boxes else ():
            own = labels.kept_boxes(values[i], BOX_FORMATS[key], stages.keeps_centers) if key in BOX_FORMATS else None
            if own is not None:
                kept[i] = own
        for i, key in enumerate(keys) if kept else ():
            if key in BOX_FORMATS and i not in kept:  # none, to which classes may belong
                kept[i] = labels.all_kept(values[i], BOX_FORMATS[key])
        return kept

    def _moved(self, i: int, key: DataKey, value: Any, stages: Chain, size: Size, settings: LabelSettings) -> Any:
        if key == DataKey.KEYPOINTS:
            return self._move_points(i, value, stages, size, settings)
        if key not in BOX_FORMATS:
            return value
        if self._numbers_of_points == 3:
            raise NotImplementedError(f"{_OP}: boxes of volumes cannot be moved; masks and key points can")
        self._check_batch(key.name.lower(), value, 4 if key == DataKey.BBOX else 3)
        moves = self._moves_of(stages, size, settings)
        moved, fraction = labels.move_boxes(value, BOX_FORMATS[key], moves.move_boxes)
        before = self._fractions.get(i)
        if fraction is None or before is None:
            self._fractions[i] = before if fraction is None else fraction
        else:
            self._fractions[i] = before * fraction
        return moved

    def _move_points(self, i: int, points: Any, stages: Chain, size: Size, settings: LabelSettings) -> Any:
        self._check_batch("keypoints", points, 3)
        moves, visible = self._moves_of(stages, size, settings), None

        def move(tensor: Tensor) -> Tensor:
            nonlocal visible
            moved, visible = moves.move_points(tensor)
            return moved

        moved = labels.move_points(points, move, self._numbers_of_points)
        self._points.setdefault(i, []).append((moved, moves, visible))
        return moved

    def _moves_of(self, stages: Chain, size: Size, settings: LabelSettings) -> LabelMoves:
        key = (settings.clips_each, *(id(stage) for stage in stages.stages))
        if key not in self._moves:
            self._moves[key] = LabelMoves(stages, size, settings.clips_each)
        return self._moves[key]

    @property
    def _numbers_of_points(self) -> int:
        """How many numbers a point has: 2 in images, 3 in volumes."""
        return 2 if self.shape is None else len(self.shape) - 2

    def _check_batch(self, name: str, value: Any, axes: int) -> None:
        """Raise unless labels are those of as many images as the call has."""
        if self.shape is None or not isinstance(value, (Tensor, list, tuple)):
            return
        count = len(value) if not isinstance(value, Tensor) or value.dim() == axes else 1
        if count != self.shape[0] and (isinstance(value, Tensor) or count):
            raise ShapeError(f"{_OP}: expected {name} of {self.shape[0]} images, got those of {count}")

    def _visible(self, i: int) -> Any:
        """Which points of an input are in the results, and were in all before."""
        numbers, parts = self._numbers_of_points, self._points[i]
        each = [(p, moves.are_visible if known is None else _constant(known)) for p, moves, known in parts]
        points, moves, _ = parts[-1]
        if not moves.concerns_all:  # others have been inside behind what moved them last
            each.append((points, functools.partial(labels.is_within, size=self.size)))
        visible, *others = [labels.visible_points(points, are_visible, numbers) for points, are_visible in each]
        for own in others:
            if isinstance(own, Tensor):
                visible = visible & own
            else:
                visible = type(own)(a & b for a, b in zip(visible, own))
        return visible


def moved_masks(masks: Any, stages: Chain, reading: MaskReading, images: Shape | None) -> Any:
    """Masks of images of a shape after stages: a tensor, or a list of those of the instances of each image."""
    first: Any = stages.stages[0] if stages.stages else None
    if images is not None and hasattr(first, "move_mask_list"):  # of a list of images
        masks, images = first.move_mask_list(_OP, masks, reading), (*images[:2], *first.size)
        stages = Chain(stages.stages[1:])
    return labels.move_masks(masks, lambda batch: stages.move_masks(batch, reading), images)


def labels_back(key: DataKey, value: Any, stages: Chain, size: Size, images: Shape) -> Any:
    """Labels of results of a size, moved back to images of a shape."""
    if key == DataKey.MASK:
        return _masks_back(value, stages, size, images[0])
    if key == DataKey.KEYPOINTS:
        return labels.move_points(value, stages.move_points_back, len(images) - 2)
    if key in BOX_FORMATS:
        return labels.move_boxes(value, BOX_FORMATS[key], functools.partial(move_boxes_back, stages))[0]
    return value


def _masks_back(masks: Any, stages: Chain, size: Sequence[int], batch: int) -> Any:
    """Masks of images, or a list of (N, h, w), moved back from results of a size, or of that of predictions."""
    if isinstance(masks, (list, tuple)):
        labels.check_tensors("the masks of an image", masks)
        if not masks:
            return masks
        padded, counts = labels.pad(masks)  # as many instances for each image
        return type(masks)(row[:n] for row, n in zip(_masks_back(padded, stages, size, batch), counts))
    labels.check_tensors("mask", [masks])
    images = (batch, 1, *masks.shape[-len(size) :])
    return labels.move_masks(masks, lambda x: inverse_at(x, size, stages.move_masks_back), images)


def _parts(stages: Chain, has_boxes: bool) -> Iterator[tuple[Any, Chain]]:
    """Stages that labels follow together, as a chain, or one that concerns all of them, each with the stages after it."""
    together: list[Stage] = []
    for i, stage in enumerate(stages.stages):
        if not stage.concerns_all(has_boxes):
            together.append(stage)
            continue
        if together:
            yield Chain(together), Chain(stages.stages[i:])
            together = []
        yield stage, Chain(stages.stages[i + 1 :])
    if together:
        yield Chain(together), Chain()


def _constant(value: Tensor) -> Any:
    return lambda _: value
