"""What a call of a container did to the positions of pixels, which masks, boxes, points and the inverse follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from kvision._dtype import compute_dtype
from kvision.augmentation import maps
from kvision.augmentation.engine.augmentation import AugmentationBase
from kvision.augmentation.engine.execution import Execution
from kvision.augmentation.labels import BoxFilter
from kvision.augmentation.maps import warp, warp_labels
from kvision.augmentation.warp_and_color import Resampling
from kvision.constants import Resample
from kvision.geometry.linalg import transform_points


class MaskReading(NamedTuple):
    """How masks are read: a mode, None for that of the images, and what enters from outside, None for 0."""

    mode: str | None = None
    fill: Any = None
    is_fixed: bool = False  # also inside of containers that read masks in another way

    def inside(self, settings: LabelSettings | None) -> MaskReading:
        """The same inside of a container with settings."""
        if self.is_fixed or settings is None or settings.masks is None or settings.has_default_masks:
            return self
        return settings.masks


KNOWN = MaskReading("bilinear", None, True)  # of masks of the pixels that are known


class LabelSettings(NamedTuple):
    """What a container says about labels."""

    clips_each: bool = False  # boxes end at the edges of the image after each stage
    box_filter: BoxFilter = BoxFilter()
    masks: MaskReading | None = None
    has_default_masks: bool = False  # `masks` is only for a container by itself; the one around it decides

    @property
    def changes_boxes(self) -> bool:
        return not self.box_filter.does_nothing


class Warp(NamedTuple):
    """Neighboring geometric augmentations that were executed as one warp."""

    matrix: Tensor
    source: Sequence[int]
    size: Sequence[int]
    resampling: Resampling

    def move_points(self, points: Tensor) -> Tensor:
        return transform_points(self.matrix.to(points), points)

    def move_points_back(self, points: Tensor) -> Tensor:
        return transform_points(torch.linalg.inv(self.matrix).to(points), points)

    def move_masks(self, masks: Tensor, reading: MaskReading) -> Tensor:
        return warp_labels(masks, self.matrix, self.size, self.resampling.for_labels(reading.mode, reading.fill))

    def move_masks_back(self, masks: Tensor) -> Tensor:
        return warp_labels(masks, self.matrix, self.source, self.resampling.for_inverse("nearest"), inverse=False)

    def move_images_back(self, x: Tensor) -> Tensor:
        return warp(x, self.matrix.to(x.device), self.source, self.resampling.for_inverse(), inverse=False)

    def product(self, matrix: Tensor) -> Tensor:
        return self.matrix @ matrix.to(self.matrix)

    @property
    def keeps_lines(self) -> bool:
        return True


class Applied(NamedTuple):
    """A module that ran by itself; an augmentation with its execution, a container with the stages of its children."""

    module: nn.Module
    execution: Execution | None
    flags: dict[str, Any]
    stages: Sequence[Any] | None = None
    labels: LabelSettings | None = None  # of a container

    @property
    def _augmentation(self) -> tuple[AugmentationBase, Execution] | None:
        if self.execution is None or not isinstance(self.module, AugmentationBase):
            return None
        return self.module, self.execution

    def move_points(self, points: Tensor) -> Tensor:
        if self.stages is not None:
            return move_points(points, self.stages)
        if (own := self._augmentation) and not own[0].moves_by_map:
            points = own[0].transform_points(points, own[1])
        return points

    def move_points_back(self, points: Tensor) -> Tensor:
        if self.stages is not None:
            return move_points_back(points, self.stages)
        if own := self._augmentation:
            points = own[0].inverse_points(points, own[1])
        return points

    def move_masks(self, masks: Tensor, reading: MaskReading) -> Tensor:
        if self.stages is not None:
            return move_masks(masks, self.stages, reading.inside(self.labels))
        if own := self._augmentation:
            flags = self.flags if reading.mode is None else {**self.flags, "resample": Resample.get(reading.mode)}
            if reading.fill is not None:
                flags = {**flags, "mask_fill": reading.fill}
            masks = own[0].transform_masks(masks, own[1], flags)
        return masks

    def move_masks_back(self, masks: Tensor) -> Tensor:
        if self.stages is not None:
            return move_masks_back(masks, self.stages)
        if own := self._augmentation:
            masks = own[0].inverse_masks(masks, own[1], self.flags)
        return masks

    def move_images_back(self, x: Tensor) -> Tensor:
        if self.stages is not None:
            return invert(x, self.stages)
        if own := self._augmentation:
            x = own[0].inverse_images(x, own[1], self.flags)
        return x

    def product(self, matrix: Tensor) -> Tensor:
        if self.stages is not None:
            return product(matrix, self.stages)
        if own := self._augmentation:
            of_module = own[0]._matrix(own[1])
            matrix = of_module @ matrix.to(of_module)
        return matrix

    @property
    def keeps_lines(self) -> bool:
        if self.stages is not None:
            return keeps_lines(self.stages)
        return not isinstance(self.module, AugmentationBase) or self.module.keeps_lines


class MapLink(NamedTuple):
    """A map of a chain: an augmentation with its execution."""

    module: Any  # a MapAugmentation
    execution: Execution
    flags: dict[str, Any]

    def displacements(self, like: Tensor) -> Tensor:
        moved: Tensor = self.module.displacements_of(self.execution, self.flags, like)
        return moved


@dataclass
class Composed:
    """Neighboring geometric augmentations, maps among them, that were executed as one resampling."""

    links: Sequence[Tensor | MapLink]  # matrices (B, 3, 3) and maps, the first one first
    source: Sequence[int]
    size: Sequence[int]
    resampling: Resampling
    samples: int  # along each axis of a pixel
    _links: Sequence[Tensor] | None = None  # the tensors of `links`, cached

    def tensors(self, x: Tensor) -> Sequence[Tensor]:
        """The links as matrices (B, 3, 3) and displacements (B, 2, H, W) for images or masks; kept until `forget`."""
        if self._links is None or self._links[0].device != x.device:
            dtype = compute_dtype(x) if x.is_floating_point() else torch.float32
            like = x if x.dtype == dtype else x.new_empty(0, dtype=dtype)
            self._links = [
                link.displacements(like) if isinstance(link, MapLink) else link.to(like) for link in self.links
            ]
        return self._links

    def forget(self) -> None:
        """Free the displacements. They can be computed again from what was drawn."""
        self._links = None

    def run(self, x: Tensor) -> Tensor:
        """The images (B, C, h, w) of the result."""
        return maps.read_composed(x, self.tensors(x), self.size, self.resampling, self.samples)

    def move_points(self, points: Tensor) -> Tensor:
        for link in self.links:
            if isinstance(link, Tensor):
                points = transform_points(link.to(points), points)
        return points

    def move_points_back(self, points: Tensor) -> Tensor:
        for link, tensor in zip(reversed(self.links), reversed(self.tensors(points))):
            if isinstance(link, MapLink):
                points = maps.read_positions(tensor, points)
            else:
                points = transform_points(torch.linalg.inv(link).to(points), points)
        return points

    def move_masks(self, masks: Tensor, reading: MaskReading) -> Tensor:
        resampling = self.resampling.for_labels(reading.mode, reading.fill)
        return maps.read_labels_composed(masks, self.tensors(masks), self.size, resampling)

    def move_masks_back(self, masks: Tensor) -> Tensor:
        back, converged = self._inverse(masks)
        moved = maps.read_labels(masks, back, self.resampling.for_inverse("nearest"))
        return torch.where(converged, moved, 0).to(masks.dtype)

    def move_images_back(self, x: Tensor) -> Tensor:
        back, converged = self._inverse(x)
        return torch.where(converged, maps.read(x, back, self.resampling.for_inverse()), 0).to(x.dtype)

    def _inverse(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Where the pixels of the image are in the result, (B, H, W, 2), and whether they are there, (B, 1, H, W)."""
        like = x.new_empty(0, dtype=compute_dtype(x) if x.is_floating_point() else torch.float32)
        height, width = self.source
        points = maps.pixel_positions(height, width, like).expand(x.shape[0], -1, 2)
        converged = torch.ones((x.shape[0], height, width), dtype=torch.bool, device=x.device)
        for link in self.links:
            if isinstance(link, MapLink):
                back, inside = maps.find_everywhere(link.displacements(like), points.unflatten(1, (height, width)))
                points, converged = back.flatten(1, 2), converged & inside
            else:
                points = transform_points(link.to(like), points)
        return points.unflatten(1, (height, width)), converged[:, None]

    def product(self, matrix: Tensor) -> Tensor:
        for link in self.links:
            if isinstance(link, Tensor):
                matrix = link @ matrix.to(link)
        return matrix

    @property
    def keeps_lines(self) -> bool:
        return not any(isinstance(link, MapLink) for link in self.links)


