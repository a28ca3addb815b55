"""Generators of crops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import ResizeSide
from kvision._constants import constant
from kvision.augmentation import ranges
from kvision.augmentation.draws import Draw
from kvision.augmentation.inputs import parse_size
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.ranges import Numbers
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.geometry.transform.resize import side_to_size

__all__ = [
    "CropGenerator",
    "ResizeGenerator",
    "ResizedCropGenerator",
    "center_crop_generator",
]


def parse_padding(op: str, padding: Any, counts: tuple[int, int, int], words: str) -> tuple[int, ...]:
    """Pixels around an image: as many ints as one of `counts`, whose words are `words`, or one; None is 0."""
    sides = _check.scalars(op, "padding", 0 if padding is None else padding)
    sides = (sides,) if isinstance(sides, int) else sides
    if not isinstance(sides, (tuple, list)) or len(sides) not in counts or any(type(n) is not int for n in sides):
        raise TypeCheckError(f"{op}: expected padding to be {words} ints, got {padding!r}")
    if max(map(abs, sides)) > _check.LARGEST_INT:
        raise ValueCheckError(f"{op}: expected padding of less than 2^31, got {padding!r}")
    return tuple(sides)


def box_params(x: Tensor, y: Tensor, w: Tensor, h: Tensor, shape: Shape, size: tuple[int, int]) -> dict[str, Tensor]:
    """Boxes by their corners, clockwise from top left, both ends inclusive: `src` in the image, `dst` in the result."""
    n = x.shape[0]
    right, bottom = x + w - 1, y + h - 1
    src = torch.stack([x, y, right, y, right, bottom, x, bottom], -1).reshape(n, 4, 2)
    last_x, last_y = size[1] - 1.0, size[0] - 1.0
    dst = constant(((0.0, 0.0), (last_x, 0.0), (last_x, last_y), (0.0, last_y)), x)
    return {
        "src": src,
        "dst": dst.repeat(n, 1, 1),
        "input_size": constant(tuple(shape[-2:]), x, torch.int64).repeat(n, 1),
        "output_size": constant(tuple(size), x, torch.int64).repeat(n, 1),
    }


class PaddingOf:
    """The padding that a crop computes for images of a shape; unlike its bound method, torch.load makes it with weights_only."""

    def __init__(self, crop: Any) -> None:
        self.crop = crop

    def __call__(self, shape: Any) -> Any:
        return self.crop.compute_padding(shape)


class CropGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomCrop`.

    Args:
        size: height and width of the crop.
        resize_to: accepted for code written for Kornia: height and width of the result; default: `size`.

    Returns:
        src and dst (B, 4, 2), corners with both ends inclusive; input_size and output_size (B, 2).

    Raises:
        TypeError: `size` is not one or two ints.
        ValueError: the crop is larger than the images.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.CropGenerator((2, 2))((1, 3, 2, 2))["src"][0]
        tensor([[0., 0.],
                [1., 0.],
                [1., 1.],
                [0., 1.]])
    """

    fields = (("shift", 2),)

    def __init__(self, size: Any, resize_to: tuple[int, int] | None = None) -> None:
        super().__init__()
        self.size = parse_size("RandomCrop", size)
        self.resize_to = None if resize_to is None else parse_size("RandomCrop", resize_to)
        # Left, right, top, bottom, around images of a shape: RandomCrop sets it.
        self.padding_of: Any = lambda shape: (0, 0, 0, 0)

    def draws(self, shape: Shape) -> Sequence[Draw]:
        left, right, top, bottom = self.padding_of(shape)
        draws = []
        for before, after, n, side in zip((left, top), (right, bottom), reversed(shape[-2:]), reversed(self.size)):
            free = before + n + after - side
            if free < 0:
                raise ValueCheckError(
                    f"RandomCrop: expected images of at least {self.size}, got {tuple(shape[-2:])}; use pad_if_needed"
                )
            draws.append(Draw("integer", (before - free, 1, free + 1, before)))
        return draws

    # The columns are the shift from image to crop. Corners are in the padded image, as Kornia has them.

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        left, right, top, bottom = self.padding_of(shape)
        h, w = self.size
        x, y = left - columns[:, 0], top - columns[:, 1]
        padded = (*shape[:-2], shape[-2] + top + bottom, shape[-1] + left + right)
        params = box_params(x, y, torch.full_like(x, w), torch.full_like(y, h), padded, self.resize_to or self.size)
        padding = constant((left, right, top, bottom), x, torch.int64)
        return {**params, "padding_size": padding.repeat(columns.shape[0], 1)}

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        src = params["src"]
        padding = params.get("padding_size")
        if padding is None:
            left, _, top, _ = self.padding_of(shape)
            before = constant((left, top), src)
        else:
            before = padding[:, 0::2]
        return before.to(src) - src[:, 0]


