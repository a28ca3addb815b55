"""Generators of augmentations of volumes. Points and shifts are (x, y, z), sizes (depth, height, width)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._constants import constant
from kvision.augmentation import ranges
from kvision.augmentation.draws import Draw, uniform
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.random_generator.filters import MotionBlurGenerator
from kvision.augmentation.ranges import Numbers, NumbersOfAxes
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.geometry import bbox

__all__ = [
    "AffineGenerator3D",
    "CropGenerator3D",
    "MotionBlurGenerator3D",
    "PerspectiveGenerator3D",
    "ResizeGenerator3D",
    "ResizedCropGenerator3D",
    "RotationGenerator3D",
    "center_crop_generator3d",
]

_FULL_ROTATION = (-360.0, 360.0)
_SHEARS = ("sxy", "sxz", "syx", "syz", "szx", "szy")


class AffineGenerator3D(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomAffine3D`.

    Args:
        degrees: the axis of rotation times the angle: a number s for -s to s along x, y and z, a pair, or three of either.
        translate: largest shifts along x, y and z, as fractions of width, height and depth.
        scale: a pair, for one factor a sample; or three pairs, for x, y and z.
        shears: degrees: a number s for -s to s, a pair, or six of either for xy, xz, yx, yz, zx and zy.

    Returns:
        translations (B, 3) in voxels, center, scale and angles (B, 3); sxy, sxz, syx, syz, szx and szy (B,) in degrees.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import kvision as K
        >>> params = K.augmentation.random_generator.AffineGenerator3D(10.0)((1, 3, 4, 6, 8))
        >>> params["center"]
        tensor([[3.5000, 2.5000, 1.5000]])
    """

    fields = (("translations", 3), ("scale", 3), ("angles", 3), *((name, 0) for name in _SHEARS))

    def __init__(
        self,
        degrees: NumbersOfAxes,
        translate: NumbersOfAxes | None = None,
        scale: NumbersOfAxes | None = None,
        shears: NumbersOfAxes | None = None,
    ) -> None:
        super().__init__()
        op = "RandomAffine3D"
        degrees, translate, scale, shears = ranges.keep_parameters(
            self, degrees=degrees, translate=translate, scale=scale, shears=shears
        )
        zero, one = ranges.Range(0.0, 0.0), ranges.Range(1.0, 1.0)
        self._angles = ranges.parse_each(op, "degrees", degrees, 3, center=0.0, bounds=_FULL_ROTATION)
        self._translate = [zero] * 3
        if translate is not None:
            if not hasattr(translate, "__len__") or len(translate) != 3:
                raise ValueCheckError(f"{op}: expected translate to be three numbers, got {translate!r}")
            self._translate = ranges.parse_each(op, "translate", translate, 3, center=0.0, bounds=(-1.0, 1.0))
        self._scale = [one] * 3
        if scale is not None:
            self._scale = ranges.pairs(op, "scale", scale, 3, bounds=(0.0, float("inf")))
        self._one_scale = self._scale[0] is self._scale[1]
        self._shears = [zero] * 6
        if shears is not None:
            self._shears = ranges.parse_each(op, "shears", shears, 6, center=0.0, bounds=_FULL_ROTATION)

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [
            *(r.uniform(float(n)) for r, n in zip(self._translate, reversed(shape[-3:]))),
            *(r.uniform(identity=1.0) for r in self._scale),
            *(r.uniform() for r in (*self._angles, *self._shears)),
        ]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        params = super().to_params(columns, shape)
        if self._one_scale:
            params["scale"] = params["scale"][:, :1].expand(-1, 3)
        center = constant(tuple((n - 1) / 2 for n in reversed(shape[-3:])), columns)
        return {**params, "center": center.repeat(columns.shape[0], 1)}


