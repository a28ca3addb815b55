"""Crops and resizing of volumes (B, C, D, H, W). Points and matrices are (x, y, z), sizes (depth, height, width)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._constants import constant
from kvision._dtype import compute_dtype
from kvision.augmentation import ranges
from kvision.augmentation.crops.crop import PadMode, padding_resampling
from kvision.augmentation.engine import Params, Shape
from kvision.augmentation.geometric3d_base import GeometricAugmentationBase3D, parse_resample
from kvision.augmentation.random_generator.base import RandomGeneratorBase
from kvision.augmentation.random_generator.crop import PaddingOf, parse_padding
from kvision.augmentation.random_generator.volumes import (
    CropGenerator3D,
    ResizedCropGenerator3D,
    ResizeGenerator3D,
    box_params3d,
    center_corner,
    parse_size3d,
)
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.warp_and_color import Resampling
from kvision.constants import AnyResample, Resample

__all__ = ["CenterCrop3D", "RandomCrop3D", "RandomResizedCrop3D", "Resize3D"]


class RandomCrop3D(GeometricAugmentationBase3D, keeps_contract=True):
    """Cut boxes of a size out of volumes, after padding them.

    Args:
        size: depth, height and width of the box; an int for all.
        padding: voxels around the volume: a number, three for left and right, top and bottom, front and back, or left,
            right, top, bottom, front, back.
        pad_if_needed: pad smaller volumes on both sides.
        fill: value of padded voxels, in [0, 1] for bytes: a number, or one of each channel.
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
        fill: Numbers = 0,
        padding_mode: PadMode = "constant",
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = True,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=1.0, p_batch=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        generator = CropGenerator3D(size)
        generator.padding_of = PaddingOf(self)
        self._param_generator = generator
        self.size = generator.size
        self._padding = _six_sides(padding)
        padding_resampling("RandomCrop3D", padding_mode, ranges.fill("RandomCrop3D", "fill", fill))
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
        return padding_resampling("RandomCrop3D", flags["padding_mode"], flags["fill"])

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        before = constant(self.compute_padding(tuple(input.shape))[::2], input, torch.float32)
        return _translation(before - params["src"][:, 0])


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
        return torch.empty(shape[0], 0, device="cpu")


