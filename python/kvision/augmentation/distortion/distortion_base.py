"""Deformations by maps, and what those share whose images are read as users say."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._dtype import compute_dtype
from kvision._ops import match_layout
from kvision.augmentation import maps
from kvision.augmentation.displacements import NoiseField
from kvision.augmentation.distortion.displacement_map import MapFormula
from kvision.augmentation.engine import AugmentationBase2D, Contribution, Execution, Motion, Params
from kvision.augmentation.preimages.result_map import find_positions
from kvision.augmentation.samples import where_chosen
from kvision.augmentation.warp_and_color import Resampling
from kvision.constants import AnyResample, AnySamplePadding, Resample, SamplePadding
from kvision.geometry.transform.lists.arguments import like_batch
from kvision.geometry.transform.lists.arguments import sizes as sides_of


class MapAugmentation(AugmentationBase2D, keeps_contract=True):
    """A deformation by a map: where each pixel of the result reads the image."""

    accepts_bytes = accepts_wide_integers = True
    keeps_lines = False
    moves_by_map = True

    def displacements(self, shape: tuple[int, ...], params: Params, flags: dict[str, Any], like: Tensor) -> Tensor:
        """The map (B, 2, H, W), as maps.py stores it."""
        formula = self._formula(params, flags, like)
        if formula is None:
            raise NotImplementedError(f"{type(self).__name__}.displacements")
        return formula.map(shape[-2:])

    def _formula(self, params: Params, flags: dict[str, Any], like: Tensor) -> MapFormula | None:
        """The map as a formula for images of all sizes, in the type of `like`; None if it is another map."""
        return None

    def _maps_of_list(self, sides: Sequence[int], execution: Execution, like: Tensor) -> Tensor:
        """The maps of a list for height and width of each image, 0 of those that are not chosen, in one tensor."""
        formula = self._formula(self._params_on_device(like, execution, for_users=False), self.flags, like)
        assert formula is not None
        return formula.maps(sides, None if execution.chosen is None else execution.chosen.float())

    def _noise_field(self, shape: tuple[int, ...], number: int, has_seed: bool) -> NoiseField | None:
        """The map for kernels that draw its noise; None if it is another map.

        `number` is that of the augmentation, as draw_columns counts.
        """
        return None

    def _declared(self, shape: tuple[int, ...], flags: dict[str, Any]) -> Contribution:
        return Contribution(Motion((shape[-2], shape[-1]), self.resampling(flags), None))

    def resampling(self, flags: dict[str, Any]) -> Resampling:
        """How images are read."""
        mode = Resample.get(flags.get("resample", Resample.BILINEAR)).name.lower()
        padding = SamplePadding.get(flags.get("padding_mode", SamplePadding.ZEROS)).name.lower()
        return Resampling(mode, padding, flags.get("align_corners", True))

    def _run(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied or not execution.keeps_map or self._is_customized():
            return super()._run(x, execution, flags)
        y = maps.read_displaced(x, self._map_of(execution, flags, x), self.resampling(flags))
        return where_chosen(execution.chosen, match_layout(y, x), x)

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return self._knows_maps_of_lists and (dtype.is_floating_point or dtype == torch.uint8)

    @property
    def _knows_maps_of_lists(self) -> bool:
        """Whether `_maps_of_list` has the maps that `displacements` has of a batch."""
        own, base = type(self), MapAugmentation
        has_maps = own._formula is not base._formula or own._maps_of_list is not base._maps_of_list
        return has_maps and not self._is_overridden("displacements") and not self._is_customized()

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        like = like_batch(images)
        like = like.new_empty(len(images), 0, dtype=compute_dtype(like))
        moved = self._maps_of_list(sides_of(images), execution, like)
        return maps.read_displaced_list(images, moved, self.resampling(self.flags))

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        like = input.new_empty(0, dtype=compute_dtype(input))
        moved = self.displacements(tuple(input.shape), params, flags, like)
        return maps.read_displaced(input, moved, self.resampling(flags))

    def displacements_of(self, execution: Execution, flags: dict[str, Any], like: Tensor) -> Tensor:
        """The map of an execution, 0 for samples that are not chosen, on the device of `like` and in the type it computes in."""
        return where_chosen(execution.chosen, self._map_of(execution, flags, like), 0.0)

    def _map_of(self, execution: Execution, flags: dict[str, Any], like: Tensor) -> Tensor:
        """The map as drawn for all samples. The first one of an execution that keeps its map serves later ones of its type."""
        dtype, kept = compute_dtype(like), execution.map
        if kept is not None and kept.device == like.device and kept.dtype == dtype:
            return kept
        params = self._params_on_device(like, execution, for_users=False)
        like = like if like.dtype == dtype else like.new_empty(0, dtype=dtype)
        moved = self.displacements(execution.shape, params, flags, like)
        if execution.keeps_map and kept is None:
            execution.map = moved
        return moved

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied or masks.shape[0] == 0:
            return masks
        resampling = self.resampling(flags).for_labels(fill=flags.get("mask_fill"))
        moved = maps.read_labels_displaced(masks, self.displacements_of(execution, flags, masks), resampling)
        return where_chosen(execution.chosen, moved, masks)

    def transform_points(self, points: Tensor, execution: Execution) -> Tensor:
        if not execution.applied or 0 in points.shape:
            return points
        with torch.no_grad():
            moved, _ = find_positions(self.displacements_of(execution, self.flags, points), points)
        return where_chosen(execution.chosen, moved.to(points), points)

    # --- inverse ---

    def inverse_images(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied or 0 in x.shape:
            return x
        back, converged = self._inverse_map(x, execution, flags)
        y = torch.where(converged, maps.read(x, back, self.resampling(flags).for_inverse()), 0).to(x.dtype)
        return where_chosen(execution.chosen, y, x)

    def inverse_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied or 0 in masks.shape:
            return masks
        back, converged = self._inverse_map(masks, execution, flags)
        read = maps.read_labels(masks, back, self.resampling(flags).for_inverse("nearest"))
        return where_chosen(execution.chosen, torch.where(converged, read, 0).to(masks.dtype), masks)

    def _inverse_map(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> tuple[Tensor, Tensor]:
        """Where the pixels of the image are in the result, (B, H, W, 2), and whether they are there, (B, 1, H, W)."""
        moved = self.displacements_of(execution, flags, x)
        h, w = moved.shape[-2:]
        pixels = maps.pixel_positions(h, w, moved).unflatten(1, (h, w)).expand(len(moved), -1, -1, -1)
        back, converged = maps.find_everywhere(moved, pixels)
        return back, converged[:, None]

    def inverse_points(self, points: Tensor, execution: Execution) -> Tensor:
        if not execution.applied or 0 in points.shape:
            return points
        moved = maps.read_positions(self.displacements_of(execution, self.flags, points), points)
        return where_chosen(execution.chosen, moved, points)


class DistortionBase(MapAugmentation, keeps_contract=True):
    """Base of maps whose images are read with an interpolation and a padding of the user."""

    def __init__(self, resample: AnyResample, padding_mode: AnySamplePadding, **options: Any) -> None:
        super().__init__(**options)
        self.flags = {
            "resample": Resample.get(resample),
            "padding_mode": SamplePadding.get(padding_mode),
            "align_corners": True,
        }
