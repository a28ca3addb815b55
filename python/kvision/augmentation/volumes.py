"""Random augmentations of volumes (B, C, D, H, W). Points and matrices are (x, y, z), sizes (depth, height, width)."""

from __future__ import annotations

from functools import partial
from typing import Any

import torch
from torch import Tensor

from kvision import enhance, filters
from kvision.augmentation import ranges
from kvision.augmentation.engine import Params
from kvision.augmentation.filters import DrawnKernelSize, border_name
from kvision.augmentation.geometric3d_base import GeometricAugmentationBase3D, parse_resample
from kvision.augmentation.intensity_base import IntensityAugmentationBase3D
from kvision.augmentation.random_generator.volumes import (
    AffineGenerator3D,
    MotionBlurGenerator3D,
    PerspectiveGenerator3D,
    RotationGenerator3D,
)
from kvision.augmentation.ranges import Numbers, NumbersOfAxes
from kvision.constants import AnyBorderType, AnyResample, BorderType, Resample
from kvision.geometry.transform import get_affine_matrix3d, matrices

__all__ = [
    "RandomAffine3D",
    "RandomDepthicalFlip3D",
    "RandomEqualize3D",
    "RandomHorizontalFlip3D",
    "RandomMotionBlur3D",
    "RandomPerspective3D",
    "RandomRotation3D",
    "RandomVerticalFlip3D",
]


# --- warps ----------------------------------------------------------------------------------------------------------


