"""The labels of one call as draws read them: boxes and masks as they are when the images reach an augmentation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision.augmentation import labels
from kvision.augmentation.engine.label_record import LabelRecord, moved_masks
from kvision.augmentation.engine.label_settings import LabelSettings
from kvision.augmentation.engine.stages import Chain, Nested, Stage
from kvision.augmentation.labels import BOX_FORMATS, BoxFilter
from kvision.augmentation.sample_rows import index_of
from kvision.constants import DataKey
from kvision.geometry.transform.lists.arguments import largest_shape

Size = tuple[int, ...]


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
    moves: Any = None  # of a list of images what these have been through, as Moves

    @classmethod
    def of(cls, keys: Sequence[DataKey], values: Sequence[Any], settings: LabelSettings, images: Any) -> CallLabels:
        """Those of a call on images, a batch or a list."""
        is_list = isinstance(images, list)
        return cls(keys, values, settings, largest_shape(images) if is_list else tuple(images.shape), is_list)

    def after(self, stages: Sequence[Stage]) -> CallLabels:
        """The labels after further stages."""
        return self._replace(stages=[*self.stages, *stages]) if stages else self

    def moved(self, moves: Any) -> CallLabels:
        """The labels of a list of images after further Moves of those that they are about."""
        return self._replace(moves=moves if self.moves is None else self.moves.then(moves))

    def inside(self, settings: LabelSettings | None) -> CallLabels:
        """The labels in a container that is the next child, with its settings."""
        own = None if settings is None else _of_steps(settings)
        return self.of_samples(lambda stages: Nested(stages, own), None)

    def of_samples(self, wrap: Callable[[list[Stage]], Stage], rows: Sequence[int] | None) -> CallLabels:
        """The labels of some samples, to which stages happen that are one stage of the whole batch by `wrap`."""
        return self._replace(stages=(), outer=self, wrap=wrap, rows=rows)

    def some(self, rows: Sequence[int]) -> CallLabels:
        """The labels of some of these samples, which have been through the same stages."""
        return self._replace(rows=rows if self.rows is None else [self.rows[i] for i in rows])

    def read_inside(self, settings: LabelSettings | None) -> CallLabels:
        """The labels of a list in a container that is the next child, which may read masks in its own way."""
        return self._replace(settings=self.settings._replace(masks=self.settings.masks.inside(settings)))

    def of_image(self, sample: int, image: Tensor) -> CallLabels:
        """The first masks of an image (C, H, W) of a list by itself, as of a batch of one, if there are any."""
        masks, x = self.masks_of_samples(), image[None]
        known = [] if masks is None else [(DataKey.MASK, [masks[0][sample]])]
        keys, values = zip((DataKey.INPUT, x), *known)
        return CallLabels.of(keys, values, self.settings, x)

    def read(self, kind: str, shape: Size, frames: int = 1) -> Any:
        """What a draw reads: `boxes` or `masks` of the images, now of a shape; those of `frames` neighbors together."""
        return self.boxes(shape, frames) if kind == "boxes" else self.masks_of_samples(frames)

    def boxes(self, shape: Size, frames: int = 1) -> Tensor | None:
        """(B, N, 4), see `labels.box_edges`; None if the call has no boxes."""
        known = [(key, value) for key, value in zip(self.keys, self.values) if key in BOX_FORMATS]
        if not known:
            return None
        stages, size, images = self._chain(), shape[2:], self.images
        if self.moves is not None:  # which are those of the selected images
            known = [(key, self._selected(value)) for key, value in known]
            stages, size = self.moves.stages(self._device)
            images = (shape[0], *images[1:])
        moved = [value for _, value in known]
        if stages:
            record = LabelRecord(_of_steps(self.settings), images, size)
            moved = record.move([key for key, _ in known], moved, Chain(stages))
        edges = [labels.box_edges(now, BOX_FORMATS[key], images[0], value) for (key, value), now in zip(known, moved)]
        boxes = torch.cat([part.to(edges[0]) for part in edges], 1)
        boxes = boxes if self.moves is not None else self._selected(boxes)
        return boxes.reshape(shape[0] // frames, frames * boxes.shape[1], 4) if frames > 1 else boxes

    def first_masks(self) -> Any:
        """Those of the first input: in the form in which they were given, or those of some samples; None without any."""
        if self.is_list and not self._chain():
            masks = self.masks_of_samples()
        else:
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
            own = [self._selected(value) for key, value in zip(self.keys, self.values) if key == DataKey.MASK]
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