class Cells(NamedTuple):
    """Cells of a grid that moved by themselves, which nothing else can follow."""

    keeps_lines: bool = False

    def move_points(self, points: Tensor) -> Tensor:
        raise _cells_moved()

    def move_points_back(self, points: Tensor) -> Tensor:
        raise _cells_moved()

    def move_masks(self, masks: Tensor, reading: MaskReading) -> Tensor:
        raise _cells_moved()

    def move_masks_back(self, masks: Tensor) -> Tensor:
        raise _cells_moved()

    def move_images_back(self, x: Tensor) -> Tensor:
        raise _cells_moved()

    def product(self, matrix: Tensor) -> Tensor:
        raise _cells_moved()


def _cells_moved() -> NotImplementedError:
    return NotImplementedError(
        "PatchSequential: masks, boxes, key points, matrices and the inverse cannot follow cells that move"
    )


Stage = Warp | Applied | Composed | Cells

# --- all stages of a call -------------------------------------------------------------------------------------------


def move_points(points: Tensor, stages: Sequence[Stage]) -> Tensor:
    """Points (B, N, 2) after all stages, where maps leave them; label_moves.py finds them in the results of maps."""
    for stage in stages:
        points = stage.move_points(points)
    return points


def move_points_back(points: Tensor, stages: Sequence[Stage]) -> Tensor:
    """Points (B, N, 2) before all stages."""
    for stage in reversed(stages):
        points = stage.move_points_back(points)
    return points


