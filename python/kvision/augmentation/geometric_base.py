"""Geometric augmentations: images, masks, boxes and points follow one matrix a sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype
from kvision.augmentation.engine import (
    AugmentationBase,
    Contribution,
    Execution,
    Motion,
    Params,
    RigidAffineAugmentationBase2D,
    Shape,
)
from kvision.augmentation.maps import exact, warp, warp_covered, warp_covered_each, warp_labels
from kvision.augmentation.transforms import Transform, transform_matrix
from kvision.augmentation.warp_and_color import Resampling
from kvision.constants import Resample, SamplePadding
from kvision.core.exceptions import ValueCheckError
from kvision.geometry.linalg import transform_points
from kvision.geometry.transform.lists.arguments import images_of

__all__ = ["GeometricAugmentationBase2D"]


class GeometricAugmentation(AugmentationBase, keeps_contract=True):
    """What geometric augmentations of images and of volumes share: points and inverse from the matrix of a call."""

    accepts_wide_integers = True

    def output_size(self, shape: Shape, flags: dict[str, Any]) -> tuple[int, ...]:
        """Height and width, of volumes depth, height and width, of the results for images of a shape."""
        return shape[2:]

    def output_shape(self, shape: Shape, flags: dict[str, Any]) -> Shape:
        return (*shape[:2], *self.output_size(shape, flags))

    def _execution_on(self, x: Tensor, params: Params, flags: dict[str, Any]) -> Execution:
        execution = super()._execution_on(x, params, flags)
        execution.matrix = self._matrix_of(x, execution, flags)
        return execution

    def _matrix_of(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        """The matrices of an execution, the identity for samples that are not chosen."""
        matrix = self.compute_transformation(x, self._params_on_device(x, execution), flags)
        if execution.chosen is None:
            return matrix
        return torch.where(execution.chosen[:, None, None], matrix, self.identity_matrix(x).to(matrix))

    def inverse_transform(self, input: Tensor, flags: dict[str, Any], transform: Tensor, size: Any) -> Tensor:
        """Resample results at the pixels of the images that they came from, of a given size."""
        raise NotImplementedError(f"{type(self).__name__}.inverse_transform")

    def transform_points(self, points: Tensor, execution: Execution) -> Tensor:
        if not execution.applied:
            return points
        return transform_points(self._matrix(execution).to(points), points)

    def inverse_points(self, points: Tensor, execution: Execution) -> Tensor:
        if not execution.applied:
            return points
        return transform_points(torch.linalg.inv_ex(self._matrix(execution)).inverse.to(points), points)

    def inverse_images(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied:
            return x
        return self.inverse_transform(x, flags, self._matrix(execution), tuple(execution.shape[2:]))


class GeometricAugmentationBase2D(GeometricAugmentation, RigidAffineAugmentationBase2D, keeps_contract=True):
    """Base of augmentations that move pixels by a matrix (B, 3, 3), from image pixels to result pixels.

    A subclass declares a chain of formulas of its columns, `transforms`, or overrides `compute_transformation`. One whose
    results have another size overrides `output_size`. Inverse, masks, boxes and key points follow from the matrix.

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the image and its matrix.

    Raises:
        TypeError: `p` or `p_batch` is not a number.
        ValueError: `p` or `p_batch` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> class Right(K.augmentation.GeometricAugmentationBase2D):
        ...     def compute_transformation(self, input, params, flags):
        ...         return torch.tensor([[1.0, 0, 1], [0, 1, 0], [0, 0, 1]]).expand(len(input), 3, 3)
        >>> Right(p=1.0)(torch.tensor([[[[1.0, 2.0, 3.0]]]]))
        tensor([[[[0., 1., 2.]]]])
    """

    # What containers may join with a resampling next to it, without changing its result:
    moves_whole_pixels = False  # every pixel of the result is one of the image, or the fill value
    stays_inside = False  # none is the fill value
    permutes_pixels = False  # every pixel of the image is in the result: flips and turns

    # --- what subclasses declare ---

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform] | None:
        """The formulas of the matrix, the first one first; None if `compute_transformation` is overridden instead."""
        return None

    def matrix_transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform] | None:
        """The chain that the matrix is made of, also where images are not read by that matrix."""
        return self.transforms(shape, flags)

    def resampling(self, flags: dict[str, Any]) -> Resampling:
        """How images are read."""
        if self.moves_whole_pixels:
            return Resampling("nearest")
        mode = Resample.get(flags.get("resample", Resample.BILINEAR)).name.lower()
        padding = SamplePadding.get(flags.get("padding_mode", SamplePadding.ZEROS)).name.lower()
        return Resampling(mode, padding, bool(flags.get("align_corners", True)), flags.get("fill_value"))

    # --- execution ---

    def _declared(self, shape: Shape, flags: dict[str, Any]) -> Contribution:
        chain = self.transforms(shape, flags)
        reads_by_matrix = chain is not None
        chain = self.matrix_transforms(shape, flags) if chain is None else chain
        if chain is None:
            return Contribution()
        height, width = self.output_size(shape, flags)[-2:]
        whole = (self.moves_whole_pixels, self.stays_inside, self.permutes_pixels)
        return Contribution(Motion((height, width), self.resampling(flags), chain, reads_by_matrix, *whole))

    def _executes_columns(self, shape: Shape) -> bool:
        return self.matrix_transforms(shape, self.flags) is not None

    def _run(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied or self._is_customized() or self.transforms(execution.shape, flags) is None:
            return super()._run(x, execution, flags)
        columns = execution.columns
        if columns is None and execution.params is not None:
            execution.matrix = self._matrix_of(x, execution, flags)
            return self._warp(x, execution.matrix, flags)
        image_pass = self._kept_pass(x.dtype, execution, flags)
        assert image_pass is not None
        y, matrix = image_pass.run(x, None if columns is None else columns.drawn)
        execution.keep_matrix(matrix)
        return y

    def _warp(self, x: Tensor, matrix: Tensor, flags: dict[str, Any]) -> Tensor:
        return warp(x, matrix, self.output_size(tuple(x.shape), flags), self.resampling(flags))

    def _sizes_of_list(self, images: Sequence[Tensor]) -> tuple[list[int], bool]:
        """Height and width of all results of images (C, H, W), if settings say them, or of each; whether these are a list."""
        size = self.flags.get("size")
        if isinstance(size, tuple):
            return list(size), False
        return [n for x in images for n in self.output_size((1, *x.shape), self.flags)], True

    def _matrix_of(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if execution.columns is not None or execution.params is None:
            drawn, chain = self._chain(x, execution, flags)
            dtype = compute_dtype(x) if execution.identity is None else execution.identity[1]
            return transform_matrix(as_dtype(drawn, dtype), chain)
        return super()._matrix_of(x, execution, flags)

    def _chain(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> tuple[Tensor, list[Transform]]:
        """The chain of an execution whose columns were drawn, with the tensor that they are in."""
        chain, columns = self.matrix_transforms(execution.shape, flags) or (), execution.columns
        if columns is None:
            return torch.empty(execution.shape[0], 0, device=x.device), list(chain)
        return columns.drawn, self._bound(chain, columns.span)

    def _find_matrix(self, execution: Execution) -> Tensor:
        columns, is_given = execution.columns, execution.params is not None
        if not execution.applied or (columns is None and not is_given and not self._executes_columns(execution.shape)):
            return super()._find_matrix(execution)
        like = super()._find_matrix(execution) if columns is None else columns.drawn
        return self._matrix_of(like.new_empty(1).expand(execution.shape), execution, self.flags)

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        chain = self.matrix_transforms(tuple(input.shape), flags)
        if chain is None:
            raise NotImplementedError(f"{type(self).__name__}.compute_transformation")
        if self._param_generator is None:
            columns = torch.empty(input.shape[0], 0, device=input.device)
        else:
            columns = self._param_generator.to_columns(params, tuple(input.shape))
        return transform_matrix(columns.to(input.device, compute_dtype(input)), self._bound(chain, None))

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        if transform is None:
            transform = self.compute_transformation(input, params, flags)
        return self._warp(input, transform, flags)

    # --- masks and inverse ---

    def apply_transform_mask(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self.apply_transform(input, params, flags, transform)

    @property
    def _warps_masks(self) -> bool:
        """Whether masks are warped by the matrix to the size of the images, and nothing else is done to them."""
        return type(self).transform_masks is GeometricAugmentationBase2D.transform_masks

    @property
    def _warps_points(self) -> bool:
        """Whether boxes and points move by the matrix."""
        return type(self).transform_points is GeometricAugmentationBase2D.transform_points

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied:
            return masks
        if self._is_overridden("apply_transform_mask") or self._is_overridden("apply_transform"):
            return self._masks_by_name(masks, execution, flags)
        size = self.output_size(execution.shape, flags)
        resampling = self.resampling(flags).for_labels(fill=flags.get("mask_fill"))
        return warp_labels(masks, self._matrix(execution), size, resampling)

    def inverse_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied:
            return masks
        resampling, size = self.resampling(flags).for_inverse("nearest"), execution.shape[-2:]
        if self._is_overridden("inverse_transform"):
            nearest = {**flags, "resample": Resample.NEAREST}
            matrix = self._matrix(execution).to(masks.device)
            return self.inverse_transform(exact(masks), nearest, matrix, tuple(size)).to(masks.dtype)
        return warp_labels(masks, self._matrix(execution), size, resampling, inverse=False)

    def inverse_transform(self, input: Tensor, flags: dict[str, Any], transform: Tensor, size: Any) -> Tensor:
        return warp(input, transform.to(input.device), size, self.resampling(flags).for_inverse(), inverse=False)


class AntialiasedByMatrix(GeometricAugmentationBase2D):
    """Base of augmentations by `matrix_transforms` that read images as antialiased warps do where their flag says so."""

    warps_lists_by_matrix = True

    def _set_antialias(self, antialias: bool) -> None:
        op = type(self).__name__
        self.flags["antialias"] = _check.switch(op, "antialias", antialias)
        if antialias and self.flags["resample"] != Resample.BILINEAR:
            raise ValueCheckError(f"{op}: expected resample 'bilinear' with antialias")

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform] | None:
        return None if flags.get("antialias") else self.matrix_transforms(shape, flags)

    def _warp(self, x: Tensor, matrix: Tensor, flags: dict[str, Any]) -> Tensor:
        if not flags.get("antialias"):
            return super()._warp(x, matrix, flags)
        return warp_covered(x, matrix, self.output_size(tuple(x.shape), flags), self.resampling(flags))

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return bool(self.flags.get("antialias")) and not self._is_customized()

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> Any:
        matrix, chosen = execution.matrix, execution.chosen
        assert matrix is not None
        size, is_list = self._sizes_of_list(images)
        if chosen is not None:
            matrix = torch.where(chosen[:, None, None], matrix, torch.eye(3, dtype=matrix.dtype, device=matrix.device))
        results = warp_covered_each(images, matrix, size, self.resampling(self.flags))
        return images_of(results) if is_list else results[0]
