"""Crops of images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import CroppingMode
from kvision.augmentation import ranges
from kvision.augmentation.crops.window_crop import WindowCrop
from kvision.augmentation.engine import Shape
from kvision.augmentation.geometric_base import GeometricAugmentationBase2D
from kvision.augmentation.inputs import parse_size
from kvision.augmentation.random_generator.base import RandomGeneratorBase
from kvision.augmentation.random_generator.crop import (
    CropGenerator,
    PaddingOf,
    ResizedCropGenerator,
    box_params,
    parse_padding,
)
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.transforms import Transform
from kvision.augmentation.warp_and_color import Resampling
from kvision.constants import AnyResample, Resample
from kvision.core.exceptions import ValueCheckError

__all__ = ["CenterCrop", "RandomCrop", "RandomResizedCrop"]

PadMode: TypeAlias = Literal["constant", "replicate", "edge", "reflect", "symmetric"]
# The modes of torch.nn.functional.pad, as warps call them, and whether they mirror at the centers of the outermost pixels.
_PADDING: dict[PadMode, tuple[str, bool]] = {
    "constant": ("fill", True),
    "replicate": ("border", True),
    "edge": ("border", True),
    "reflect": ("reflection", True),
    "symmetric": ("reflection", False),
}


def padding_resampling(op: str, padding_mode: str, fill: Any) -> Resampling:
    """Whole pixels of an image that is padded."""
    if padding_mode not in _PADDING:
        raise ValueCheckError(f"{op}: expected padding_mode to be one of {', '.join(_PADDING)}, got {padding_mode!r}")
    padding, align_corners = _PADDING[padding_mode]
    is_zero = isinstance(fill, (int, float)) and fill == 0
    return Resampling("nearest", padding, align_corners, fill if padding == "fill" and not is_zero else None)


class RandomCrop(GeometricAugmentationBase2D):
    """Cut windows of a size out of images, after padding them.

    Args:
        size: height and width of the window.
        padding: pixels around the image: a number, a pair for left and right, top and bottom, or left, top, right, bottom.
        pad_if_needed: pad smaller images on both sides.
        fill: value of padded pixels.
        padding_mode: 'constant', 'reflect', 'replicate' or 'symmetric'.
        resample: accepted for code written for Kornia: windows begin at pixels, so that nothing is interpolated.
        same_on_batch: all samples get the same window.
        align_corners: accepted for code written for Kornia.
        p: probability that a batch is cropped.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        cropping_mode: accepted for code written for Kornia; both modes give the same pixels.

    Raises:
        TypeError: `size` or `padding` does not have the form in Args.
        ValueError: a size below 1; an unknown mode; in a call, images smaller than the window without `pad_if_needed`.

    Example:
        >>> import torch, kvision as K
        >>> crop = K.augmentation.RandomCrop((2, 2))
        >>> crop(torch.rand(4, 3, 8, 8)).shape
        torch.Size([4, 3, 2, 2])
    """

    whole_batch = moves_whole_pixels = True

    def __init__(
        self,
        size: int | tuple[int, int],
        padding: int | tuple[int, int] | tuple[int, int, int, int] | None = None,
        pad_if_needed: bool | None = False,
        fill: float = 0,
        padding_mode: PadMode = "constant",
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = True,
        p: float = 1.0,
        keepdim: bool = False,
        cropping_mode: CroppingMode = "slice",
        **options: Any,
    ) -> None:
        super().__init__(p=1.0, p_batch=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        generator = CropGenerator(size)
        generator.padding_of = PaddingOf(self)
        self._param_generator = generator
        self.size = generator.size
        self._padding = four_sides("RandomCrop", padding)
        padding_resampling("RandomCrop", padding_mode, ranges.fill("RandomCrop", "fill", fill))
        check_cropping_mode("RandomCrop", cropping_mode)
        self.flags = {
            "size": self.size,
            "padding": padding,
            "pad_if_needed": pad_if_needed,
            "fill": fill,
            "padding_mode": padding_mode,
            "resample": Resample.get(resample),
            "align_corners": align_corners,
            "cropping_mode": cropping_mode,
        }

    @property
    def stays_inside(self) -> bool:  # type: ignore[override]  # depends on the padding
        return self._padding == (0, 0, 0, 0) and not self.flags["pad_if_needed"]

    def compute_padding(self, shape: Shape, flags: dict[str, Any] | None = None) -> tuple[int, int, int, int]:
        """Left, right, top and bottom padding of images of a shape."""
        left, right, top, bottom = self._padding
        if (flags or self.flags)["pad_if_needed"]:
            down = max(self.size[0] - (shape[-2] + top + bottom), 0)
            across = max(self.size[1] - (shape[-1] + left + right), 0)
            return left + across, right + across, top + down, bottom + down
        return left, right, top, bottom

    def output_size(self, shape: Shape, flags: dict[str, Any]) -> tuple[int, int]:
        return self.size

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        return [Transform.affine((0.0, 0.0), translation="shift")]

    def resampling(self, flags: dict[str, Any]) -> Resampling:
        return padding_resampling("RandomCrop", flags["padding_mode"], flags["fill"])


class RandomResizedCrop(WindowCrop):
    """Cut windows of random area and aspect out of images and resize them.

    Args:
        size: height and width of the result.
        scale: range of the area, as a fraction of the image's.
        ratio: range of width / height of the window.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        same_on_batch: all samples get the same window.
        align_corners: the centers of the outermost pixels of the window go to those of the result; False: their edges.
        p: probability that a batch is cropped.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        cropping_mode: accepted for code written for Kornia; both modes read the image between the same positions.
        antialias: blur windows that become smaller, so that no pixel is skipped, as `Resize` does and torchvision and Pillow
            do; for 'bilinear' and 'bicubic'. No pixel next to a window is read; windows are rounded to whole pixels.

    Raises:
        TypeError: `size` is not one or two ints.
        ValueError: a size below 1; a range does not have the form in Args, or is not above 0; an unknown mode;
            `antialias` with 'nearest'.

    Example:
        >>> import torch, kvision as K
        >>> crop = K.augmentation.RandomResizedCrop((2, 3), scale=(1.0, 1.0), ratio=(1.0, 1.0))
        >>> crop(torch.arange(16.0).reshape(1, 1, 4, 4))
        tensor([[[[ 0.0000,  1.5000,  3.0000],
                  [12.0000, 13.5000, 15.0000]]]])
    """

    whole_batch = True

    def __init__(
        self,
        size: tuple[int, int],
        scale: Numbers = (0.08, 1.0),
        ratio: Numbers = (3.0 / 4.0, 4.0 / 3.0),
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = True,
        p: float = 1.0,
        keepdim: bool = False,
        cropping_mode: CroppingMode = "slice",
        antialias: bool = False,
        **options: Any,
    ) -> None:
        given = dict(same_on_batch=same_on_batch, keepdim=keepdim, **options)
        super().__init__(ResizedCropGenerator(size, scale, ratio), p, resample, align_corners, antialias, **given)
        check_cropping_mode("RandomResizedCrop", cropping_mode)
        self.flags = {**self.flags, "cropping_mode": cropping_mode}


class _CenterGenerator(RandomGeneratorBase):
    """The window of CenterCrop, which draws nothing."""

    def __init__(self, size: tuple[int, int]) -> None:
        super().__init__()
        self.size = size

    def draws(self, shape: Sequence[int]) -> Sequence[Any]:
        return []

    def corner(self, shape: Sequence[int]) -> tuple[int, int]:
        return (shape[-1] - self.size[1]) // 2, (shape[-2] - self.size[0]) // 2

    def to_params(self, columns: Tensor, shape: Sequence[int]) -> dict[str, Tensor]:
        zero, (x, y), (h, w) = columns.new_zeros(shape[0]), self.corner(shape), self.size
        return box_params(zero + x, zero + y, zero + w, zero + h, shape, self.size)

    def to_columns(self, params: dict[str, Any], shape: Sequence[int]) -> Tensor:
        return torch.empty(shape[0], 0, device="cpu")


class CenterCrop(GeometricAugmentationBase2D):
    """Cut the window of a size out of the middle of images; smaller images are surrounded by 0.

    Args:
        size: height and width of the window; an int for both.
        align_corners: accepted for code written for Kornia.
        resample: accepted for code written for Kornia: the window begins at a pixel.
        p: probability that a batch is cropped.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        cropping_mode: accepted for code written for Kornia; both modes give the same pixels.

    Raises:
        TypeError: `size` is not one or two ints.
        ValueError: a size below 1; an unknown mode.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.CenterCrop(2)(torch.arange(16.0).reshape(1, 1, 4, 4))
        tensor([[[[ 5.,  6.],
                  [ 9., 10.]]]])
    """

    whole_batch = moves_whole_pixels = True

    def __init__(
        self,
        size: int | tuple[int, int],
        align_corners: bool = True,
        resample: AnyResample = Resample.BILINEAR.name,
        p: float = 1.0,
        keepdim: bool = False,
        cropping_mode: CroppingMode = "slice",
        **options: Any,
    ) -> None:
        super().__init__(p=1.0, p_batch=p, same_on_batch=True, keepdim=keepdim, **options)
        self.size = parse_size("CenterCrop", size)
        check_cropping_mode("CenterCrop", cropping_mode)
        self._param_generator: _CenterGenerator = _CenterGenerator(self.size)
        self.flags = {
            "resample": Resample.get(resample),
            "cropping_mode": cropping_mode,
            "align_corners": align_corners,
            "size": self.size,
            "padding_mode": "zeros",
        }

    def output_size(self, shape: Shape, flags: dict[str, Any]) -> tuple[int, int]:
        return self.size

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        x, y = self._param_generator.corner(shape)
        return [Transform.constant([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, 1.0]])]


def check_cropping_mode(op: str, mode: CroppingMode) -> None:
    """Raise unless `mode` is one of Kornia's."""
    _check.choice(op, "cropping_mode", mode, get_args(CroppingMode))


def four_sides(op: str, padding: Any) -> tuple[int, int, int, int]:
    """Left, right, top and bottom from the forms that RandomCrop and Pad take."""
    sides = parse_padding(op, padding, (1, 2, 4), "one, two or four")
    if len(sides) == 1:
        return sides[0], sides[0], sides[0], sides[0]
    if len(sides) == 2:
        return sides[0], sides[0], sides[1], sides[1]
    left, top, right, bottom = sides
    return left, right, top, bottom
