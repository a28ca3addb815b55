"""The labels of one call as draws read them: boxes and masks as they are when the images reach an augmentation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision.augmentation import labels
from kvision.augmentation.engine.label_record import LabelRecord, moved_masks
from kvision.augmentation.engine.label_settings import LabelSettings
from kvision.augmentation.engine.parts import of_rows
from kvision.augmentation.engine.stages import Chain, Nested, Stage
from kvision.augmentation.labels import BOX_FORMATS, BoxFilter
from kvision.augmentation.sample_rows import index_of
from kvision.constants import DataKey
from kvision.geometry.transform.lists.arguments import largest_shape

_OP = "AugmentationSequential"
Size = tuple[int, ...]


class Trail(NamedTuple):
    """What images of a list, all of a call or some, went through before a step.

    Attributes:
        moves: gives, for Moves that these go through then, those of all images of the call; None where boxes follow no Moves.
        masks: gives the masks of these images, of an input by its number.
        of_image: gives the labels of one of these images by itself, by its number.
    """

    moves: Callable[[Any], Any]
    masks: Callable[[int], Sequence[Tensor]]
    of_image: Callable[[int], CallLabels]


class CallLabels(NamedTuple):
    """The labels of a call with the stages that its images have been through."""

    keys: Sequence[DataKey]  # what the values are
    values: Sequence[Any]  # images and labels as the call has them
    settings: LabelSettings  # those of the container
    images: Size  # the shape (B, C, H, W) of the images; of a list of images the largest one
    is_list: bool = False  # the call has a list of images
    stages: Sequence[Stage] = ()  # what has been done to the images in the container
    outer: CallLabels | None = None  # in a part of the call, such as a container that is a child, the labels before it
    wrap: Callable[[list[Stage]], Stage] | None = None  # gives what outer labels follow, of the stages of the part
    rows: Sequence[int] | None = None  # the samples of the outer batch that the part is about; None for all
    trail: Trail | None = None  # of the images of a list; None if they are those of the call
    moves: Any = None  # what all images of a list have been through, for boxes that are read now

    @classmethod
    def of(cls, keys: Sequence[DataKey], values: Sequence[Any], settings: LabelSettings, images: Any) -> CallLabels:
        """Those of a call on images, a batch or a list."""
        is_list = isinstance(images, list)
        return cls(keys, values, settings, largest_shape(images) if is_list else tuple(images.shape), is_list)

    def after(self, stages: Sequence[Stage]) -> CallLabels:
        """The labels after further stages."""
        return self._replace(stages=[*self.stages, *stages]) if stages else self

    def inside(self, settings: LabelSettings | None) -> CallLabels:
        """The labels in a container that is the next child, with its settings."""
        own = None if settings is None else _of_steps(settings)
        return self.of_samples(lambda stages: Nested(stages, own), None)

    def of_samples(self, wrap: Callable[[list[Stage]], Stage], rows: Sequence[int] | None) -> CallLabels:
        """The labels of some samples, to which stages happen that are one stage of the whole batch by `wrap`."""
        return self._replace(stages=(), outer=self, wrap=wrap, rows=rows)

    # --- of the images of a list ---

    def through(self, parts: Any) -> CallLabels:
        """The labels behind what the Parts of a call say, which have an image each."""

        def moves(further: Any) -> Any:
            own = parts.moves()
            return None if own is None else self._moves_of_call(own.then(further))

        def masks(number: int) -> Sequence[Tensor]:
            before, reading = self._masks_of_list(number), self.settings.masks
            moved: Sequence[Tensor] | None = parts.moved_masks(before, reading)
            if moved is None:
                moved = [moved_masks([x], call.stages, reading, None)[0] for x, call in zip(before, parts.calls)]
            return moved

        return self._replace(
            trail=Trail(moves, cache(masks), lambda i: self.of_image(i).after(parts.calls[i].stages.stages))
        )

    def some(self, rows: Sequence[int], sides: Sequence[int]) -> CallLabels:
        """The labels of some of these images, which have height and width of each."""

        def masks(number: int) -> Sequence[Tensor]:
            own = self._masks_of_list(number)
            return [own[i] for i in rows]

        return self._replace(
            rows=rows if self.rows is None else [self.rows[i] for i in rows],
            trail=Trail(
                lambda further: self._moves_of_call(further.of_some(rows, sides)),
                cache(masks),
                lambda i: self.of_image(rows[i]),
            ),
        )

    def inside_list(self, settings: LabelSettings | None) -> CallLabels:
        """The labels in a container that is the next child, which may read masks in its own way."""
        own = None if settings is None else _of_steps(settings)
        return self._replace(
            settings=self.settings._replace(masks=self.settings.masks.inside(settings)),
            trail=Trail(
                lambda further: self._moves_of_call(further.inside(own)),
                self._masks_of_list,
                lambda i: self.of_image(i).inside(settings),
            ),
        )

    def moved(self, moves: Any) -> CallLabels:
        """The labels whose boxes are read after Moves of these images; `moves` is None where boxes follow no Moves."""
        return self._replace(moves=self._moves_of_call(moves))

    def of_image(self, number: int) -> CallLabels:
        """The boxes and masks of an image by itself, as of a batch of one."""
        if self.trail is not None:
            return self.trail.of_image(number)
        x, count = self.values[self.keys.index(DataKey.INPUT)][number][None], self.images[0]
        known = [
            (key, value) for key, value in zip(self.keys, self.values) if key == DataKey.MASK or key in BOX_FORMATS
        ]
        own = [(key, of_rows(_OP, key, value, [number], count)) for key, value in known]
        keys, values = zip((DataKey.INPUT, x), *own)
        return CallLabels.of(keys, values, self.settings, x)

    def _moves_of_call(self, moves: Any) -> Any:
        return moves if self.trail is None else self.trail.moves(moves)

    def _masks_of_list(self, number: int) -> Sequence[Tensor]:
        """The masks of these images, of an input by its number."""
        masks: Sequence[Tensor] = self.values[number]
        return masks if self.trail is None else self.trail.masks(number)

    # --- what is read ---

    def read(self, kind: str, shape: Size, frames: int = 1) -> Any:
        """What a draw reads: `boxes` or `masks` of the images, now of a shape; those of `frames` neighbors together."""
        return self.boxes(shape, frames) if kind == "boxes" else self.masks_of_samples(frames)

    def boxes(self, shape: Size, frames: int = 1) -> Tensor | None:
        """(B, N, 4), see `labels.box_edges`; None if the call has no boxes."""
        known = [(key, value) for key, value in zip(self.keys, self.values) if key in BOX_FORMATS]
        if not known:
            return None
        stages, size = self._chain(), shape[2:]
        if self.moves is not None:
            stages, size = self.moves.stages(self._device)
        moved = [value for _, value in known]
        if stages:
            record = LabelRecord(_of_steps(self.settings), self.images, size)
            moved = record.move([key for key, _ in known], moved, Chain(stages))
        edges = [
            labels.box_edges(now, BOX_FORMATS[key], self.images[0], value) for (key, value), now in zip(known, moved)
        ]
        boxes = self._selected(torch.cat([part.to(edges[0]) for part in edges], 1))
        return boxes.reshape(shape[0] // frames, frames * boxes.shape[1], 4) if frames > 1 else boxes

    def first_masks(self) -> Any:
        """Those of the first input: in the form in which they were given, or those of some samples; None without any."""
        if self.is_list and not self._chain():
            return self._masks_of_list(self.keys.index(DataKey.MASK)) if DataKey.MASK in self.keys else None
        masks = self.masks()
        if self._is_of_some:
            masks = [self._selected(x if isinstance(x, (list, tuple)) else labels.masks_as_batch(x)) for x in masks]
        return masks[0] if masks else None

    @property
    def _device(self) -> torch.device:
        """That of the images of a list."""
        device: torch.device = self.values[self.keys.index(DataKey.INPUT)][0].device
        return device

    @property
    def _is_of_some(self) -> bool:
        return self.rows is not None or (self.outer is not None and self.outer._is_of_some)

    def masks(self) -> list[Any]:
        """Those of all inputs, in the form in which they were given."""
        stages, reading = Chain(self._chain()), self.settings.masks
        masks = [value for key, value in zip(self.keys, self.values) if key == DataKey.MASK]
        return [moved_masks(value, stages, reading, self.images) for value in masks]

    def masks_of_samples(self, frames: int = 1) -> list[Any] | None:
        """Those of all inputs (B, C, H, W), of a list of images a list of (N, H, W); None if the call has no masks."""
        if self.is_list and not self._chain():
            own = [self._masks_of_list(number) for number, key in enumerate(self.keys) if key == DataKey.MASK]
            return own or None
        masks = self.masks()
        if not masks:
            return None
        batches = [self._selected(labels.masks_as_batch(value)) for value in masks]
        return [x.unflatten(0, (-1, frames)).flatten(1, 2) for x in batches] if frames > 1 else batches

    def _selected(self, x: Any) -> Any:
        """Of labels (B, ...) of the call, or a list of those of each image, those of the samples that this is about."""
        x = x if self.outer is None else self.outer._selected(x)
        if self.rows is None:
            return x
        return x[index_of(self.rows, x)] if isinstance(x, Tensor) else [x[i] for i in self.rows]

    def _chain(self, inner: Sequence[Stage] = ()) -> list[Stage]:
        """All stages from the images of the call, and then inner ones."""
        own = [*self.stages, *inner]
        if self.outer is None or self.wrap is None:
            return own
        return self.outer._chain([self.wrap(own)])


def _of_steps(settings: LabelSettings) -> LabelSettings:
    """Settings without what is done to boxes at the end of a container."""
    return settings._replace(box_filter=BoxFilter(settings.clips_each))
