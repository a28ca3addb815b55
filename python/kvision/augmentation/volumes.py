"""Random augmentations of volumes (B, C, D, H, W). Points and matrices are (x, y, z), sizes (depth, height, width)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from kvision import enhance, filters
from kvision._constants import constant
from kvision.augmentation.base import Params, Shape
from kvision.augmentation.crop import padding_resampling
from kvision.augmentation.filters import OneKernelSize, border_name
from kvision.augmentation.geometric3d_base import GeometricAugmentationBase3D
from kvision.augmentation.geometric_base import Resampling
from kvision.augmentation.intensity_base import IntensityAugmentationBase3D
from kvision.augmentation.random_generator.base import RandomGeneratorBase
from kvision.augmentation.random_generator.volumes import (
    AffineGenerator3D,
    CropGenerator3D,
    MotionBlurGenerator3D,
    PerspectiveGenerator3D,
    RotationGenerator3D,
    box_params3d,
    center_corner,
    parse_size3d,
)
from kvision.constants import BorderType, Resample
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.geometry.transform import get_affine_matrix3d, matrices

__all__ = [
    "CenterCrop3D",
    "RandomAffine3D",
    "RandomCrop3D",
    "RandomDepthicalFlip3D",
    "RandomEqualize3D",
    "RandomHorizontalFlip3D",
    "RandomMotionBlur3D",
    "RandomPerspective3D",
    "RandomRotation3D",
    "RandomVerticalFlip3D",
]


# --- warps ----------------------------------------------------------------------------------------------------------


class RandomAffine3D(GeometricAugmentationBase3D):
    """Shear, scale, rotate and shift volumes about their center; voxels outside of the volume are 0.

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
        degrees: Any,
        translate: Any = None,
        scale: Any = None,
        shears: Any = None,
        resample: str | int | Resample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = AffineGenerator3D(degrees, translate, scale, shears)
        self.flags = {"resample": _resample("RandomAffine3D", resample), "align_corners": align_corners}

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        placement = [params[name] for name in ("translations", "center", "scale", "angles")]
        shears = [torch.deg2rad(params[name]) for name in ("sxy", "sxz", "syx", "syz", "szx", "szy")]
        return get_affine_matrix3d(*placement, *shears)


class RandomRotation3D(GeometricAugmentationBase3D):
    """Rotate volumes about their center; voxels outside of the volume are 0.

    Yaw, pitch and roll are the axis of rotation times the angle along x, y and z, not three rotations one after another. A
    positive roll rotates a displayed slice clockwise, as `geometry.rotate3d` does.

    Args:
        degrees: a number s for -s to s along x, y and z, a pair, or three of either.
        resample: 'nearest' or 'bilinear'.
        same_on_batch: all samples get the same parameters.
        align_corners: accepted for code written for Kornia.
        p: probability that a sample is augmented.
        keepdim: a volume (C, D, H, W) gives a volume (C, D, H, W) instead of a batch of one.

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
        degrees: Any,
        resample: str | int | Resample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = RotationGenerator3D(degrees)
        self.flags = {"resample": _resample("RandomRotation3D", resample), "align_corners": align_corners}

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        center = [(n - 1) / 2 for n in reversed(input.shape[2:])]
        angles = params["yaw"], params["pitch"], params["roll"]
        # No translation, scale, center or shears.
        return matrices.affine_matrix3d(*angles, *[None] * 9, 1.0, *center, 4)


class RandomPerspective3D(GeometricAugmentationBase3D):
    """Move the corners of volumes, which changes the perspective; voxels outside of the volume are 0.

    Args:
        distortion_scale: how far a corner moves inward at most, as a fraction of half of width, height and depth.
        resample: 'nearest' or 'bilinear'.
        same_on_batch: all samples get the same parameters.
        align_corners: accepted for code written for Kornia.
        p: probability that a sample is augmented.
        keepdim: a volume (C, D, H, W) gives a volume (C, D, H, W) instead of a batch of one.

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
        resample: str | int | Resample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = PerspectiveGenerator3D(distortion_scale)
        self.flags = {"resample": _resample("RandomPerspective3D", resample), "align_corners": align_corners}

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        start, end = params["start_points"], params["end_points"]
        if input.shape[-1] == 1:
            # The formula uses corners 0, 1, 2, 5 and 7, two of them at x = 0. Three have to hold a plane of one voxel.
            order = [0, 4, 7, 3, 1, 5, 6, 2] if input.shape[-3] > 1 else [0, 3, 2, 1, 4, 7, 6, 5]
            start, end = start[:, order], end[:, order]
        return matrices.perspective_matrix3d(start.contiguous(), end.contiguous(), 0.0, 0.0, 0.0)