def move_masks(masks: Tensor, stages: Sequence[Stage], reading: MaskReading) -> Tensor:
    """Masks (B, C, H, W) after all stages."""
    for stage in stages:
        masks = stage.move_masks(masks, reading)
    return masks


def move_masks_back(masks: Tensor, stages: Sequence[Stage]) -> Tensor:
    """Masks (B, C, h, w) of results, moved back."""
    for stage in reversed(stages):
        masks = stage.move_masks_back(masks)
    return masks


def invert(x: Tensor, stages: Sequence[Stage]) -> Tensor:
    """Undo what stages did to the positions of pixels, the last one first."""
    for stage in reversed(stages):
        x = stage.move_images_back(x)
    return x


def product(matrix: Tensor, stages: Sequence[Stage]) -> Tensor:
    """A matrix with the matrices of stages, the first of which was executed first, multiplied to it from the left."""
    for stage in stages:
        matrix = stage.product(matrix)
    return matrix


def keeps_lines(stages: Sequence[Stage]) -> bool:
    """Whether straight lines stay straight."""
    return all(stage.keeps_lines for stage in stages)


def mixes(stages: Sequence[Stage]) -> bool:
    """Whether samples of the batch are mixed."""
    applied = [stage for stage in stages if isinstance(stage, Applied)]
    return any(getattr(s.module, "mixes_samples", False) or mixes(s.stages or ()) for s in applied)


def forget_coordinates(stages: Sequence[Stage]) -> None:
    """Free the displacements of maps."""
    for stage in stages:
        if isinstance(stage, Composed):
            stage.forget()
        elif isinstance(stage, Applied):
            forget_coordinates(stage.stages or ())
            if stage.execution is not None and stage.execution.keeps_map:
                stage.execution.keeps_map, stage.execution.map = False, None
