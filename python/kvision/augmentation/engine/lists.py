"""What labels and the inverse follow on a list of images, and where one launch makes it a batch."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._constants import on_device
from kvision.augmentation import labels
from kvision.augmentation.engine.label_settings import LabelSettings, MaskReading
from kvision.augmentation.engine.stages import INSIDE, Nested, Stage, Warp
from kvision.augmentation.labels import is_within
from kvision.augmentation.maps import exact, exact_each, warp_each, warp_to_sizes
from kvision.augmentation.preimages.result_map_list import NodeReading, displaced
from kvision.augmentation.sample_rows import index_of
from kvision.core.exceptions import ShapeError
from kvision.geometry.linalg import transform_points
from kvision.geometry.transform.lists.remap_list import repeated


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


class _MadeOnce:
    """Makes maps once, until they are forgotten."""

    def __init__(self, make: Callable[[Tensor], Tensor]) -> None:
        self._make = make
        self._maps: dict[tuple[torch.dtype, torch.device], Tensor] = {}

    def __call__(self, like: Tensor) -> Tensor:
        key = (like.dtype, like.device)
        if key not in self._maps:
            self._maps[key] = self._make(like)
        return self._maps[key]

    def forget(self) -> None:
        self._maps.clear()


class ListMap(NamedTuple):
    """Maps of images of a list.

    Attributes:
        make: gives them like a tensor, as `remap_list` takes them.
        chosen: (B,) bool, the images that are displaced; None for all.
        sides: height and width of each image.
        made: `make`, or what it reads, if that keeps maps.
    """

    make: Callable[[Tensor], Tensor]
    chosen: Tensor | None
    sides: Sequence[int]
    made: _MadeOnce | None = None

    def shared(self) -> ListMap:
        """The same, which are made once for all parts of their images."""
        made = _MadeOnce(self.make)
        return self._replace(make=made, made=made)

    def of_rows(self, rows: Sequence[int]) -> ListMap:
        """The maps of some of these images."""
        chosen = None if self.chosen is None else self.chosen.index_select(0, index_of(rows, self.chosen))
        sides = [n for i in rows for n in self.sides[2 * i : 2 * i + 2]]
        return ListMap(lambda like: repeated(self.make(like), self.sides, rows), chosen, sides, self.made)

    def among(self, samples: Sequence[int], sides: Sequence[int], device: torch.device) -> ListMap:
        """Those of images of which these are the samples; the others, of which there are `sides`, have none."""
        count = len(sides) // 2
        if self.chosen is None:
            chosen = on_device(torch.tensor([i in samples for i in range(count)], device="cpu"), device)
        else:
            none = torch.zeros(count, dtype=torch.bool, device=device)
            chosen = none.index_copy(0, index_of(samples, none), self.chosen.to(device))
        return self._replace(chosen=chosen, sides=with_sides(sides, samples, self.sides))


Link = Tensor | ListMap  # of a chain: matrices (B, 3, 3), or maps


@dataclass
class OnList(Stage):
    """A step on images of a list, all or some, which had a size each before it. Links move their pixels."""

    before: SizeOfEach
    after: SizeOfEach
    samples: Sequence[int] | None
    links: Sequence[Link] = ()  # of all images, but with maps of these samples
    crops: Tensor | None = None  # (B,) bool, the images of which boxes are removed whose centers leave them
    _maps: dict[int, Tensor] = field(default_factory=dict)  # by the numbers of links

    @property
    def keeps_lines(self) -> bool:
        return not self.maps()

    @property
    def removes_boxes(self) -> bool:
        return self.crops is not None

    def members(self) -> Sequence[int] | None:
        return self.samples

    def source_size(self) -> Any:
        return self.before

    def result_size(self) -> SizeOfEach:
        return self.after

    def maps(self) -> list[Tensor | None]:
        return [link.chosen for link in self.links if isinstance(link, ListMap)]

    def move_points(self, points: Tensor) -> Tensor:
        for link in self.links:
            if isinstance(link, Tensor):
                points = transform_points(link.to(points), points)
        return points

    def move_points_back(self, points: Tensor) -> Tensor:
        for number, link in reversed([*enumerate(self.links)]):
            if isinstance(link, Tensor):
                points = transform_points(torch.linalg.inv_ex(link).inverse.to(points), points)
            else:
                points = displaced(points, self._known(number, points), link.sides, self._moved)
        return points

    def keeps_centers(self, centers: Tensor) -> Tensor | None:
        if self.crops is None:
            return None
        inside = is_within(self.move_points(centers), self.after, INSIDE)
        return inside | ~self.crops.to(inside.device)[:, None]

    def readings(self, like: Tensor, bounded: Sequence[bool]) -> list[NodeReading]:
        """How nodes are read, in the type and on the device of `like`, by the last link first.

        Positions outside of `bounded` images show nothing; those between links do.
        """
        none = [False] * len(bounded)
        found: list[NodeReading] = []  # no call of `list[NodeReading]`, which has no graph before Python 3.12
        for number, link in reversed([*enumerate(self.links)]):
            own = none if number else bounded
            if isinstance(link, Tensor):
                back = torch.linalg.inv_ex(link).inverse.to(like)
                found.append(NodeReading(back, self.before.sides, none, own))
            else:
                found.append(NodeReading(self._known(number, like), link.sides, self._moved, own))
        return found

    def forget(self) -> None:
        self._maps.clear()
        for link in self.links:
            if isinstance(link, ListMap) and link.made is not None:
                link.made.forget()

    @property
    def _moved(self) -> list[bool]:
        """Which images have maps."""
        return [self.samples is None or i in self.samples for i in range(len(self.before.sides) // 2)]

    def _known(self, number: int, like: Tensor) -> Tensor:
        own, link = self._maps.get(number), self.links[number]
        if own is None or own.device != like.device or own.dtype != like.dtype:
            assert isinstance(link, ListMap)
            own = self._maps[number] = link.make(like)
        return own


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