def _resample(op: str, resample: str | int | Resample) -> Resample:
    mode = Resample.get(resample)
    if mode not in (Resample.NEAREST, Resample.BILINEAR):
        raise ValueCheckError(f"{op}: expected resample to be 'nearest' or 'bilinear', got {resample!r}")
    return mode


# --- flips ----------------------------------------------------------------------------------------------------------


class _RandomFlip3D(GeometricAugmentationBase3D):
    moves_whole_voxels = True
    axis: int  # 0 is x

    def __init__(self, same_on_batch: bool = False, p: float = 0.5, keepdim: bool = False, **options: Any) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        matrix = torch.eye(4, device=input.device)
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


# --- crops ----------------------------------------------------------------------------------------------------------


class RandomCrop3D(GeometricAugmentationBase3D):
    """Cut boxes of a size out of volumes, after padding them.

    Args:
        size: depth, height and width of the box; an int for all.
        padding: voxels around the volume: a number, three for left and right, top and bottom, front and back, or left,
            right, top, bottom, front, back.
        pad_if_needed: pad smaller volumes on both sides.
        fill: value of padded voxels.
        padding_mode: 'constant', 'reflect', 'replicate' or 'symmetric'.
        resample: accepted for code written for Kornia: boxes begin at voxels, so that nothing is interpolated.
        same_on_batch: all samples get the same box.
        align_corners: accepted for code written for Kornia.
        p: probability that a batch is cropped.
        keepdim: a volume (C, D, H, W) gives a volume (C, d, h, w) instead of a batch of one.

    Raises:
        TypeError: `size` or `padding` does not have the form in Args.
        ValueError: a size below 1; an unknown mode; in a call, volumes smaller than the box without `pad_if_needed`.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomCrop3D((2, 3, 4))(torch.rand(2, 1, 8, 8, 8)).shape
        torch.Size([2, 1, 2, 3, 4])
    """

    whole_batch = moves_whole_voxels = True

    def __init__(
        self,
        size: int | tuple[int, int, int],
        padding: int | tuple[int, ...] | None = None,
        pad_if_needed: bool | None = False,
        fill: float = 0,
        padding_mode: str = "constant",
        resample: str | int | Resample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = True,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=1.0, p_batch=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        generator = CropGenerator3D(size)
        generator.padding_of = self.compute_padding
        self._param_generator = generator
        self.size = generator.size
        self._padding = _six_sides(padding)
        padding_resampling("RandomCrop3D", padding_mode, fill)
        self.flags = {
            "size": self.size,
            "padding": padding,
            "pad_if_needed": pad_if_needed,
            "fill": fill,
            "padding_mode": padding_mode,
            "resample": Resample.get(resample),
            "align_corners": align_corners,
        }

    def compute_padding(self, shape: Shape) -> tuple[int, ...]:
        """Left, right, top, bottom, front and back padding of volumes of a shape."""
        sides = list(self._padding)
        if self.flags["pad_if_needed"]:
            for axis, (n, side) in enumerate(zip(reversed(shape[-3:]), reversed(self.size))):
                missing = max(side - (sides[2 * axis] + n + sides[2 * axis + 1]), 0)
                sides[2 * axis] += missing
                sides[2 * axis + 1] += missing
        return tuple(sides)

    def output_size(self, shape: Shape, flags: dict[str, Any]) -> tuple[int, int, int]:
        return self.size

    def resampling(self, flags: dict[str, Any]) -> Resampling:
        # `apply_transform` pads with the fill value, since warps of volumes fill with 0 only.
        return padding_resampling("RandomCrop3D", flags["padding_mode"], flags["fill"]).for_labels()

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        before = constant(self.compute_padding(tuple(input.shape))[::2], input, torch.float32)
        return _translation(before - params["src"][:, 0])

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        if transform is None:
            transform = self.compute_transformation(input, params, flags)
        if flags["padding_mode"] == "constant" and flags["fill"] != 0:
            padding = self.compute_padding(tuple(input.shape))
            before = constant(tuple(padding[::2]), input, torch.float32)[None]
            input = nn.functional.pad(input, padding, value=flags["fill"])
            transform = transform @ _translation(-before).to(transform)
        return super().apply_transform(input, params, flags, transform)


class _CenterGenerator3D(RandomGeneratorBase):
    """The box of CenterCrop3D, which draws nothing."""

    def __init__(self, size: tuple[int, int, int]) -> None:
        super().__init__()
        self.size = size

    def draws(self, shape: Sequence[int]) -> Sequence[Any]:
        return []

    def to_params(self, columns: Tensor, shape: Sequence[int]) -> dict[str, Tensor]:
        first = torch.tensor(center_corner(shape, self.size), device=columns.device)
        return box_params3d(first.expand(shape[0], 3), self.size, self.size)

    def to_columns(self, params: dict[str, Any], shape: Sequence[int]) -> Tensor:
        return torch.empty(shape[0], 0)


class CenterCrop3D(GeometricAugmentationBase3D):
    """Cut the box of a size out of the middle of volumes; smaller volumes are surrounded by 0.

    Args:
        size: depth, height and width of the box; an int for all.
        align_corners: accepted for code written for Kornia.
        resample: accepted for code written for Kornia: the box begins at a voxel.
        p: probability that a batch is cropped.
        keepdim: a volume (C, D, H, W) gives a volume (C, d, h, w) instead of a batch of one.

    Raises:
        TypeError: `size` is not one or three ints.
        ValueError: a size below 1.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.CenterCrop3D((1, 1, 2))(torch.arange(4.0).reshape(1, 1, 1, 1, 4)).flatten()
        tensor([1., 2.])
    """

    whole_batch = moves_whole_voxels = True

    def __init__(
        self,
        size: int | tuple[int, int, int],
        align_corners: bool = True,
        resample: str | int | Resample = Resample.BILINEAR.name,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=1.0, p_batch=p, same_on_batch=True, keepdim=keepdim, **options)
        self.size = parse_size3d("CenterCrop3D", size)
        self._param_generator = _CenterGenerator3D(self.size)
        self.flags = {"size": self.size, "align_corners": align_corners, "resample": Resample.get(resample)}

    def output_size(self, shape: Shape, flags: dict[str, Any]) -> tuple[int, int, int]:
        return self.size

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        first = constant(tuple(center_corner(tuple(input.shape), self.size)), input, torch.float32)
        return _translation(-first.expand(input.shape[0], 3))


def _translation(shift: Tensor) -> Tensor:
    """(B, 4, 4) that moves voxels by `shift` (B, 3)."""
    matrix = torch.eye(4, device=shift.device, dtype=shift.dtype).repeat(shift.shape[0], 1, 1)
    matrix[:, :3, 3] = shift
    return matrix


def _six_sides(padding: Any) -> tuple[int, ...]:
    """Left, right, top, bottom, front and back from the forms that RandomCrop3D takes."""
    sides = (0,) if padding is None else (padding,) if isinstance(padding, int) else tuple(padding)
    if len(sides) not in (1, 3, 6) or any(type(n) is not int for n in sides):
        raise TypeCheckError(f"RandomCrop3D: expected padding to be one, three or six ints, got {padding!r}")
    return sides if len(sides) == 6 else tuple(n for n in sides for _ in range(6 // len(sides)))


# --- values ---------------------------------------------------------------------------------------------------------


class RandomEqualize3D(IntensityAugmentationBase3D):
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

    accepts_bytes = False

    def __init__(self, p: float = 0.5, same_on_batch: bool = False, keepdim: bool = False, **options: Any) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return enhance.equalize3d(input)


class RandomMotionBlur3D(OneKernelSize, IntensityAugmentationBase3D):
    """Blur volumes along a random line.

    Args:
        kernel_size: length of the line, odd and at least 3, or a pair of lowest and highest; one is drawn for the batch.
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
        angle: Any,
        direction: Any,
        border_type: str | int | BorderType = BorderType.CONSTANT.name,
        resample: str | int | Resample = Resample.NEAREST.name,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator: MotionBlurGenerator3D = MotionBlurGenerator3D(kernel_size, angle, direction)
        self.flags = {"border_type": BorderType.get(border_type), "resample": Resample.get(resample)}

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        size = self._param_generator.size_of(params["ksize_factor"])
        mode, border = Resample.get(flags["resample"]).name.lower(), border_name(flags["border_type"])
        return filters.motion_blur3d(input, size, params["angle_factor"], params["direction_factor"], border, mode)
