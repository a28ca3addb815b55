"""What a call of a container did to the positions of pixels, which masks, boxes, points and the inverse follow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from kvision._dtype import compute_dtype
from kvision.augmentation import maps
from kvision.augmentation.engine.execution import Execution
from kvision.augmentation.engine.label_settings import LabelSettings, MaskReading
from kvision.augmentation.labels import is_within
from kvision.augmentation.maps import warp, warp_labels
from kvision.augmentation.warp_and_color import Resampling
from kvision.constants import Resample
from kvision.geometry.linalg import transform_points

INSIDE = 0.5 - 1e-3  # of a center: not on an edge of the image, where rounding would decide


class Stage:
    """What a module did. By default all pixels kept their positions, and so does what follows them."""

    @property
    def keeps_lines(self) -> bool:
        """Whether straight lines stay straight."""
        return True

    @property
    def removes_boxes(self) -> bool:
        """Whether `keeps_centers` removes any."""
        return False

    def concerns_all(self, has_boxes: bool) -> bool:
        """Whether labels follow this stage together, those of different kinds and all samples, and no other stage with it.

        So it is where samples were mixed, and where a container inside cuts or removes boxes, if there are any.
        """
        return False

    def source_size(self) -> Any:
        """The size of the images that the module was executed on, a number or (B, 1) an axis, where it is known."""
        return None

    def result_size(self) -> Any:
        """The size of what the stage gives, where it says it, as that of images of a list is known."""
        return None

    def members(self) -> Sequence[int] | None:
        """The samples that went through the stage, by their numbers; None for all."""
        return None

    def maps(self) -> list[Tensor | None]:
        """Of each map that was applied the samples that it moved, (B,) bool; None for all."""
        return []

    def displacements(self, like: Tensor) -> Tensor | None:
        """The map (B, 2, H, W) of a stage that is one map; None for others."""
        return None

    def move_points(self, points: Tensor) -> Tensor:
        """Points (B, N, 2) after the stage, where maps leave them; label_moves.py finds them in the results of maps."""
        return points

    def move_points_back(self, points: Tensor) -> Tensor:
        """Points (B, N, 2) before the stage."""
        return points

    def keeps_centers(self, centers: Tensor) -> Tensor | None:
        """Which boxes stay, by their centers (B, N, 2) before the stage: bool (B, N), None for all."""
        return None

    def move_masks(self, masks: Tensor, reading: MaskReading) -> Tensor:
        """Masks (B, C, H, W) after the stage."""
        return masks

    def move_masks_back(self, masks: Tensor) -> Tensor:
        """Masks (B, C, h, w) of results, moved back."""
        return masks

    def invert(self, x: Tensor) -> Tensor:
        """Images (B, C, h, w) of results, moved back."""
        return x

    def product(self, matrix: Tensor) -> Tensor:
        """A matrix with that of the stage multiplied to it from the left."""
        return matrix

    def flat(self) -> list[Stage]:
        """The stages of which it consists."""
        return [self]

    def forget(self) -> None:
        """Free the displacements of maps. They can be computed again from what was drawn."""


class Chain(Stage):
    """Stages one after the other."""

    def __init__(self, stages: Sequence[Stage] = ()) -> None:
        self.stages = stages  # dynamo traces no subclass of list, and no generator as argument

    def __getitem__(self, index: int) -> Stage:
        return self.stages[index]

    @property
    def keeps_lines(self) -> bool:
        return all(stage.keeps_lines for stage in self.stages)

    @property
    def removes_boxes(self) -> bool:
        return any(stage.removes_boxes for stage in self.stages)

    def concerns_all(self, has_boxes: bool) -> bool:
        return any(stage.concerns_all(has_boxes) for stage in self.stages)

    def source_size(self) -> Any:
        sizes = [stage.source_size() for stage in self.stages]
        return next((size for size in sizes if size is not None), None)

    def maps(self) -> list[Tensor | None]:
        return [chosen for stage in self.stages for chosen in stage.maps()]

    def move_points(self, points: Tensor) -> Tensor:
        for stage in self.stages:
            points = stage.move_points(points)
        return points

    def move_points_back(self, points: Tensor) -> Tensor:
        for stage in reversed(self.stages):
            points = stage.move_points_back(points)
        return points

    def keeps_centers(self, centers: Tensor) -> Tensor | None:
        kept: Tensor | None = None
        for stage in self.stages:
            own = stage.keeps_centers(centers)
            if own is not None:
                kept = own if kept is None else kept & own
            centers = stage.move_points(centers)
        return kept

    def move_masks(self, masks: Tensor, reading: MaskReading) -> Tensor:
        return self._through(masks, self.stages, lambda stage, x: stage.move_masks(x, reading))

    def move_masks_back(self, masks: Tensor) -> Tensor:
        return self._through(masks, self.stages[::-1], lambda stage, x: stage.move_masks_back(x))

    def invert(self, x: Tensor) -> Tensor:
        return self._through(x, self.stages[::-1], lambda stage, x: stage.invert(x))

    def _through(self, x: Tensor, stages: Sequence[Stage], move: Callable[[Stage, Tensor], Tensor]) -> Tensor:
        """Images or masks after stages, by what moves them through each."""
        for stage in stages:
            x = move(stage, x)
        return x

    def product(self, matrix: Tensor) -> Tensor:
        for stage in self.stages:
            matrix = stage.product(matrix)
        return matrix

    def flat(self) -> list[Stage]:
        return [part for stage in self.stages for part in stage.flat()]

    def forget(self) -> None:
        for stage in self.stages:
            stage.forget()


class Nested(Chain):
    """The stages of a container that is a child."""

    def __init__(self, stages: Sequence[Stage], labels: LabelSettings | None) -> None:
        super().__init__(stages)
        self.labels = labels

    def concerns_all(self, has_boxes: bool) -> bool:
        filters = self.labels is not None and not self.labels.box_filter.does_nothing
        return (has_boxes and filters) or super().concerns_all(has_boxes)

    def move_masks(self, masks: Tensor, reading: MaskReading) -> Tensor:
        return super().move_masks(masks, reading.inside(self.labels))


@dataclass
class ByMatrix(Stage):
    """Pixels moved by a matrix (B, 3, 3) of each sample."""

    matrix: Tensor

    def move_points(self, points: Tensor) -> Tensor:
        return transform_points(self.matrix.to(points), points)

    def move_points_back(self, points: Tensor) -> Tensor:
        return transform_points(torch.linalg.inv_ex(self.matrix).inverse.to(points), points)

    def product(self, matrix: Tensor) -> Tensor:
        return self.matrix @ matrix.to(self.matrix)


@dataclass
class Resampled(Stage):
    """Neighboring geometric augmentations that were executed as one resampling."""

    source: Sequence[int]
    size: Sequence[int]
    resampling: Resampling
    parts: Sequence[Stage] = field(default=(), kw_only=True)  # each by itself, where one of them removes boxes

    @property
    def removes_boxes(self) -> bool:
        return bool(self.parts)

    def source_size(self) -> tuple[int, ...]:
        return tuple(self.source)

    def keeps_centers(self, centers: Tensor) -> Tensor | None:
        return Chain(self.parts).keeps_centers(centers)


@dataclass
class Warp(Resampled, ByMatrix):
    """One warp."""

    def move_masks(self, masks: Tensor, reading: MaskReading) -> Tensor:
        return warp_labels(masks, self.matrix, self.size, self.resampling.for_labels(reading.mode, reading.fill))

    def move_masks_back(self, masks: Tensor) -> Tensor:
        return warp_labels(masks, self.matrix, self.source, self.resampling.for_inverse("nearest"), inverse=False)

    def invert(self, x: Tensor) -> Tensor:
        return warp(x, self.matrix.to(x.device), self.source, self.resampling.for_inverse(), inverse=False)


@dataclass
class Applied(Stage):
    """An augmentation that ran by itself."""

    module: Any  # an AugmentationBase, which imports this module
    execution: Execution
    flags: dict[str, Any]

    @property
    def keeps_lines(self) -> bool:
        return self.module.keeps_lines

    @property
    def removes_boxes(self) -> bool:
        return self.module.removes_boxes and self.execution.applied

    def concerns_all(self, has_boxes: bool) -> bool:
        return self.module.mixes_samples

    def source_size(self) -> tuple[int, ...]:
        return tuple(self.execution.shape[2:])

    def maps(self) -> list[Tensor | None]:
        return [self.execution.chosen] if self.module.moves_by_map and self.execution.applied else []

    def displacements(self, like: Tensor) -> Tensor | None:
        module: Any = self.module
        return module.displacements_of(self.execution, self.flags, like) if self.maps() else None

    def move_points(self, points: Tensor) -> Tensor:
        return points if self.module.moves_by_map else self.module.transform_points(points, self.execution)

    def keeps_centers(self, centers: Tensor) -> Tensor | None:
        if not self.removes_boxes:
            return None
        size = self.module.output_shape(self.execution.shape, self.flags)[2:]
        inside = is_within(self.move_points(centers), size, INSIDE)
        return inside if self.execution.chosen is None else inside | ~self.execution.chosen.to(inside.device)[:, None]

    def move_points_back(self, points: Tensor) -> Tensor:
        return self.module.inverse_points(points, self.execution)

    def move_masks(self, masks: Tensor, reading: MaskReading) -> Tensor:
        flags = self.flags if reading.mode is None else {**self.flags, "resample": Resample.get(reading.mode)}
        if reading.fill is not None:
            flags = {**flags, "mask_fill": reading.fill}
        return self.module.transform_masks(masks, self.execution, flags)

    def move_masks_back(self, masks: Tensor) -> Tensor:
        return self.module.inverse_masks(masks, self.execution, self.flags)

    def invert(self, x: Tensor) -> Tensor:
        return self.module.inverse_images(x, self.execution, self.flags)

    def product(self, matrix: Tensor) -> Tensor:
        own = self.module._matrix(self.execution)
        return own @ matrix.to(own)

    def forget(self) -> None:
        if self.execution.keeps_map:
            self.execution.keeps_map, self.execution.map = False, None


@dataclass
class Composed(Resampled, Chain):
    """One resampling at the coordinates that matrices and maps compose to."""

    stages: Sequence[ByMatrix | Applied]
    antialias: bool
    _links: Sequence[Tensor] | None = None  # the tensors of `stages`, cached

    def tensors(self, x: Tensor) -> Sequence[Tensor]:
        """Matrices (B, 3, 3) and displacements (B, 2, H, W) for images or masks; kept until `forget`."""
        if self._links is None or self._links[0].device != x.device:
            like = self._like(x)
            links = [s.matrix.to(like) if isinstance(s, ByMatrix) else s.displacements(like) for s in self.stages]
            self._links = [link for link in links if link is not None]
        return self._links

    @staticmethod
    def _like(x: Tensor) -> Tensor:
        """Coordinates of images or masks have its type and its device."""
        dtype = compute_dtype(x) if x.is_floating_point() else torch.float32
        return x if x.dtype == dtype else x.new_empty(0, dtype=dtype)

    def forget(self) -> None:
        self._links = None

    def flat(self) -> list[Stage]:
        return [self]

    def run(self, x: Tensor) -> Tensor:
        """The images (B, C, h, w) of the result."""
        return maps.read_composed(x, self.tensors(x), self.size, self.resampling, self.antialias)

    def move_points_back(self, points: Tensor) -> Tensor:
        for stage, link in zip(reversed(self.stages), reversed(self.tensors(points))):
            is_map = isinstance(stage, Applied)
            points = maps.read_positions(link, points) if is_map else stage.move_points_back(points)
        return points

    def move_masks(self, masks: Tensor, reading: MaskReading) -> Tensor:
        resampling = self.resampling.for_labels(reading.mode, reading.fill)
        return maps.read_labels_composed(masks, self.tensors(masks), self.size, resampling)

    def move_masks_back(self, masks: Tensor) -> Tensor:
        back, converged = self._inverse(masks)
        moved = maps.read_labels(masks, back, self.resampling.for_inverse("nearest"))
        return torch.where(converged, moved, 0).to(masks.dtype)

    def invert(self, x: Tensor) -> Tensor:
        back, converged = self._inverse(x)
        return torch.where(converged, maps.read(x, back, self.resampling.for_inverse()), 0).to(x.dtype)

    def _inverse(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Where the pixels of the image are in the result, (B, H, W, 2), and whether they are there, (B, 1, H, W)."""
        like, size = self._like(x), (self.source[0], self.source[1])
        points = maps.pixel_positions(*size, like).expand(x.shape[0], -1, 2)
        converged = torch.ones((x.shape[0], *size), dtype=torch.bool, device=x.device)
        for stage in self.stages:
            displacements = stage.displacements(like)
            if displacements is None:
                points = stage.move_points(points)
            else:
                back, inside = maps.find_everywhere(displacements, points.unflatten(1, size))
                points, converged = back.flatten(1, 2), converged & inside
        return points.unflatten(1, size), converged[:, None]


def _refuse(self: Any, *_: Any) -> Any:
    raise NotImplementedError(
        "PatchSequential: masks, boxes, key points, matrices and the inverse cannot follow cells that move"
    )


class Cells(Stage):
    """Cells of a grid that moved by themselves, which nothing else can follow."""

    keeps_lines = False
    move_points = move_points_back = move_masks = move_masks_back = invert = product = _refuse  # type: ignore[assignment]
