"""What labels and the inverse follow on a list of images, and where one launch makes it a batch."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from kvision._constants import on_device
from kvision.augmentation import labels
from kvision.augmentation.engine.label_settings import LabelSettings, MaskReading
from kvision.augmentation.engine.stages import INSIDE, ByMatrix, Nested, Stage, Warp
from kvision.augmentation.labels import is_within
from kvision.augmentation.maps import exact, exact_each, warp_each, warp_to_sizes
from kvision.augmentation.preimages.result_map_list import NodeReading, displaced
from kvision.core.exceptions import ShapeError


class SizeOfEach(Sequence[Tensor]):
    """Heights and widths (B, 1) of images, on their device when they are asked for."""

    def __init__(self, sides: Sequence[int], device: torch.device) -> None:
        self.sides, self._device = sides, device
        self._of_axes: Tensor | None = None

    @staticmethod
    def sides_of(size: Any, count: int) -> Sequence[int]:
        """Height and width of each of `count` images of a size."""
        return size.sides if isinstance(size, SizeOfEach) else [*size] * count

    def __len__(self) -> int:
        return 2

    def __getitem__(self, axis: Any) -> Any:
        if self._of_axes is None:
            of_axes = torch.tensor(self.sides, dtype=torch.float32, device="cpu").view(-1, 2).T[..., None]
            self._of_axes = on_device(of_axes, self._device)
        return self._of_axes[axis]

    def __iter__(self) -> Iterator[Tensor]:
        return iter((self[0], self[1]))  # that of sequences ends at an error, which graphs do not catch


def with_sides(sides: Sequence[int], samples: Sequence[int], own: Sequence[int]) -> list[int]:
    """Height and width of each image with those of some replaced."""
    every = list(sides)
    for place, i in enumerate(samples):
        every[2 * i : 2 * i + 2] = own[2 * place : 2 * place + 2]
    return every


@dataclass
class OnList(Stage):
    """A step on images of a list, all or some, which had a size each before it, that moves no pixels."""

    before: SizeOfEach
    after: SizeOfEach
    samples: Sequence[int] | None

    def members(self) -> Sequence[int] | None:
        return self.samples

    def source_size(self) -> Any:
        return self.before

    def result_size(self) -> SizeOfEach:
        return self.after

    def read(self, like: Tensor, bounded: Sequence[bool]) -> NodeReading | None:
        """How it reads nodes, in the type and on the device of `like`; None where it moves nothing."""
        return None


@dataclass
class WarpOfList(ByMatrix, OnList):
    """Images of a list moved by matrices."""

    def read(self, like: Tensor, bounded: Sequence[bool]) -> NodeReading:
        back = torch.linalg.inv_ex(self.matrix).inverse.to(like)
        return NodeReading(back, self.before.sides, [False] * len(bounded), bounded)


@dataclass
class MapOfList(OnList):
    """Images of a list, all or some of them, moved by a map each."""

    make: Callable[[Tensor], Tensor]  # gives the maps of its samples, like a tensor
    chosen: Tensor | None  # (B,) bool, those that are displaced; None for all
    _maps: Tensor | None = None

    @property
    def keeps_lines(self) -> bool:
        return False

    @property
    def moved(self) -> list[bool]:
        """Which images have a map."""
        return [self.samples is None or i in self.samples for i in range(len(self.before.sides) // 2)]

    def maps(self) -> list[Tensor | None]:
        return [self.chosen]

    def move_points_back(self, points: Tensor) -> Tensor:
        return displaced(points, self._known(points), self.before.sides, self.moved)

    def read(self, like: Tensor, bounded: Sequence[bool]) -> NodeReading:
        return NodeReading(self._known(like), self.before.sides, self.moved, bounded)

    def forget(self) -> None:
        self._maps = None

    def _known(self, like: Tensor) -> Tensor:
        if self._maps is None or self._maps.device != like.device or self._maps.dtype != like.dtype:
            self._maps = self.make(like)
        return self._maps


@dataclass
class CropOfList(WarpOfList):
    """Images of a list cropped, some so that boxes whose centers are outside are removed."""

    crops: Tensor  # (B,) bool

    @property
    def removes_boxes(self) -> bool:
        return True

    def keeps_centers(self, centers: Tensor) -> Tensor:
        inside = is_within(self.move_points(centers), self.after, INSIDE)
        return inside | ~self.crops.to(inside.device)[:, None]


class Round(Nested):
    """Stages that some images of a list have between boxes being filtered, or such a filter."""

    def __init__(
        self, stages: Sequence[Stage], labels: LabelSettings, after: SizeOfEach, samples: Sequence[int] | None = None
    ) -> None:
        super().__init__(stages, labels)
        self.after, self.samples = after, samples

    def concerns_all(self, has_boxes: bool) -> bool:
        return True

    def result_size(self) -> SizeOfEach:
        return self.after

    def members(self) -> Sequence[int] | None:
        return self.samples


@dataclass
class ListWarp(Warp):
    """The warp by which a list becomes a batch."""

    source: Any  # has `sides`, height and width of each image

    @property
    def sides(self) -> list[int]:
        return list(self.source.sides)

    def source_size(self) -> Any:
        return None  # of all images

    def move_masks(self, masks: Any, reading: MaskReading) -> Any:
        """Masks (1, H, W) of each image as a batch."""
        resampling = self.resampling.for_labels(reading.mode, reading.fill)
        return warp_each(exact_each(masks), self.matrix, list(self.size), resampling)[0].to(masks[0].dtype)

    def move_masks_back(self, masks: Tensor) -> Any:
        resampling = self.resampling.for_inverse("nearest")
        back = warp_to_sizes(list(exact(masks)), self.matrix, self.sides, resampling, False)
        return [m.to(masks.dtype) for m in back]

    def invert(self, x: Tensor) -> Any:
        return warp_to_sizes(list(x), self.matrix, self.sides, self.resampling.for_inverse(), False)

    def move_mask_list(self, op: str, masks: Any, reading: MaskReading) -> list[Tensor]:
        """Masks (N, H, W) or (H, W) of each image, moved: (N, h, w) of each."""
        sides = self.sides
        count = len(sides) // 2
        if not isinstance(masks, (list, tuple)) or len(masks) != count:
            got = len(masks) if isinstance(masks, (list, tuple)) else type(masks).__name__
            raise ShapeError(f"{op}: expected mask to be a list of {count}, one of each image, got {got}")
        labels.check_tensors("the masks of an image", masks)
        planes, counts = [], []
        for b, mask in enumerate(masks):
            size = tuple(sides[2 * b : 2 * b + 2])
            if mask.dim() not in (2, 3) or tuple(mask.shape[-2:]) != size:
                raise ShapeError(
                    f"{op}: expected mask[{b}] of shape (N, {size[0]}, {size[1]}), got {tuple(mask.shape)}"
                )
            own = mask if mask.dim() == 3 else mask[None]
            planes += list(own[:, None])
            counts.append(own.shape[0])
        if not planes:
            return [mask.new_empty(0, *self.size) for mask in masks]
        samples = torch.arange(count, device="cpu").repeat_interleave(torch.tensor(counts, device="cpu"))
        of_planes = replace(self, matrix=self.matrix[samples.to(self.matrix.device)])
        return list(of_planes.move_masks(planes, reading)[:, 0].split(counts))
