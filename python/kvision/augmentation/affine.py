"""Random affine transforms of images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._constants import constant
from kvision._dtype import compute_dtype
from kvision.augmentation import ranges
from kvision.augmentation.columns import Column
from kvision.augmentation.draws import Draw
from kvision.augmentation.engine import Execution, Shape
from kvision.augmentation.geometric_base import AntialiasedByMatrix, GeometricAugmentationBase2D
from kvision.augmentation.keys import refuse_capture, refuse_graphs
from kvision.augmentation.lists.sides import rows_on_device
from kvision.augmentation.maps import warp, warp_labels, warp_to_sizes
from kvision.augmentation.random_generator.affine import AffineGenerator, ShearGenerator, TranslateGenerator
from kvision.augmentation.random_generator.base import RandomGeneratorBase
from kvision.augmentation.random_generator.plain import PlainUniformGenerator
from kvision.augmentation.ranges import Numbers, NumbersOfAxes
from kvision.augmentation.transforms import Transform, center_of, transform_matrix
from kvision.augmentation.warp_and_color import fill_of_images
from kvision.constants import AnyResample, AnySamplePadding, Resample, SamplePadding
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.geometry.transform.lists.arguments import like_batch, sizes

__all__ = ["RandomAffine", "RandomRotation", "RandomRotation90", "RandomShear", "RandomTranslate"]


class RandomAffine(AntialiasedByMatrix):
    """Shear, scale, rotate and shift images about their center.

    Args:
        degrees: angle, positive counter-clockwise: a number s for -s to s, or a pair.
        translate: largest shifts along x and y, as fractions of width and height.
        scale: a pair; or four numbers, a pair for x and one for y.
        shear: degrees: a number s for -s to s along x, a pair along x, or four numbers for x and y.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        same_on_batch: all samples get the same parameters.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.
        padding_mode: values out of bounds: 'zeros', 'border', 'reflection', or 'fill' for `fill_value`.
        fill_value: value out of bounds, in place of 0: a number, or one of each channel.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.
        antialias: where images become smaller, average the pixels that a pixel of the result covers, as
            :func:`~kvision.geometry.warp_affine` does. Only with 'bilinear'.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds; `fill_value` with another
            `padding_mode` than 'zeros' or 'fill'; `antialias` with another `resample` than 'bilinear'.

    Example:
        >>> import torch, kvision as K
        >>> augment = K.augmentation.RandomAffine(degrees=(90.0, 90.0), p=1.0)
        >>> augment(torch.tensor([[[[1.0, 2.0], [3.0, 4.0]]]]))
        tensor([[[[2., 4.],
                  [1., 3.]]]])
    """

    def __init__(
        self,
        degrees: NumbersOfAxes,
        translate: NumbersOfAxes | None = None,
        scale: NumbersOfAxes | None = None,
        shear: NumbersOfAxes | None = None,
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        padding_mode: AnySamplePadding = SamplePadding.ZEROS.name,
        fill_value: Numbers | None = None,
        p: float = 0.5,
        keepdim: bool = False,
        *,
        antialias: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator: AffineGenerator = AffineGenerator(degrees, translate, scale, shear)
        self.flags = {"fill_value": None, **_flags(resample, padding_mode, align_corners)}
        if fill_value is not None:
            self.flags.update(_fill_flags("RandomAffine", "fill_value", fill_value, padding_mode))
        self._set_antialias(antialias)

    def matrix_transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        scale, shear = self._param_generator.scale_columns, ("shear_x", "shear_y")
        return [Transform.affine(center_of(shape), angle="angle", translation="translations", scale=scale, shear=shear)]


class RandomRotation(GeometricAugmentationBase2D):
    """Rotate images about their center.

    Args:
        degrees: angle, positive counter-clockwise: a number s for -s to s, or a pair.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        same_on_batch: all samples get the same parameters.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.
        padding_mode: values out of bounds: 'zeros', 'border' or 'reflection'.
        fill: value out of bounds, in place of 0: a number, or one of each channel; in [0, 1] for bytes.
        expand: results have the size of the largest rotated image of a batch, with the others in the middle.

    Raises:
        TypeError, ValueError: `degrees` does not have the form in Args, or is not within -360 and 360; `fill` with another
            `padding_mode` than 'zeros' or 'fill'.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomRotation((90.0, 90.0), p=1.0)(torch.tensor([[[[1.0, 2.0], [3.0, 4.0]]]]))
        tensor([[[[2., 4.],
                  [1., 3.]]]])
    """

    def __init__(
        self,
        degrees: Numbers,
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = True,
        p: float = 0.5,
        keepdim: bool = False,
        *,
        padding_mode: AnySamplePadding = SamplePadding.ZEROS.name,
        fill: Numbers | None = None,
        expand: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = PlainUniformGenerator((degrees, "degrees", 0.0, (-360.0, 360.0)), op="RandomRotation")
        self.flags = _flags(resample, padding_mode, align_corners)
        if fill is not None:
            self.flags.update(_fill_flags("RandomRotation", "fill", fill, padding_mode))
        self.replays_lists = _check.switch("RandomRotation", "expand", expand)
        self.has_known_size = not self.replays_lists

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform] | None:
        return self._rotation(center_of(shape)) if self.has_known_size else None

    @staticmethod
    def _rotation(center: Any, angle: Any = "degrees") -> Sequence[Transform]:
        return [Transform.affine(center, angle=angle)]

    # --- results of another size, which depends on the angles ---

    def _canvas(self, execution: Execution) -> tuple[int, int]:
        """The height and width of the largest rotated image, from angles that the host draws again."""
        refuse_graphs(type(self).__name__)
        refuse_capture(type(self).__name__)
        height, width = execution.shape[-2:]
        sides = _rotated_sides(height, width, self._read_params(execution)["degrees"], execution.chosen)
        h, w = sides.amax(0).tolist() if len(sides) else (height, width)
        return h, w

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return super()._operates_on(dtype) if self.has_known_size else not self._is_customized()

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        if self.has_known_size:
            return super()._run_list(images, execution)
        like = like_batch(images)
        matrix, size = self._motion_of_list(sizes(images), execution, like)
        resampling = self.resampling(self.flags)
        resampling = resampling._replace(fill=fill_of_images(like, resampling.fill))
        return warp_to_sizes(list(images), matrix, size, resampling)

    def _motion_of_list(self, sides: Sequence[int], execution: Execution, like: Tensor) -> tuple[Tensor, list[int]]:
        """Matrices (B, 3, 3) for height and width of each image, and those of results, like a tensor."""
        chosen = execution.chosen
        if execution.params is None:
            angles, own = self._values_on_host(execution)[:, 0], self._columns_on_host(execution)
            on_host = None if own is None or own.chosen is None else own.chosen > 0.5
        else:
            angles, on_host = execution.params["degrees"], chosen
        before = torch.tensor(sides, dtype=torch.float64, device="cpu").view(-1, 2)
        height, width = before.unbind(1)
        rotated = _rotated_sides(height, width, angles, on_host)
        numbers = torch.cat([angles[:, None], (before.flip(1) - 1) / 2, (rotated - before).flip(1) / 2], 1)
        columns = rows_on_device(numbers, like, compute_dtype(like))
        matrix = transform_matrix(columns, self._rotation((Column(1), Column(2)), Column(0)))
        matrix = matrix + torch.nn.functional.pad(columns[:, 3:, None], (2, 0, 0, 1))
        if chosen is not None:
            matrix = torch.where(chosen[:, None, None], matrix, torch.eye(3, dtype=matrix.dtype, device=matrix.device))
        return matrix, rotated.flatten().tolist()

    def _size_of(self, execution: Execution, flags: dict[str, Any]) -> Sequence[int]:
        return super()._size_of(execution, flags) if self.has_known_size else self._canvas(execution)

    def _matrix_of(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if self.has_known_size:
            return super()._matrix_of(x, execution, flags)
        if execution.columns is None:
            angles = self._params_on_device(x, execution)["degrees"][:, None]
        else:
            angles = execution.columns.values
        dtype = compute_dtype(x) if execution.identity is None else execution.identity[1]
        chain = self._bound(self._rotation(center_of(execution.shape)), None)
        rotation = transform_matrix(angles.to(x.device, dtype), chain)
        (height, width), (h, w) = execution.shape[-2:], self._canvas(execution)
        middle = constant(((w - width) / 2, (h - height) / 2), rotation)
        moved = rotation + torch.nn.functional.pad(middle[:, None], (2, 0, 0, 1))
        if execution.chosen is None:
            return moved
        whole = torch.eye(3, dtype=dtype, device=x.device)
        whole = whole + torch.nn.functional.pad(middle.floor()[:, None], (2, 0, 0, 1))
        return torch.where(execution.chosen[:, None, None], moved, whole)

    def _run(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if self.has_known_size or not execution.applied or self._is_customized():
            return super()._run(x, execution, flags)
        execution.matrix = self._matrix_of(x, execution, flags)
        return warp(x, execution.matrix, self._canvas(execution), self.resampling(flags))

    @property
    def _warps_masks(self) -> bool:
        return type(self).transform_masks is RandomRotation.transform_masks

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if self.has_known_size or not execution.applied:
            return super().transform_masks(masks, execution, flags)
        resampling = self.resampling(flags).for_labels(fill=flags.get("mask_fill"))
        return warp_labels(masks, self._matrix(execution), self._canvas(execution), resampling)


def _rotated_sides(height: Any, width: Any, degrees: Tensor, chosen: Tensor | None) -> Tensor:
    """Height and width (B, 2) around images rotated by angles (B,), or around those that are not chosen."""
    angles = torch.deg2rad(degrees.double())
    if chosen is not None:
        angles = torch.where(chosen.to(angles.device), angles, 0)
    cos, sin = angles.cos().abs(), angles.sin().abs()
    # Quarter turns are exact up to rounding.
    return torch.stack([height * cos + width * sin, height * sin + width * cos], 1).sub(1e-6).ceil().int()


class RandomShear(GeometricAugmentationBase2D):
    """Shear images about their center.

    Args:
        shear: degrees: a number s for -s to s along x, a pair along x, or four numbers, a pair for x and one for y.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        same_on_batch: all samples get the same parameters.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.
        padding_mode: values out of bounds: 'zeros', 'border' or 'reflection'.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: `shear` does not have the form in Args, or is not within -360 and 360.

    Example:
        >>> import torch, kvision as K
        >>> shear = K.augmentation.RandomShear((45.0, 45.0), p=1.0)
        >>> shear(torch.tensor([[[[1.0, 2, 3], [4, 5, 6], [7, 8, 9]]]]))
        tensor([[[[0., 1., 2.],
                  [4., 5., 6.],
                  [8., 9., 0.]]]])
    """

    def __init__(
        self,
        shear: NumbersOfAxes,
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        padding_mode: AnySamplePadding = SamplePadding.ZEROS.name,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = ShearGenerator(shear)
        self.flags = _flags(resample, padding_mode, align_corners)

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        return [Transform.affine(center_of(shape), shear=("shear_x", "shear_y"))]


class RandomTranslate(GeometricAugmentationBase2D):
    """Shift images.

    Args:
        translate_x: a pair, as fractions of the width; None for no shift.
        translate_y: a pair, as fractions of the height; None for no shift.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        same_on_batch: all samples get the same parameters.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.
        padding_mode: values out of bounds: 'zeros', 'border' or 'reflection'.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is not within -1 and 1.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomTranslate((0.5, 0.5), p=1.0)(torch.tensor([[[[1.0, 2, 3, 4]]]]))
        tensor([[[[0., 0., 1., 2.]]]])
    """

    def __init__(
        self,
        translate_x: Numbers | None = None,
        translate_y: Numbers | None = None,
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        padding_mode: AnySamplePadding = SamplePadding.ZEROS.name,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = TranslateGenerator(translate_x, translate_y)
        self.flags = _flags(resample, padding_mode, align_corners)

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        return [Transform.affine(center_of(shape), translation=("translate_x", "translate_y"))]


class _Rotation90Generator(RandomGeneratorBase):
    """Draws a number of quarter turns."""

    fields = (("angle", 0),)

    def __init__(self, times: Numbers) -> None:
        super().__init__()
        values = times.tolist() if hasattr(times, "tolist") else times
        if not isinstance(values, (tuple, list)) or len(values) != 2 or any(v != int(v) for v in values):
            raise TypeCheckError(f"RandomRotation90: expected times to be a pair of ints, got {times!r}")
        low, high = (int(v) for v in values)
        if not -3 <= low <= high <= 3:
            raise ValueCheckError(f"RandomRotation90: expected times in ascending order within -3 and 3, got {times!r}")
        self._times = low, high

    # The columns are angles, the parameters quarter turns.

    def draws(self, shape: Sequence[int]) -> Sequence[Draw]:
        low, high = self._times
        return [Draw("integer", (90 * low, 90, high - low + 1, 0))]

    def to_params(self, columns: Any, shape: Sequence[int]) -> dict[str, Any]:
        return {"times": columns[:, 0] / 90}

    def to_columns(self, params: dict[str, Any], shape: Sequence[int]) -> Any:
        return params["times"][:, None] * 90


class RandomRotation90(GeometricAugmentationBase2D):
    """Rotate images by multiples of 90 degrees about their center; square images exactly.

    Args:
        times: lowest and highest number of quarter turns counter-clockwise, within -3 and 3.
        resample: 'nearest', 'bilinear' or 'bicubic', for images whose sides differ by an odd number.
        same_on_batch: all samples get the same parameters.
        align_corners: accepted for code written for Kornia; pixels outside of the image are 0.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError: `times` is not a pair of ints.
        ValueError: `times` is not ascending, or not within -3 and 3.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomRotation90((1, 1), p=1.0)(torch.tensor([[[[1.0, 2.0], [3.0, 4.0]]]]))
        tensor([[[[2., 4.],
                  [1., 3.]]]])
    """

    def __init__(
        self,
        times: Numbers,
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = True,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = _Rotation90Generator(times)
        self.flags = {"resample": Resample.get(resample), "align_corners": align_corners}

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        return [Transform.affine(center_of(shape), angle="angle")]


def _flags(resample: Any, padding_mode: Any, align_corners: bool) -> dict[str, Any]:
    return {
        "resample": Resample.get(resample),
        "padding_mode": SamplePadding.get(padding_mode),
        "align_corners": align_corners,
    }


def _fill_flags(op: str, name: str, value: Any, padding_mode: Any) -> dict[str, Any]:
    """The flags of a value out of bounds, which replaces the default of 0; raise beside another padding mode."""
    if SamplePadding.get(padding_mode) not in (SamplePadding.ZEROS, SamplePadding.FILL):
        raise ValueCheckError(f"{op}: expected padding_mode 'fill' with {name}, got {padding_mode!r}")
    return {"padding_mode": SamplePadding.FILL, "fill_value": ranges.fill(op, name, value)}