class WindowGeneratorBase(RandomGeneratorBase):
    """Base of generators of a window of each image that is resized: first column, first row, width, height.

    `output_size` is the height and width of the results, None for those of the images.
    """

    fields = (("window", 4),)
    output_size: tuple[int, int] | None

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        x, y, w, h = columns.unbind(1)
        return box_params(x, y, w, h, tuple(shape), self.output_size or (shape[-2], shape[-1]))

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        src = params["src"]
        return torch.cat([src[:, 0], src[:, 2] - src[:, 0] + 1], 1)


class ResizedCropGenerator(WindowGeneratorBase):
    """Draws the parameters of :class:`RandomResizedCrop`.

    Args:
        output_size: height and width of the result.
        scale: range of the area, as a fraction of the image's.
        ratio: range of width / height of the crop.

    Returns:
        src and dst (B, 4, 2), corners with both ends inclusive; input_size and output_size (B, 2).

    Raises:
        TypeError: `output_size` is not one or two ints.
        ValueError: a range does not have the form in Args, or is not above 0.

    Example:
        >>> import kvision as K
        >>> draw = K.augmentation.random_generator.ResizedCropGenerator((2, 2), (1.0, 1.0), (1.0, 1.0))
        >>> draw((1, 3, 4, 4))["src"][0]
        tensor([[0., 0.],
                [3., 0.],
                [3., 3.],
                [0., 3.]])
    """

    output_size: tuple[int, int]

    def __init__(self, output_size: Any, scale: Numbers = (0.08, 1.0), ratio: Numbers = (3.0 / 4.0, 4.0 / 3.0)) -> None:
        super().__init__()
        op = "RandomResizedCrop"
        self.output_size = parse_size(op, output_size)
        scale, ratio = ranges.without_gradient(op, "scale", scale), ranges.without_gradient(op, "ratio", ratio)
        self.scale = ranges.parse(op, "scale", scale, bounds=(0.0, float("inf")))
        self.ratio = ranges.parse(op, "ratio", ratio, bounds=(0.0, float("inf")))
        if self.ratio.low <= 0:
            raise ValueCheckError(f"{op}: expected ratio above 0, got {ratio}")

    def draws(self, shape: Shape) -> Sequence[Draw]:
        height, width = shape[-2:]
        logs = math.log(self.ratio.low), math.log(self.ratio.high)
        return [Draw("resized_crop", (self.scale.low, self.scale.high, *logs, height, width))]


class ResizeGenerator(RandomGeneratorBase):
    """The parameters of :class:`Resize`, which draws nothing.

    Args:
        resize_to: height and width, or the length of one side.
        side: which side an int is: 'short', 'long', 'vert' or 'horz'.

    Returns:
        src and dst (B, 4, 2), corners with both ends inclusive; input_size and output_size (B, 2).

    Raises:
        ValueError: `side` is unknown.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.ResizeGenerator(8, side="short")((1, 3, 4, 6))["output_size"]
        tensor([[ 8, 12]])
    """

    def __init__(self, resize_to: int | tuple[int, int], side: ResizeSide = "short") -> None:
        super().__init__()
        _check.choice("Resize", "side", side, get_args(ResizeSide))
        sides = parse_size("Resize", resize_to)
        self.output_size = resize_to if isinstance(resize_to, int) else sides
        self.side = side

    def size_for(self, shape: Shape) -> tuple[int, int]:
        """Height and width of the results for images of a shape."""
        if not isinstance(self.output_size, int):
            return self.output_size
        return side_to_size(self.output_size, shape[-2], shape[-1], self.side)

    def draws(self, shape: Shape) -> Sequence[Draw]:
        return []

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        zero = columns.new_zeros(shape[0])
        return box_params(zero, zero, zero + shape[-1], zero + shape[-2], shape, self.size_for(shape))

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        return torch.empty(shape[0], 0, device="cpu")


def center_crop_generator(
    batch_size: int, height: int, width: int, size: tuple[int, int], device: torch.device | str | None = None
) -> dict[str, Tensor]:
    """Corners of the centered crop of each image, as :class:`CenterCrop` takes it.

    Args:
        batch_size: number of images.
        height: of the images.
        width: of the images.
        size: height and width of the crop.
        device: of the result; default: the CPU.

    Returns:
        src and dst (B, 4, 2), corners with both ends inclusive; input_size and output_size (B, 2).

    Raises:
        TypeError: `size` is not one or two ints.
        ValueError: a size below 1.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.center_crop_generator(1, 4, 6, (2, 2))["src"][0, 0]
        tensor([2., 1.])
    """
    h, w = parse_size("center_crop_generator", size)
    x = torch.full((batch_size,), float((width - w) // 2), dtype=torch.float32, device=device)
    y = torch.full((batch_size,), float((height - h) // 2), dtype=torch.float32, device=device)
    shape = (batch_size, 1, height, width)
    return box_params(x, y, torch.full_like(x, w), torch.full_like(y, h), shape, (h, w))
