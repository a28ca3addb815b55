"""Resizing and padding as augmentations, which masks, boxes and key points follow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check, geometry
from kvision._choices import ResizeSide
from kvision._dtype import compute_dtype
from kvision.augmentation import ranges
from kvision.augmentation.columns import Column
from kvision.augmentation.crops.crop import PadMode, four_sides, padding_resampling
from kvision.augmentation.draws import Draw
from kvision.augmentation.engine import Execution, Params, Shape, check_images
from kvision.augmentation.geometric_base import GeometricAugmentationBase2D
from kvision.augmentation.inputs import parse_size
from kvision.augmentation.keys import refuse_capture, refuse_graphs, refuse_mapped
from kvision.augmentation.lists.sides import rows_on_device
from kvision.augmentation.maps import warp, warp_labels, warp_to_sizes
from kvision.augmentation.random_generator.base import RandomGeneratorBase
from kvision.augmentation.random_generator.crop import ResizeGenerator
from kvision.augmentation.random_generator.plain import PlainUniformGenerator
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.transforms import Transform, transform_matrix
from kvision.augmentation.warp_and_color import Resampling
from kvision.color.frames import Frames
from kvision.constants import AnyResample, Resample
from kvision.core.exceptions import ValueCheckError
from kvision.geometry.transform.lists.arguments import like_batch, sizes
from kvision.geometry.transform.resize import resize_each, side_to_sizes

__all__ = ["LongestMaxSize", "Pad", "PadIfNeeded", "PadTo", "RandomScale", "Resize", "SmallestMaxSize"]

Position: TypeAlias = Literal["center", "top_left", "top_right", "bottom_left", "bottom_right", "random"]
_POSITIONS = get_args(Position)


class Resize(GeometricAugmentationBase2D):
    """Resize images.

    Args:
        size: height and width of the result, or the length of one side, which keeps the aspect.
        side: which side an int is: 'short', 'long', 'vert' or 'horz'.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        align_corners: the centers of the outermost pixels of image and result correspond; False: their edges.
        antialias: blur images that become smaller, so that no pixel is skipped.
        p: probability that a batch is resized.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.

    Raises:
        TypeError: `size` is not one or two ints.
        ValueError: a size below 1; `side` is unknown; `antialias` with 'nearest'.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.Resize((1, 3))(torch.tensor([[[[1.0, 2.0]]]]))
        tensor([[[[1.0000, 1.5000, 2.0000]]]])
    """

    whole_batch = True

    def __init__(
        self,
        size: int | tuple[int, int],
        side: ResizeSide = "short",
        resample: AnyResample = Resample.BILINEAR.name,
        align_corners: bool = True,
        antialias: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=1.0, p_batch=p, same_on_batch=True, keepdim=keepdim, **options)
        self._param_generator: ResizeGenerator = ResizeGenerator(size, side)
        self.flags = {
            "size": self._param_generator.output_size,
            "side": side,
            "resample": Resample.get(resample),
            "align_corners": align_corners,
            "antialias": antialias,
        }
        if antialias and self.flags["resample"] == Resample.NEAREST:
            raise ValueCheckError(f"{type(self).__name__}: expected resample 'bilinear' or 'bicubic' with antialias")

    def output_size(self, shape: Shape, flags: dict[str, Any]) -> tuple[int, int]:
        return self._param_generator.size_for(shape)

    def matrix_transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        h, w = self.output_size(shape, flags)
        corners = float(flags["align_corners"] is not False)
        return [Transform("crop", 0.0, 0.0, float(shape[-1]), float(shape[-2]), float(w), float(h), corners)]

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform] | None:
        return None if flags["antialias"] else self.matrix_transforms(shape, flags)

    def resampling(self, flags: dict[str, Any]) -> Resampling:
        read = super().resampling(flags)
        return Resampling(read.mode, "border", read.align_corners, read.fill)  # _replace: see RandomResizedCrop

    def _warp(self, x: Tensor, matrix: Tensor, flags: dict[str, Any]) -> Tensor:
        if not flags["antialias"]:
            return super()._warp(x, matrix, flags)
        mode: Any = Resample.get(flags["resample"]).name.lower()
        size = self.output_size(tuple(x.shape), flags)
        return geometry.resize(x, size, mode, align_corners=flags["align_corners"], antialias=True)

    def _resize_frames(self, frames: Frames, flags: dict[str, Any]) -> Tensor:
        """What `_warp` makes of the images that frames are, in a batch, if the resize runs by itself."""
        mode: Any = Resample.get(flags["resample"]).name.lower()
        size = self.output_size(tuple(frames.shape), flags)
        y = geometry.resize(frames, size, mode, align_corners=flags["align_corners"], antialias=flags["antialias"])
        return y[None] if frames.is_single else y

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return bool(self.flags["antialias"]) and not self._is_customized()

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> Any:
        return _antialiased_list(images, *self._sizes_of_list(images), self.flags)

    def _sizes_of_list(self, images: Sequence[Tensor]) -> tuple[list[int], bool]:
        size, side = self._param_generator.output_size, self._param_generator.side
        return (side_to_sizes(size, sizes(images), side), True) if isinstance(size, int) else (list(size), False)


def _antialiased_list(images: Sequence[Tensor], sizes: Sequence[int], is_list: bool, flags: dict[str, Any]) -> Any:
    """Images (C, H, W) resized with antialiasing to one size, or each to one of `sizes`."""
    mode: Any = Resample.get(flags["resample"]).name.lower()
    return resize_each(list(images), list(sizes), mode, bool(flags["align_corners"]), True, is_list)


class LongestMaxSize(Resize):
    """Resize images so that their longer side has a given length.

    Args:
        max_size: length of the longer side.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        align_corners: the centers of the outermost pixels of image and result correspond; False: their edges.
        p: probability that a batch is resized.

    Raises:
        TypeError: `max_size` is not an int.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.LongestMaxSize(4)(torch.rand(1, 3, 4, 8)).shape
        torch.Size([1, 3, 2, 4])
    """

    def __init__(
        self,
        max_size: int,
        resample: AnyResample = Resample.BILINEAR.name,
        align_corners: bool = True,
        p: float = 1.0,
        **options: Any,
    ) -> None:
        super().__init__(max_size, "long", resample, align_corners, p=p, **options)


class SmallestMaxSize(Resize):
    """Resize images so that their shorter side has a given length.

    Args:
        max_size: length of the shorter side.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        align_corners: the centers of the outermost pixels of image and result correspond; False: their edges.
        p: probability that a batch is resized.

    Raises:
        TypeError: `max_size` is not an int.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.SmallestMaxSize(4)(torch.rand(1, 3, 4, 8)).shape
        torch.Size([1, 3, 4, 8])
    """

    def __init__(
        self,
        max_size: int,
        resample: AnyResample = Resample.BILINEAR.name,
        align_corners: bool = True,
        p: float = 1.0,
        **options: Any,
    ) -> None:
        super().__init__(max_size, "short", resample, align_corners, p=p, **options)


class RandomScale(GeometricAugmentationBase2D):
    """Resize images by a random factor, one for a batch, so that the size of the results is random.

    A list of images of different sizes has a factor of each. With seeds of samples the first one's counts for a batch.
    Labels follow. To scale what is in images of a fixed size, use :class:`RandomAffine` or :class:`RandomZoomOut`.

    Args:
        scale_range: pair of the lowest and the highest factor, above 0; sizes are rounded, to one pixel at least.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        align_corners: the centers of the outermost pixels of image and result correspond; False: their edges.
        antialias: blur images that become smaller, so that no pixel is skipped.
        p: probability that a batch is resized.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.

    Raises:
        TypeError, ValueError: `scale_range` does not have the form in Args, or is not above 0; `antialias` with 'nearest'.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomScale((0.5, 0.5), p=1.0)(torch.rand(2, 3, 8, 10)).shape
        torch.Size([2, 3, 4, 5])
    """

    whole_batch = True
    has_known_size = False

    def __init__(
        self,
        scale_range: Numbers = (0.9, 1.1),
        resample: AnyResample = Resample.BILINEAR.name,
        align_corners: bool = False,
        antialias: bool = True,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=1.0, p_batch=p, keepdim=keepdim, **options)
        op = "RandomScale"
        scale_range = ranges.without_gradient(op, "scale_range", scale_range)
        self._param_generator = PlainUniformGenerator((scale_range, "scale", None, (1e-6, float("inf"))), op=op)
        self.flags = {
            "resample": Resample.get(resample),
            "align_corners": align_corners,
            "padding_mode": "border",
            "antialias": _check.switch(op, "antialias", antialias),
        }
        if antialias and self.flags["resample"] == Resample.NEAREST:
            raise ValueCheckError(f"{op}: expected resample 'bilinear' or 'bicubic' with antialias")

    def _named(self, values: Tensor, execution: Execution) -> Params:
        return super()._named(values[:1].expand_as(values), execution)  # that of the first sample counts

    def _size_of(self, execution: Execution, flags: dict[str, Any]) -> tuple[int, int]:
        """Height and width of the results, by the factor that the host draws again."""
        height, width = execution.shape[-2:]
        if not execution.applied or not execution.shape[0]:
            return height, width
        refuse_graphs("RandomScale")
        refuse_capture("RandomScale")
        scale = self._read_params(execution)["scale"]
        refuse_mapped("RandomScale", scale)
        height, width = _scaled(torch.tensor([height, width], device="cpu"), scale[:1].cpu()).tolist()
        return height, width

    def _matrix_of(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        dtype = compute_dtype(x) if execution.identity is None else execution.identity[1]
        sizes = [*execution.shape[-2:], *self._size_of(execution, flags)]
        no_columns = torch.empty(execution.shape[0], 0, dtype=dtype, device=x.device)
        return transform_matrix(no_columns, self._resizing(flags, *map(float, sizes)))

    @staticmethod
    def _resizing(flags: dict[str, Any], h: Any, w: Any, to_h: Any, to_w: Any) -> list[Transform]:
        """From images to results of these heights and widths."""
        return [Transform("crop", 0.0, 0.0, w, h, to_w, to_h, float(flags["align_corners"] is not False))]

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return not self._is_customized()

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        if self.flags["antialias"]:
            of_all = self._scaled_sides(sizes(images), execution)[1].flatten().tolist()
            return _antialiased_list(images, of_all, True, self.flags)
        matrices, of_all = self._motion_of_list(sizes(images), execution, like_batch(images))
        return warp_to_sizes(list(images), matrices, of_all, self.resampling(self.flags))

    def _motion_of_list(self, sides: Sequence[int], execution: Execution, like: Tensor) -> tuple[Tensor, list[int]]:
        """Matrices (B, 3, 3) for height and width of each image, and those of results, like a tensor."""
        before, scaled = self._scaled_sides(sides, execution)
        of_each = rows_on_device(torch.cat([before, scaled], 1), like, compute_dtype(like))
        matrices = transform_matrix(of_each, self._resizing(self.flags, *map(Column, range(4))))
        return matrices, scaled.flatten().tolist()

    def _scaled_sides(self, sides: Sequence[int], execution: Execution) -> tuple[Tensor, Tensor]:
        """Height and width (B, 2) of each image, and those of results."""
        given = execution.params
        factors = self._values_on_host(execution)[:, 0] if given is None else given["scale"]
        before = torch.tensor(sides, dtype=torch.float64, device="cpu").view(-1, 2)
        return before, _scaled(before, factors[:, None])

    def _run(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied or self._is_customized():
            return super()._run(x, execution, flags)
        check_images("RandomScale", x.shape)
        execution.matrix, size = self._matrix_of(x, execution, flags), self._size_of(execution, flags)
        if not flags["antialias"]:
            return warp(x, execution.matrix, size, self.resampling(flags))
        mode: Any = Resample.get(flags["resample"]).name.lower()
        y: Tensor = geometry.resize(x, size, mode, align_corners=flags["align_corners"], antialias=True)
        return y

    @property
    def _warps_masks(self) -> bool:
        return type(self).transform_masks is RandomScale.transform_masks

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied:
            return masks
        resampling = self.resampling(flags).for_labels(fill=flags.get("mask_fill"))
        return warp_labels(masks, self._matrix(execution), self._size_of(execution, flags), resampling)


def _scaled(sides: Tensor, factors: Tensor) -> Tensor:
    return (sides * factors.double()).round().clamp(min=1).long()


class PadTo(GeometricAugmentationBase2D):
    """Pad images on the right and at the bottom to a size.

    Args:
        size: height and width of the result.
        pad_mode: 'constant', 'reflect', 'replicate' or 'symmetric'.
        pad_value: value of padded pixels.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        crop_if_exceeds: cut larger images to the size; False: they keep their size.

    Raises:
        TypeError: `size` is not one or two ints.
        ValueError: a size below 1; an unknown mode.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.PadTo((2, 3), pad_value=9)(torch.ones(1, 1, 1, 2))
        tensor([[[[1., 1., 9.],
                  [9., 9., 9.]]]])
    """

    whole_batch = moves_whole_pixels = True

    def __init__(
        self,
        size: tuple[int, int],
        pad_mode: PadMode = "constant",
        pad_value: float = 0,
        keepdim: bool = False,
        crop_if_exceeds: bool = True,
        **options: Any,
    ) -> None:
        super().__init__(p=1.0, same_on_batch=True, keepdim=keepdim, **options)
        self.size = parse_size("PadTo", size)
        padding_resampling("PadTo", pad_mode, ranges.fill("PadTo", "pad_value", pad_value))
        self.flags = {
            "size": self.size,
            "pad_mode": pad_mode,
            "pad_value": pad_value,
            "crop_if_exceeds": crop_if_exceeds,
        }

    def output_size(self, shape: Shape, flags: dict[str, Any]) -> tuple[int, int]:
        h, w = self.size
        return (h, w) if flags["crop_if_exceeds"] else (max(h, shape[-2]), max(w, shape[-1]))

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        return [Transform.constant([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])]

    def resampling(self, flags: dict[str, Any]) -> Resampling:
        return padding_resampling("PadTo", flags["pad_mode"], flags["pad_value"])


class Pad(GeometricAugmentationBase2D):
    """Pad images by amounts, as torchvision's `Pad`.

    Args:
        padding: pixels around the image: a number, a pair for left and right, top and bottom, or left, top, right, bottom;
            negative ones cut pixels off.
        fill: value of padded pixels.
        padding_mode: 'constant', 'edge' (or 'replicate'), 'reflect' or 'symmetric'.
        p: probability that a batch is padded.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.

    Raises:
        TypeError: `padding` does not have the form in Args.
        ValueError: an unknown mode; in a call, nothing is left of the image.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.Pad((1, 0), fill=9)(torch.ones(1, 1, 1, 2))
        tensor([[[[9., 1., 1., 9.]]]])
    """

    whole_batch = moves_whole_pixels = True

    def __init__(
        self,
        padding: int | tuple[int, int] | tuple[int, int, int, int],
        fill: float = 0,
        padding_mode: PadMode = "constant",
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=1.0, p_batch=p, same_on_batch=True, keepdim=keepdim, **options)
        self._padding = four_sides("Pad", padding)
        padding_resampling("Pad", padding_mode, ranges.fill("Pad", "fill", fill))
        self.flags = {"padding": padding, "fill": fill, "padding_mode": padding_mode}

    @property
    def stays_inside(self) -> bool:  # type: ignore[override]  # depends on the padding
        return max(self._padding) <= 0

    def output_size(self, shape: Shape, flags: dict[str, Any]) -> tuple[int, int]:
        left, right, top, bottom = self._padding
        size = shape[-2] + top + bottom, shape[-1] + left + right
        if min(size) < 1:
            raise ValueCheckError(
                f"Pad: expected padding that leaves pixels of {tuple(shape[-2:])}, got {self._padding}"
            )
        return size

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        left, _, top, _ = self._padding
        return [Transform.constant([[1.0, 0.0, float(left)], [0.0, 1.0, float(top)], [0.0, 0.0, 1.0]])]

    def resampling(self, flags: dict[str, Any]) -> Resampling:
        return padding_resampling("Pad", flags["padding_mode"], flags["fill"])


class _PositionGenerator(RandomGeneratorBase):
    """Draws how far images move to the right and down in their padding; a fixed position draws nothing."""

    fields = (("shift", 2),)

    def __init__(self, minima: Sequence[int | None], divisors: Sequence[int | None], position: Position) -> None:
        super().__init__()
        self._minima, self._divisors, self.position = minima, divisors, position

    def size_for(self, shape: Sequence[int]) -> tuple[int, int]:
        """Height and width of the padded images."""
        height, width = (
            max(n, minimum) if minimum is not None else -(-n // (divisor or 1)) * (divisor or 1)
            for n, minimum, divisor in zip(shape[-2:], self._minima, self._divisors)
        )
        return height, width

    def draws(self, shape: Sequence[int]) -> Sequence[Draw]:
        height, width = self.size_for(shape)
        down, right = height - shape[-2], width - shape[-1]
        if self.position == "random":
            return [Draw("integer", (0, 1, free + 1, 0)) for free in (right, down)]
        if self.position == "center":
            x, y = right // 2, down // 2
        else:  # where the image is, not the padding
            x, y = right * self.position.endswith("right"), down * self.position.startswith("bottom")
        return [Draw("integer", (at, 1, 1, at)) for at in (x, y)]


class PadIfNeeded(GeometricAugmentationBase2D):
    """Pad images up to a size, or to a multiple of a number, as Albumentations' `PadIfNeeded`.

    Args:
        min_height: the least height; None with `pad_height_divisor`.
        min_width: the least width; None with `pad_width_divisor`.
        pad_height_divisor: pad to a multiple of this height instead.
        pad_width_divisor: pad to a multiple of this width instead.
        position: where the image is in the result: 'center', with an odd pixel on the right and at the bottom, 'top_left',
            'top_right', 'bottom_left', 'bottom_right', or 'random' for each sample.
        padding_mode: 'constant', 'edge' (or 'replicate'), 'reflect' or 'symmetric'.
        fill: value of padded pixels.
        same_on_batch: all samples get the same random position.
        p: probability that a batch is padded.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.

    Raises:
        TypeError: a size is not an int.
        ValueError: a size below 1; both or none of a least size and a divisor; an unknown position or mode.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.PadIfNeeded(2, 3, fill=9)(torch.ones(1, 1, 1, 2))
        tensor([[[[1., 1., 9.],
                  [9., 9., 9.]]]])
    """

    whole_batch = moves_whole_pixels = True

    def __init__(
        self,
        min_height: int | None = 1024,
        min_width: int | None = 1024,
        pad_height_divisor: int | None = None,
        pad_width_divisor: int | None = None,
        position: Position = "center",
        padding_mode: PadMode = "constant",
        fill: float = 0,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=1.0, p_batch=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        op = "PadIfNeeded"
        sides = (("height", min_height, pad_height_divisor), ("width", min_width, pad_width_divisor))
        for side, least, divisor in sides:
            if (least is None) == (divisor is None):
                raise ValueCheckError(
                    f"{op}: expected one of min_{side} and pad_{side}_divisor, got {least} and {divisor}"
                )
            name = f"min_{side}" if divisor is None else f"pad_{side}_divisor"
            _check.ints(op, name, least if divisor is None else divisor, 1)
        _check.choice(op, "position", position, _POSITIONS)
        padding_resampling(op, padding_mode, ranges.fill(op, "fill", fill))
        self._param_generator: _PositionGenerator = _PositionGenerator(
            (min_height, min_width), (pad_height_divisor, pad_width_divisor), position
        )
        self.flags = {"padding_mode": padding_mode, "fill": fill}

    def output_size(self, shape: Shape, flags: dict[str, Any]) -> tuple[int, int]:
        return self._param_generator.size_for(shape)

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        return [Transform.affine((0.0, 0.0), translation="shift")]

    def resampling(self, flags: dict[str, Any]) -> Resampling:
        return padding_resampling("PadIfNeeded", flags["padding_mode"], flags["fill"])
