"""An image with its pixel format: color space, bit depth, order of the axes."""

from __future__ import annotations

import os
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.dlpack import from_dlpack, to_dlpack

from kvision import _check
from kvision.color import bgr_to_grayscale, rgb_to_grayscale
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.image.convert import view_array
from kvision.image.terminal import image_to_string

__all__ = ["ChannelsOrder", "ColorSpace", "Image", "ImageLayout", "ImageSize", "PixelFormat"]


class ColorSpace(Enum):
    """What the channels stand for; UNKNOWN is any number of channels of anything.

    Example:
        >>> import kvision as K
        >>> [space.name for space in K.image.ColorSpace]
        ['UNKNOWN', 'GRAY', 'RGB', 'BGR']
    """

    UNKNOWN = 0
    GRAY = 1
    RGB = 2
    BGR = 3


class ChannelsOrder(Enum):
    """The order of the axes: CHANNELS_FIRST is (C, H, W), CHANNELS_LAST is (H, W, C).

    Example:
        >>> import kvision as K
        >>> [order.name for order in K.image.ChannelsOrder]
        ['CHANNELS_FIRST', 'CHANNELS_LAST']
    """

    CHANNELS_FIRST = 0
    CHANNELS_LAST = 1


@dataclass(frozen=True)
class ImageSize:
    """Height and width of an image, in pixels.

    Args:
        height: number of rows.
        width: number of columns.

    Example:
        >>> import kvision as K
        >>> K.image.ImageSize(480, 640)
        ImageSize(height=480, width=640)
    """

    height: int
    width: int


@dataclass(frozen=True)
class PixelFormat:
    """Color space and bit depth of an image.

    Args:
        color_space: what the channels stand for.
        bit_depth: bits of one channel's value, 8 for uint8, 32 for float32.

    Example:
        >>> import kvision as K
        >>> K.image.PixelFormat(K.image.ColorSpace.RGB, 8).bit_depth
        8
    """

    color_space: ColorSpace
    bit_depth: int


@dataclass(frozen=True)
class ImageLayout:
    """Size, number of channels and order of the axes of an image.

    Args:
        image_size: height and width.
        channels: number of channels.
        channels_order: whether channels are the first or the last axis.

    Example:
        >>> import kvision as K
        >>> K.image.ImageLayout(K.image.ImageSize(480, 640), 3, K.image.ChannelsOrder.CHANNELS_FIRST).image_size
        ImageSize(height=480, width=640)
    """

    image_size: ImageSize
    channels: int
    channels_order: ChannelsOrder


_CHANNELS = {ColorSpace.GRAY: 1, ColorSpace.RGB: 3, ColorSpace.BGR: 3}


