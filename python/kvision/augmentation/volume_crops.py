"""Crops of volumes (B, C, D, H, W). Points and matrices are (x, y, z), sizes (depth, height, width)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from kvision._constants import constant
from kvision.augmentation.base import Params, Shape
from kvision.augmentation.crop import padding_resampling
from kvision.augmentation.geometric3d_base import GeometricAugmentationBase3D
from kvision.augmentation.geometric_base import Resampling
from kvision.augmentation.random_generator.base import RandomGeneratorBase
from kvision.augmentation.random_generator.volumes import CropGenerator3D, box_params3d, center_corner, parse_size3d
from kvision.constants import Resample
from kvision.core.exceptions import TypeCheckError

__all__ = ["CenterCrop3D", "RandomCrop3D"]


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