class RandomAffine3D(GeometricAugmentationBase3D, keeps_contract=True):
    """Shear, scale, rotate and shift volumes about their center; voxels from outside of the volume are the fill value.

    The three angles are one axis of rotation times the angle, not three rotations one after another. A positive angle about z
    rotates a displayed slice counter-clockwise, opposite to :class:`RandomRotation3D`.

    Args:
        degrees: a number s for -s to s along x, y and z, a pair, or three of either.
        translate: largest shifts along x, y and z, as fractions of width, height and depth.
        scale: a pair, for one factor a sample; or three pairs, for x, y and z.
        shears: degrees: a number s for -s to s, a pair, or six of either for xy, xz, yx, yz, zx and zy.
        resample: 'nearest' or 'bilinear'.
        same_on_batch: all samples get the same parameters.
        align_corners: accepted for code written for Kornia.
        p: probability that a sample is augmented.
        keepdim: a volume (C, D, H, W) gives a volume (C, D, H, W) instead of a batch of one.
        fill_value: value of voxels from outside, in [0, 1] for bytes: a number, or one of each channel; None for 0.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds; an unknown `resample`.

    Example:
        >>> import torch, kvision as K
        >>> augment = K.augmentation.RandomAffine3D(0.0, scale=(2.0, 2.0), p=1.0)
        >>> augment(torch.tensor([0.0, 1.0, 2.0]).reshape(1, 1, 1, 1, 3)).flatten()
        tensor([0.5000, 1.0000, 1.5000])
    """

    def __init__(
        self,
        degrees: NumbersOfAxes,
        translate: NumbersOfAxes | None = None,
        scale: NumbersOfAxes | None = None,
        shears: NumbersOfAxes | None = None,
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        fill_value: Numbers | None = None,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = AffineGenerator3D(degrees, translate, scale, shears)
        self.flags = {
            "resample": parse_resample("RandomAffine3D", resample),
            "align_corners": align_corners,
            "fill_value": ranges.fill("RandomAffine3D", "fill_value", fill_value),
        }

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        placement = [params[name] for name in ("translations", "center", "scale", "angles")]
        shears = [torch.deg2rad(params[name]) for name in ("sxy", "sxz", "syx", "syz", "szx", "szy")]
        return get_affine_matrix3d(*placement, *shears)


class RandomRotation3D(GeometricAugmentationBase3D, keeps_contract=True):
    """Rotate volumes about their center; voxels from outside of the volume are the fill value.

    Yaw, pitch and roll are the axis of rotation times the angle along x, y and z, not three rotations one after another. A
    positive roll rotates a displayed slice clockwise, as `geometry.rotate3d` does.

    Args:
        degrees: a number s for -s to s along x, y and z, a pair, or three of either.
        resample: 'nearest' or 'bilinear'.
        same_on_batch: all samples get the same parameters.
        align_corners: accepted for code written for Kornia.
        p: probability that a sample is augmented.
        keepdim: a volume (C, D, H, W) gives a volume (C, D, H, W) instead of a batch of one.
        fill_value: value of voxels from outside, in [0, 1] for bytes: a number, or one of each channel; None for 0.

    Raises:
        TypeError, ValueError: `degrees` does not have the form in Args, or is not within -360 and 360; an unknown `resample`.

    Example:
        >>> import torch, kvision as K
        >>> rotate = K.augmentation.RandomRotation3D(((0.0, 0.0), (0.0, 0.0), (90.0, 90.0)), resample="nearest", p=1.0)
        >>> rotate(torch.tensor([[[[[1.0, 2.0], [3.0, 4.0]]]]]))
        tensor([[[[[3., 1.],
                   [4., 2.]]]]])
    """

    def __init__(
        self,
        degrees: NumbersOfAxes,
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        fill_value: Numbers | None = None,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = RotationGenerator3D(degrees)
        self.flags = {
            "resample": parse_resample("RandomRotation3D", resample),
            "align_corners": align_corners,
            "fill_value": ranges.fill("RandomRotation3D", "fill_value", fill_value),
        }

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        center = [(n - 1) / 2 for n in reversed(input.shape[2:])]
        angles = params["yaw"], params["pitch"], params["roll"]
        # No translation, scale, center or shears.
        return matrices.affine_matrix3d(*angles, *[None] * 9, 1.0, *center, 4)


class RandomPerspective3D(GeometricAugmentationBase3D, keeps_contract=True):
    """Move the corners of volumes, which changes the perspective; voxels from outside of the volume are the fill value.

    Args:
        distortion_scale: how far a corner moves inward at most, as a fraction of half of width, height and depth.
        resample: 'nearest' or 'bilinear'.
        same_on_batch: all samples get the same parameters.
        align_corners: accepted for code written for Kornia.
        p: probability that a sample is augmented.
        keepdim: a volume (C, D, H, W) gives a volume (C, D, H, W) instead of a batch of one.
        fill_value: value of voxels from outside, in [0, 1] for bytes: a number, or one of each channel; None for 0.

    Raises:
        TypeError: `distortion_scale` is not a number.
        ValueError: `distortion_scale` is not within 0 and 1; an unknown `resample`.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomPerspective3D(0.5, p=1.0)(torch.rand(2, 1, 4, 6, 8)).shape
        torch.Size([2, 1, 4, 6, 8])
    """

    def __init__(
        self,
        distortion_scale: float | Tensor = 0.5,
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        fill_value: Numbers | None = None,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = PerspectiveGenerator3D(distortion_scale)
        self.flags = {
            "resample": parse_resample("RandomPerspective3D", resample),
            "align_corners": align_corners,
            "fill_value": ranges.fill("RandomPerspective3D", "fill_value", fill_value),
        }

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        start, end = params["start_points"], params["end_points"]
        if input.shape[-1] == 1:
            # The formula uses corners 0, 1, 2, 5 and 7, two of them at x = 0. Three have to hold a plane of one voxel.
            order = [0, 4, 7, 3, 1, 5, 6, 2] if input.shape[-3] > 1 else [0, 3, 2, 1, 4, 7, 6, 5]
            start, end = start[:, order], end[:, order]
        return matrices.perspective_matrix3d(start.contiguous(), end.contiguous(), 0.0, 0.0, 0.0)


# --- flips ----------------------------------------------------------------------------------------------------------


class _RandomFlip3D(GeometricAugmentationBase3D, keeps_contract=True):
    moves_whole_voxels = True
    axis: int  # 0 is x

    def __init__(self, same_on_batch: bool = False, p: float = 0.5, keepdim: bool = False, **options: Any) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        matrix = torch.eye(4, dtype=torch.float32, device=input.device)
        # Assigning numbers to its entries would copy them from the host, and wait.
        matrix[self.axis, self.axis].fill_(-1)
        matrix[self.axis, 3].fill_(input.shape[-1 - self.axis] - 1)
        return matrix.expand(input.shape[0], 4, 4)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return input.flip(-1 - self.axis)


class RandomHorizontalFlip3D(_RandomFlip3D):
    """Flip volumes from left to right.

    Args:
        same_on_batch: all samples are flipped, or none.
        p: probability that a sample is flipped.
        keepdim: a volume (C, D, H, W) gives a volume (C, D, H, W) instead of a batch of one.

    Raises:
        TypeError: `p` is not a number.
        ValueError: `p` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> flip = K.augmentation.RandomHorizontalFlip3D(p=1.0)
        >>> flip(torch.tensor([1.0, 2.0, 3.0]).reshape(1, 1, 1, 1, 3)).flatten()
        tensor([3., 2., 1.])
    """

    axis = 0


class RandomVerticalFlip3D(_RandomFlip3D):
    """Flip volumes upside down.

    Args:
        same_on_batch: all samples are flipped, or none.
        p: probability that a sample is flipped.
        keepdim: a volume (C, D, H, W) gives a volume (C, D, H, W) instead of a batch of one.

    Raises:
        TypeError: `p` is not a number.
        ValueError: `p` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> flip = K.augmentation.RandomVerticalFlip3D(p=1.0)
        >>> flip(torch.tensor([1.0, 2.0, 3.0]).reshape(1, 1, 1, 3, 1)).flatten()
        tensor([3., 2., 1.])
    """

    axis = 1


class RandomDepthicalFlip3D(_RandomFlip3D):
    """Flip volumes from front to back.

    Args:
        same_on_batch: all samples are flipped, or none.
        p: probability that a sample is flipped.
        keepdim: a volume (C, D, H, W) gives a volume (C, D, H, W) instead of a batch of one.

    Raises:
        TypeError: `p` is not a number.
        ValueError: `p` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> flip = K.augmentation.RandomDepthicalFlip3D(p=1.0)
        >>> flip(torch.tensor([1.0, 2.0, 3.0]).reshape(1, 1, 3, 1, 1)).flatten()
        tensor([3., 2., 1.])
    """

    axis = 2


# --- values ---------------------------------------------------------------------------------------------------------


class RandomEqualize3D(IntensityAugmentationBase3D, keeps_contract=True):
    """Spread the values of volumes evenly over [0, 1].

    Args:
        p: probability that a sample is augmented.
        same_on_batch: all samples get the same parameters.
        keepdim: a volume (C, D, H, W) gives a volume (C, D, H, W) instead of a batch of one.

    Raises:
        TypeError: `p` is not a number.
        ValueError: `p` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> dark = torch.rand(1, 1, 16, 16, 16) / 4
        >>> bool(K.augmentation.RandomEqualize3D(p=1.0)(dark).max() > 0.9)
        True
    """

    def __init__(self, p: float = 0.5, same_on_batch: bool = False, keepdim: bool = False, **options: Any) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return enhance.equalize3d(input)


class RandomMotionBlur3D(DrawnKernelSize, IntensityAugmentationBase3D, keeps_contract=True):
    """Blur volumes along a random line.

    Args:
        kernel_size: length of the line, odd and at least 3, or a pair of lowest and highest; one is drawn for the batch, with a
            seed of each sample for each.
        angle: the axis of rotation times the angle in degrees: a number a for -a to a along x, y and z, a pair, or three
            of either.
        direction: a number d for -d to d, or a pair, within -1 and 1: where along the line the weight is.
        border_type: 'constant', 'reflect', 'replicate' or 'circular'.
        resample: 'nearest' or 'bilinear': how the line is rotated.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: a volume (C, D, H, W) gives a volume (C, D, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> blur = K.augmentation.RandomMotionBlur3D(3, (0.0, 0.0), (0.0, 0.0), p=1.0)
        >>> blur(torch.tensor([0.0, 3.0, 0.0]).reshape(1, 1, 1, 1, 3)).flatten()
        tensor([1., 1., 1.])
    """

    accepts_bytes = False

    def __init__(
        self,
        kernel_size: int | tuple[int, int],
        angle: NumbersOfAxes,
        direction: Numbers,
        border_type: AnyBorderType = BorderType.CONSTANT.name,
        resample: AnyResample = Resample.NEAREST.name,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator: MotionBlurGenerator3D = MotionBlurGenerator3D(kernel_size, angle, direction)
        self.flags = {
            "border_type": BorderType.get(border_type),
            "resample": parse_resample("RandomMotionBlur3D", resample),
        }

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        mode: Any = Resample.get(flags["resample"]).name.lower()
        border = border_name(flags["border_type"])
        return self._blurred(input, params, partial(filters.motion_blur3d, border_type=border, mode=mode))