class Image:
    """One image, never a batch, as a tensor with its pixel format and layout. No method changes it in place.

    Args:
        data: (C, H, W) or (H, W, C), as `layout.channels_order` says.
        pixel_format: color space and bit depth of `data`.
        layout: size, channels and order of the axes of `data`.

    Raises:
        TypeCheckError: `data` is not a tensor.
        ShapeError: `data` has not the shape of `layout`.
        ValueCheckError: the bit depth is not that of `data`, or the color space needs another number of channels.

    Example:
        >>> import numpy as np, kvision as K
        >>> image = K.image.Image.from_numpy(np.zeros((4, 5, 3), np.uint8))
        >>> image.channels, image.height, image.width, image.pixel_format.color_space.name
        (3, 4, 5, 'RGB')
        >>> image.to_gray().shape
        torch.Size([4, 5, 1])
    """

    def __init__(self, data: Tensor, pixel_format: PixelFormat, layout: ImageLayout) -> None:
        size = layout.image_size
        if layout.channels_order is ChannelsOrder.CHANNELS_FIRST:
            _check.shape("Image", "data", data, layout.channels, size.height, size.width)
        else:
            _check.shape("Image", "data", data, size.height, size.width, layout.channels)
        bits = 8 * data.element_size()
        if pixel_format.bit_depth != bits:
            raise ValueCheckError(
                f"Image: expected pixel_format.bit_depth of {bits} for {data.dtype}, got {pixel_format.bit_depth}",
                actual_value=pixel_format.bit_depth,
            )
        channels = _CHANNELS.get(pixel_format.color_space, layout.channels)
        if layout.channels != channels:
            raise ValueCheckError(
                f"Image: expected layout.channels of {channels} for {pixel_format.color_space.name}, "
                f"got {layout.channels}",
                actual_value=layout.channels,
            )
        self._data, self._pixel_format, self._layout = data, pixel_format, layout

    def __repr__(self) -> str:
        return f"Image(data={self.data}, pixel_format={self.pixel_format}, layout={self.layout})"

    @property
    def data(self) -> Tensor:
        """The tensor itself."""
        return self._data

    @property
    def pixel_format(self) -> PixelFormat:
        """Color space and bit depth."""
        return self._pixel_format

    @property
    def layout(self) -> ImageLayout:
        """Size, channels and order of the axes."""
        return self._layout

    @property
    def shape(self) -> torch.Size:
        """Shape of the tensor."""
        return self.data.shape

    @property
    def dtype(self) -> torch.dtype:
        """Type of the tensor's elements."""
        return self.data.dtype

    @property
    def device(self) -> torch.device:
        """Where the tensor is."""
        return self.data.device

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self.layout.channels

    @property
    def image_size(self) -> ImageSize:
        """Height and width."""
        return self.layout.image_size

    @property
    def height(self) -> int:
        """Rows."""
        return self.layout.image_size.height

    @property
    def width(self) -> int:
        """Columns."""
        return self.layout.image_size.width

    @property
    def channels_order(self) -> ChannelsOrder:
        """Whether the channels come first or last."""
        return self.layout.channels_order

    def to(self, device: str | torch.device | torch.dtype | None = None, dtype: torch.dtype | None = None) -> Image:
        """This image on another device or with another dtype, values unscaled; a dtype may also come first."""
        if isinstance(device, torch.dtype):
            device, dtype = None, device
        return self._with(self.data.to(device=device, dtype=dtype))

    def float(self) -> Image:
        """This image in float32, values unscaled."""
        return self.to(dtype=torch.float32)

    def clone(self) -> Image:
        """A copy."""
        return self._with(self.data.clone())

    def to_gray(self) -> Image:
        """This image in gray, from RGB or BGR; ValueCheckError from UNKNOWN."""
        return self._convert(ColorSpace.GRAY)

    def to_rgb(self) -> Image:
        """This image in RGB, from GRAY or BGR; ValueCheckError from UNKNOWN."""
        return self._convert(ColorSpace.RGB)

    def to_bgr(self) -> Image:
        """This image in BGR, from GRAY or RGB; ValueCheckError from UNKNOWN."""
        return self._convert(ColorSpace.BGR)

    @classmethod
    def from_numpy(
        cls,
        data: np.ndarray[Any, Any],
        color_space: ColorSpace | None = None,
        channels_order: ChannelsOrder = ChannelsOrder.CHANNELS_LAST,
    ) -> Image:
        """An image that shares the array's memory where it can, (H, W, C) unless `channels_order` says otherwise.

        One channel (also without an axis for it) is taken for GRAY, three for RGB, any other number for UNKNOWN.

        Raises:
            TypeCheckError: `data` is no array of numbers.
            ShapeError: `data` has not two or three axes.
            ValueCheckError: `color_space` needs another number of channels.
        """
        tensor = view_array("Image.from_numpy", "data", data)
        if tensor.dim() == 2:
            tensor = tensor[None] if channels_order is ChannelsOrder.CHANNELS_FIRST else tensor[..., None]
        return cls._from_tensor("Image.from_numpy", tensor, color_space, channels_order)

    def to_numpy(self) -> np.ndarray[Any, Any]:
        """The data as an array on the CPU, axes as they are stored."""
        array: np.ndarray[Any, Any] = self.data.detach().cpu().numpy()
        return array

    @classmethod
    def from_dlpack(
        cls,
        data: Any,
        color_space: ColorSpace | None = None,
        channels_order: ChannelsOrder = ChannelsOrder.CHANNELS_FIRST,
    ) -> Image:
        """An image that shares the memory of a DLPack capsule (or of an object with `__dlpack__`) with three axes."""
        return cls._from_tensor("Image.from_dlpack", from_dlpack(data), color_space, channels_order)

    def to_dlpack(self) -> Any:
        """A DLPack capsule that shares the tensor's memory; color space and layout are not part of it."""
        return to_dlpack(self.data)

    @classmethod
    def from_file(cls, file_path: str | os.PathLike[str]) -> Image:
        """A file as 8-bit RGB, channels first, on the CPU; see `kvision.io.load_image`."""
        from kvision.io import ImageLoadType, load_image

        data = load_image(file_path, ImageLoadType.RGB8)
        return cls._from_tensor("Image.from_file", data, ColorSpace.RGB, ChannelsOrder.CHANNELS_FIRST)

    def write(self, file_path: str | os.PathLike[str]) -> None:
        """Write an image file in RGB order, in the format its extension names; see `kvision.io.write_image`."""
        from kvision.io import write_image

        write_image(file_path, self._viewable())

    def print(self, max_width: int = 256) -> None:
        """Print the image to a terminal of 256 colors; see `image_to_string`."""
        print(image_to_string(self._viewable(), max_width), end="")

    @classmethod
    def _from_tensor(
        cls, op: str, data: Tensor, color_space: ColorSpace | None, channels_order: ChannelsOrder
    ) -> Image:
        if not isinstance(channels_order, ChannelsOrder):
            raise TypeCheckError(
                f"{op}: expected channels_order to be a ChannelsOrder, got {channels_order!r}",
                actual_type=type(channels_order),
            )
        if data.dim() != 3:
            raise ShapeError(f"{op}: expected data of three axes, got {tuple(data.shape)}", actual_shape=data.shape)
        first = channels_order is ChannelsOrder.CHANNELS_FIRST
        channels, height, width = data.shape if first else data.movedim(-1, 0).shape
        if color_space is None:
            color_space = {1: ColorSpace.GRAY, 3: ColorSpace.RGB}.get(channels, ColorSpace.UNKNOWN)
        layout = ImageLayout(ImageSize(height, width), channels, channels_order)
        return cls(data, PixelFormat(color_space, 8 * data.element_size()), layout)

    def _with(self, data: Tensor) -> Image:
        return self._from_tensor("Image", data, self.pixel_format.color_space, self.channels_order)

    def _planes(self) -> Tensor:
        return self.data if self.channels_order is ChannelsOrder.CHANNELS_FIRST else self.data.movedim(-1, 0)

    def _viewable(self) -> Tensor:
        """(C, H, W), with the channels of a BGR image in RGB order."""
        image = self.to_rgb() if self.pixel_format.color_space is ColorSpace.BGR else self
        return image._planes()

    def _convert(self, target: ColorSpace) -> Image:
        source = self.pixel_format.color_space
        if source is target:
            return self
        if source is ColorSpace.UNKNOWN:
            raise ValueCheckError(
                f"Image: expected color_space GRAY, RGB or BGR to convert to {target.name}, got UNKNOWN"
            )
        planes = self._planes()
        if target is ColorSpace.GRAY:
            planes = rgb_to_grayscale(planes) if source is ColorSpace.RGB else bgr_to_grayscale(planes)
        elif source is ColorSpace.GRAY:
            planes = planes.repeat(3, 1, 1)
        else:
            planes = planes.flip(0)
        if self.channels_order is ChannelsOrder.CHANNELS_LAST:
            planes = planes.movedim(0, -1)
        return self._from_tensor("Image", planes, target, self.channels_order)
