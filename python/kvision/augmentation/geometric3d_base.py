"""Geometric augmentations of volumes: volumes, masks and points follow one matrix a sample."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision.augmentation.engine import Execution, Params, RigidAffineAugmentationBase3D
from kvision.augmentation.geometric_base import GeometricAugmentation
from kvision.augmentation.warp_and_color import Resampling, fill_of_images
from kvision.constants import AnyResample, Resample
from kvision.core.exceptions import ValueCheckError
from kvision.geometry.transform import sampling, warp3d

__all__ = ["GeometricAugmentationBase3D"]


class GeometricAugmentationBase3D(GeometricAugmentation, RigidAffineAugmentationBase3D, keeps_contract=True):
    """Base of augmentations that move voxels by a matrix (B, 4, 4), from voxels (x, y, z) of the volume to those of the result.

    A subclass overrides `compute_transformation`. One whose results have another size overrides `output_size`. Inverse,
    masks and points follow from the matrix.

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: a volume (C, D, H, W) gives a volume (C, d, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the volume and its matrix.

    Raises:
        TypeError: `p` or `p_batch` is not a number.
        ValueError: `p` or `p_batch` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> class Deeper(K.augmentation.GeometricAugmentationBase3D):
        ...     def compute_transformation(self, input, params, flags):
        ...         matrix = torch.eye(4)
        ...         matrix[2, 3] = 1
        ...         return matrix.expand(len(input), 4, 4)
        >>> Deeper(p=1.0)(torch.tensor([1.0, 2.0, 3.0]).reshape(1, 1, 3, 1, 1)).flatten()
        tensor([0., 1., 2.])
    """

    moves_whole_voxels = False  # every voxel of the result is one of the volume, or the fill value

    # --- what subclasses declare ---

    def resampling(self, flags: dict[str, Any]) -> Resampling:
        """How volumes are read."""
        fill = flags.get("fill_value")
        padding = "zeros" if fill is None else "fill"
        if self.moves_whole_voxels:
            return Resampling("nearest", padding, fill=fill)
        mode = Resample.get(flags.get("resample", Resample.BILINEAR)).name.lower()
        return Resampling(mode, padding, bool(flags.get("align_corners", True)), fill)

    # --- execution, masks and inverse ---

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        raise NotImplementedError(f"{type(self).__name__}.compute_transformation")

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        if transform is None:
            transform = self.compute_transformation(input, params, flags)
        resampling = self.resampling(flags)
        resampling = resampling._replace(fill=fill_of_images(input, resampling.fill))
        return self._warp(input, transform, self.output_size(tuple(input.shape), flags), resampling)

    def _warp(
        self, x: Tensor, matrix: Tensor, size: tuple[int, ...], resampling: Resampling, inverse: bool = True
    ) -> Tensor:
        """Resample volumes of any type: float64 holds all integers up to 2^53."""
        mode, padding, align_corners, fill, _ = resampling
        small = (torch.bool, torch.uint8, torch.int8, torch.int16)
        exact = x if x.is_floating_point() else x.to(torch.float32 if x.dtype in small else torch.float64)
        op, matrix = type(self).__name__, matrix.to(x.device)
        padding = "zeros" if padding == "fill" else padding
        options = (matrix, tuple(size), mode, padding, align_corners, inverse)
        y = warp3d.by_matrix(op, exact, *options)
        if fill is not None:
            # What is read of a volume of ones is how much of a voxel is inside; whole voxels keep their bits.
            inside = warp3d.by_matrix(op, exact.new_ones(1).expand(x.shape[0], 1, *x.shape[2:]), *options)
            _, value = sampling.padding_and_fill(op, exact, "fill", fill)
            if value is not None:
                y = torch.where(inside > 1 - 1e-5, y, y + (1 - inside) * value[..., None, None, None].to(y.dtype))
        return y if x.is_floating_point() else y.round().to(x.dtype)

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied:
            return masks
        size = self.output_size(execution.shape, flags)
        resampling = self.resampling(flags).for_labels(fill=flags.get("mask_fill"))
        return self._warp(masks, self._matrix(execution), size, resampling)

    def inverse_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied:
            return masks
        resampling = self.resampling(flags).for_inverse("nearest")
        return self._warp(masks, self._matrix(execution), execution.shape[2:], resampling, inverse=False)

    def inverse_transform(self, input: Tensor, flags: dict[str, Any], transform: Tensor, size: Any) -> Tensor:
        return self._warp(input, transform, tuple(size), self.resampling(flags).for_inverse(), inverse=False)


def parse_resample(op: str, resample: AnyResample) -> Resample:
    """How volumes are read, if warps of volumes have that."""
    mode = Resample.get(resample)
    if mode not in (Resample.NEAREST, Resample.BILINEAR):
        raise ValueCheckError(f"{op}: expected resample to be 'nearest' or 'bilinear', got {resample!r}")
    return mode