class CenterCrop3D(GeometricAugmentationBase3D, keeps_contract=True):
    """Cut the box of a size out of the middle of volumes; smaller volumes are surrounded by the fill value.

    Args:
        size: depth, height and width of the box; an int for all.
        align_corners: accepted for code written for Kornia.
        resample: accepted for code written for Kornia: the box begins at a voxel.
        p: probability that a batch is cropped.
        keepdim: a volume (C, D, H, W) gives a volume (C, d, h, w) instead of a batch of one.
        fill_value: value of voxels from outside, in [0, 1] for bytes: a number, or one of each channel; None for 0.

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
        resample: AnyResample = Resample.BILINEAR.name,
        p: float = 1.0,
        keepdim: bool = False,
        fill_value: Numbers | None = None,
        **options: Any,
    ) -> None:
        super().__init__(p=1.0, p_batch=p, same_on_batch=True, keepdim=keepdim, **options)
        self.size = parse_size3d("CenterCrop3D", size)
        self._param_generator = _CenterGenerator3D(self.size)
        self.flags = {
            "size": self.size,
            "align_corners": align_corners,
            "resample": Resample.get(resample),
            "fill_value": ranges.fill("CenterCrop3D", "fill_value", fill_value),
        }

    def output_size(self, shape: Shape, flags: dict[str, Any]) -> tuple[int, int, int]:
        return self.size

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        first = constant(tuple(center_corner(tuple(input.shape), self.size)), input, torch.float32)
        return _translation(-first.expand(input.shape[0], 3))


class _ResizedBox3D(GeometricAugmentationBase3D, keeps_contract=True):
    """A box of volumes, by the corners of its parameters, that becomes all of the result."""

    whole_batch = True
    size: tuple[int, int, int]

    def _corners(self, input: Tensor, params: Params) -> tuple[Tensor, Tensor]:
        """The first and the last voxel (x, y, z) of each box, (B, 3)."""
        return params["src"][:, 0], params["src"][:, 6]

    def output_size(self, shape: Shape, flags: dict[str, Any]) -> tuple[int, int, int]:
        return self.size

    def resampling(self, flags: dict[str, Any]) -> Resampling:
        return super().resampling(flags)._replace(padding="border", fill=None)

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        dtype = compute_dtype(input)
        first, last = (corner.to(dtype) for corner in self._corners(input, params))
        result = constant(tuple(reversed(self.size)), input, dtype)
        if flags["align_corners"]:  # instead of a side of one voxel one whose ends differ, so that there is an inverse
            scale, half = (result - 1).clamp(min=_SIDE) / (last - first).clamp(min=_SIDE), 0.0
        else:  # the first voxel's center is half a voxel from the edge
            scale, half = result / (last - first + 1), 0.5
        matrix = torch.diag_embed(torch.cat([scale, scale.new_ones(len(scale), 1)], 1))
        matrix[:, :3, 3] = (half - first) * scale - half
        return matrix


class RandomResizedCrop3D(_ResizedBox3D):
    """Cut boxes of random volume and aspect out of volumes and resize them.

    Args:
        size: depth, height and width of the result; an int for all.
        scale: range of the volume of a box, as a fraction of the whole.
        ratio: range of width / height of a box, and of depth / sqrt(width * height), each as fractions of the volume's.
        resample: 'nearest' or 'bilinear', in all three directions.
        same_on_batch: all samples get the same box.
        align_corners: the centers of the outermost voxels of the box go to those of the result; False: their edges.
        p: probability that a batch is cropped.
        keepdim: a volume (C, D, H, W) gives a volume (C, d, h, w) instead of a batch of one.

    Raises:
        TypeError: `size` is not one or three ints.
        ValueError: a size below 1; a range does not have the form in Args, or is not above 0; `scale` is above 1; an unknown
            `resample`.

    Example:
        >>> import torch, kvision as K
        >>> crop = K.augmentation.RandomResizedCrop3D((2, 3, 4), scale=(0.2, 0.5))
        >>> crop(torch.rand(2, 1, 8, 8, 8)).shape
        torch.Size([2, 1, 2, 3, 4])
    """

    def __init__(
        self,
        size: int | tuple[int, int, int],
        scale: Numbers = (0.08, 1.0),
        ratio: Numbers = (3.0 / 4.0, 4.0 / 3.0),
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = True,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=1.0, p_batch=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        generator = ResizedCropGenerator3D(size, scale, ratio)
        self._param_generator, self.size = generator, generator.output_size
        mode = parse_resample("RandomResizedCrop3D", resample)
        self.flags = {"size": self.size, "resample": mode, "align_corners": align_corners}


class Resize3D(_ResizedBox3D):
    """Resize volumes.

    Args:
        size: depth, height and width of the result; an int for all.
        resample: 'nearest' or 'bilinear', in all three directions.
        align_corners: the centers of the outermost voxels of volume and result correspond; False: their edges.
        p: probability that a batch is resized.
        keepdim: a volume (C, D, H, W) gives a volume (C, d, h, w) instead of a batch of one.

    Raises:
        TypeError: `size` is not one or three ints.
        ValueError: a size below 1; an unknown `resample`.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.Resize3D((1, 1, 3))(torch.tensor([1.0, 2.0]).reshape(1, 1, 1, 1, 2)).flatten()
        tensor([1.0000, 1.5000, 2.0000])
    """

    def __init__(
        self,
        size: int | tuple[int, int, int],
        resample: AnyResample = Resample.BILINEAR.name,
        align_corners: bool = True,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=1.0, p_batch=p, same_on_batch=True, keepdim=keepdim, **options)
        generator = ResizeGenerator3D(size)
        self._param_generator, self.size = generator, generator.size
        self.flags = {
            "size": self.size,
            "resample": parse_resample("Resize3D", resample),
            "align_corners": align_corners,
        }

    def _corners(self, input: Tensor, params: Params) -> tuple[Tensor, Tensor]:
        last = constant(tuple(n - 1 for n in reversed(input.shape[2:])), input, torch.float32).expand(len(input), 3)
        return torch.zeros_like(last), last


_SIDE = 2.0**-20


def _translation(shift: Tensor) -> Tensor:
    """(B, 4, 4) that moves voxels by `shift` (B, 3)."""
    identity = torch.eye(4, device=shift.device, dtype=shift.dtype).expand(len(shift), 4, 4)
    return torch.cat([identity[..., :3], torch.nn.functional.pad(shift, (0, 1), value=1.0)[..., None]], -1)


def _six_sides(padding: Any) -> tuple[int, ...]:
    """Left, right, top, bottom, front and back from the forms that RandomCrop3D takes."""
    sides = parse_padding("RandomCrop3D", padding, (1, 3, 6), "one, three or six")
    return sides if len(sides) == 6 else tuple(n for n in sides for _ in range(6 // len(sides)))