class RotationGenerator3D(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomRotation3D`.

    Args:
        degrees: the axis of rotation times the angle: a number s for -s to s along x, y and z, a pair, or three of either.

    Returns:
        yaw, pitch and roll (B,) in degrees, along x, y and z.

    Raises:
        TypeError, ValueError: `degrees` does not have the form in Args, or is not within -360 and 360.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.RotationGenerator3D(((1.0, 1.0), (2.0, 2.0), (3.0, 3.0)))((1, 1, 4, 4, 4))
        {'yaw': tensor([1.]), 'pitch': tensor([2.]), 'roll': tensor([3.])}
    """

    fields = (("yaw", 0), ("pitch", 0), ("roll", 0))

    def __init__(self, degrees: NumbersOfAxes) -> None:
        super().__init__()
        (degrees,) = ranges.keep_parameters(self, degrees=degrees)
        self._angles = ranges.parse_each("RandomRotation3D", "degrees", degrees, 3, center=0.0, bounds=_FULL_ROTATION)

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [r.uniform() for r in self._angles]


class PerspectiveGenerator3D(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomPerspective3D`.

    Args:
        distortion_scale: how far a corner moves inward at most, as a fraction of half of width, height and depth.

    Returns:
        start_points and end_points (B, 8, 3): the corners of the volume and where they go, the front four clockwise from
        top left, then the back four. An axis of one voxel has corners at 0 and 1, which stay.

    Raises:
        TypeError: `distortion_scale` is not a number.
        ValueError: `distortion_scale` is not within 0 and 1.

    Example:
        >>> import kvision as K
        >>> params = K.augmentation.random_generator.PerspectiveGenerator3D(0.5)((1, 3, 4, 6, 8))
        >>> params["start_points"][0, 6]
        tensor([7., 5., 3.])
    """

    def __init__(self, distortion_scale: float | Tensor = 0.5) -> None:
        super().__init__()
        pair = [float(distortion_scale)] * 2
        self.distortion_scale = ranges.parse("RandomPerspective3D", "distortion_scale", pair, bounds=(0.0, 1.0)).low

    def draws(self, shape: Shape) -> Sequence[Draw]:
        draws = []
        for corner in corners(shape).tolist():
            for coordinate, n in zip(corner, reversed(shape[-3:])):
                most = self.distortion_scale * n / 2 if n > 1 else 0.0
                low, high = (coordinate, coordinate + most) if coordinate == 0 else (coordinate - most, coordinate)
                draws.append(uniform(low, high, coordinate))
        return draws

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        start = constant(tuple(map(tuple, corners(shape).tolist())), columns)
        return {"start_points": start.repeat(columns.shape[0], 1, 1), "end_points": columns.reshape(-1, 8, 3)}

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        return params["end_points"].reshape(-1, 24)


def corners(shape: Shape) -> Tensor:
    """(8, 3), the corners of a volume: the front four clockwise from top left, then the back four."""
    far = torch.tensor([float(max(n - 1, 1)) for n in reversed(shape[-3:])], device="cpu")
    return bbox.corners(torch.zeros(3, device="cpu"), far)


def parse_size3d(op: str, size: Any) -> tuple[int, int, int]:
    """Depth, height and width of a crop: three ints, or one for all."""
    size = _check.scalars(op, "size", size.tolist() if isinstance(size, Tensor) else size)
    sides = (size,) * 3 if isinstance(size, int) else size
    if not isinstance(sides, (tuple, list)) or len(sides) != 3 or any(type(n) is not int for n in sides):
        raise TypeCheckError(f"{op}: expected size to be an int or (depth, height, width), got {size!r}")
    if min(sides) < 1:
        raise ValueCheckError(f"{op}: expected size of at least one voxel, got {size!r}")
    if max(sides) > _check.LARGEST_INT:
        raise ValueCheckError(f"{op}: expected size of less than 2^31, got {size!r}")
    return sides[0], sides[1], sides[2]


def box_params3d(first: Tensor, size: Sequence[int] | Tensor, output_size: Sequence[int]) -> dict[str, Tensor]:
    """Boxes of a size by their corners, both ends inclusive: `src` in the volume, `dst` in the result.

    `first` (B, 3) are the first voxels as (x, y, z), the sizes are (depth, height, width); those of each box are (B, 3) as (x,
    y, z).
    """

    def last(sides: Sequence[int]) -> Tensor:
        return constant(tuple(n - 1 for n in reversed(sides)), first)

    zero = torch.zeros_like(first)
    return {
        "src": bbox.corners(first, first + (size - 1 if isinstance(size, Tensor) else last(size))),
        "dst": bbox.corners(zero, zero + last(output_size)),
        "output_size": constant(tuple(output_size), first, torch.int64).repeat(first.shape[0], 1),
    }


class CropGenerator3D(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomCrop3D`.

    Args:
        size: depth, height and width of the crop; an int for all.
        resize_to: accepted for code written for Kornia: size of the result; default: `size`.

    Returns:
        src and dst (B, 8, 3), corners with both ends inclusive, in the padded volume; output_size (B, 3).

    Raises:
        TypeError: `size` is not one or three ints.
        ValueError: a size below 1; in a call, the crop is larger than the volumes.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.CropGenerator3D((2, 3, 4))((1, 1, 2, 3, 4))["src"][0, 6]
        tensor([3., 2., 1.])
    """

    def __init__(self, size: Any, resize_to: tuple[int, int, int] | None = None) -> None:
        super().__init__()
        self.size = parse_size3d("RandomCrop3D", size)
        self.resize_to = None if resize_to is None else parse_size3d("RandomCrop3D", resize_to)
        # Left, right, top, bottom, front, back, around volumes of a shape: RandomCrop3D sets it.
        self.padding_of: Any = lambda shape: (0,) * 6

    def draws(self, shape: Shape) -> Sequence[Draw]:
        padding, draws = self.padding_of(shape), []
        for axis, (n, side) in enumerate(zip(reversed(shape[-3:]), reversed(self.size))):
            free = padding[2 * axis] + n + padding[2 * axis + 1] - side
            if free < 0:
                got = tuple(shape[-3:])
                raise ValueCheckError(
                    f"RandomCrop3D: expected volumes of at least {self.size}, got {got}; use pad_if_needed"
                )
            draws.append(Draw("integer", (0, 1, free + 1, 0)))
        return draws

    # The columns are the first voxel of the crop in the padded volume.

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        return box_params3d(columns, self.size, self.resize_to or self.size)

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        return params["src"][:, 0]


class ResizedCropGenerator3D(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomResizedCrop3D`.

    Args:
        output_size: depth, height and width of the result; an int for all.
        scale: range of the volume of a box, as a fraction of the whole.
        ratio: range of width / height of a box, and of depth / sqrt(width * height), each as fractions of the volume's.

    Returns:
        src and dst (B, 8, 3), corners with both ends inclusive; output_size (B, 3).

    Raises:
        TypeError: `output_size` is not one or three ints.
        ValueError: a size below 1; a range does not have the form in Args, or is not above 0; `scale` is above 1.

    Example:
        >>> import kvision as K
        >>> draw = K.augmentation.random_generator.ResizedCropGenerator3D(2, (0.125, 0.125), (1.0, 1.0))
        >>> src = draw((1, 1, 4, 6, 8))["src"][0]
        >>> src[6] - src[0]
        tensor([3., 2., 1.])
    """

    def __init__(self, output_size: Any, scale: Numbers = (0.08, 1.0), ratio: Numbers = (3.0 / 4.0, 4.0 / 3.0)) -> None:
        super().__init__()
        op = "RandomResizedCrop3D"
        self.output_size = parse_size3d(op, output_size)
        self.scale = ranges.parse(op, "scale", scale, bounds=(0.0, 1.0))
        self.ratio = ranges.parse(op, "ratio", ratio, bounds=(0.0, float("inf")))
        if self.ratio.low <= 0:
            raise ValueCheckError(f"{op}: expected ratio above 0, got {ratio}")

    def draws(self, shape: Shape) -> Sequence[Draw]:
        aspect = Draw("exponential_of_uniform", (math.log(self.ratio.low), math.log(self.ratio.high), 1.0))
        return [uniform(self.scale.low, self.scale.high, 1.0), aspect, aspect, *[uniform(0.0, 1.0)] * 3]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        # In float64, so that devices round to the same voxels.
        volume, across, along, *_ = columns.double().unbind(1)
        side = (volume / along) ** (1 / 3)
        fractions = torch.stack([side * across.sqrt(), side / across.sqrt(), side * along], 1)
        whole = constant(tuple(reversed(shape[-3:])), columns, torch.float64)
        sides = torch.minimum((fractions * whole).round().clamp(min=1), whole)
        first = torch.minimum((columns[:, 3:].double() * (whole - sides + 1)).floor(), whole - sides)
        return box_params3d(first.to(columns.dtype), sides.to(columns.dtype), self.output_size)


class ResizeGenerator3D(RandomGeneratorBase):
    """The parameters of :class:`Resize3D`, which draws nothing.

    Args:
        size: depth, height and width of the result; an int for all.

    Returns:
        src and dst (B, 8, 3), corners with both ends inclusive; output_size (B, 3).

    Raises:
        TypeError: `size` is not one or three ints.
        ValueError: a size below 1.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.ResizeGenerator3D(2)((1, 1, 4, 6, 8))["src"][0, 6]
        tensor([7., 5., 3.])
    """

    def __init__(self, size: Any) -> None:
        super().__init__()
        self.size = parse_size3d("Resize3D", size)

    def draws(self, shape: Shape) -> Sequence[Draw]:
        return []

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        return box_params3d(columns.new_zeros(shape[0], 3), tuple(shape[-3:]), self.size)

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        return torch.empty(shape[0], 0, device="cpu")


def center_crop_generator3d(
    batch_size: int,
    depth: int,
    height: int,
    width: int,
    size: tuple[int, int, int],
    device: torch.device | str | None = None,
) -> dict[str, Tensor]:
    """Corners of the centered crop of each volume, as :class:`CenterCrop3D` takes it.

    Args:
        batch_size: number of volumes.
        depth: of the volumes.
        height: of the volumes.
        width: of the volumes.
        size: depth, height and width of the crop.
        device: of the result; default: the CPU.

    Returns:
        src and dst (B, 8, 3), corners with both ends inclusive; output_size (B, 3).

    Raises:
        TypeError: `size` is not one or three ints.
        ValueError: a size below 1.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.center_crop_generator3d(1, 4, 6, 8, (2, 2, 2))["src"][0, 0]
        tensor([3, 2, 1])
    """
    size = parse_size3d("center_crop_generator3d", size)
    first = torch.tensor(center_corner((depth, height, width), size), device=device)
    return box_params3d(first.expand(batch_size, 3), size, size)


def center_corner(shape: Shape, size: Sequence[int]) -> list[int]:
    """The first voxel (x, y, z) of the centered crop of volumes (*, D, H, W)."""
    return [(n - side) // 2 for n, side in zip(reversed(shape[-3:]), reversed(size))]


class MotionBlurGenerator3D(MotionBlurGenerator):
    """Draws the parameters of :class:`RandomMotionBlur3D`.

    Args:
        kernel_size: length of the line, odd and at least 3, or a pair of lowest and highest.
        angle: the axis of rotation times the angle in degrees: a number a for -a to a along x, y and z, a pair, or three
            of either.
        direction: a number d for -d to d, or a pair, within -1 and 1.

    Returns:
        ksize_factor (B,), int32, the same for all samples; angle_factor (B, 3) and direction_factor (B,).

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds; an even size.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.MotionBlurGenerator3D(3, 35.0, 0.5)((2, 3, 8, 8, 8))["angle_factor"].shape
        torch.Size([2, 3])
    """

    op = "RandomMotionBlur3D"

    def __init__(self, kernel_size: int | tuple[int, int], angle: NumbersOfAxes, direction: Numbers) -> None:
        super().__init__(kernel_size, 0.0, direction)
        (angle,) = ranges.keep_parameters(self, angle=angle)
        self._angles = ranges.parse_each(self.op, "angle", angle, 3, center=0.0, bounds=_FULL_ROTATION)

    def draws(self, shape: Shape) -> Sequence[Any]:
        size, _, direction = super().draws(shape)
        return [size, *(r.uniform() for r in self._angles), direction]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {
            "ksize_factor": self._size_of_batch(columns),
            "angle_factor": columns[:, 1:4],
            "direction_factor": columns[:, 4],
        }

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        angle = params["angle_factor"]
        return torch.cat([params["ksize_factor"][:, None].to(angle), angle, params["direction_factor"][:, None]], 1)
