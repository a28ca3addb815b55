"""Image files to tensors, through OpenCV."""

from __future__ import annotations

import os
from enum import Enum
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from kvision.color import rgb_to_grayscale
from kvision.core.exceptions import ImageError, TypeCheckError
from kvision.core.pixels import to_uint8, to_unit
from kvision.io._opencv import pixels_of

__all__ = ["ImageLoadType", "load_image"]


class ImageLoadType(Enum):
    """What `load_image` makes of a file: its own channels and dtype, or gray, RGB, RGBA in 8 bits or floating point.

    Example:
        >>> import kvision as K
        >>> K.io.ImageLoadType.RGB32.value
        5
    """

    UNCHANGED = 0
    GRAY8 = 1
    RGB8 = 2
    RGBA8 = 3
    GRAY32 = 4
    RGB32 = 5


_CHANNELS = {
    ImageLoadType.GRAY8: 1,
    ImageLoadType.RGB8: 3,
    ImageLoadType.RGBA8: 4,
    ImageLoadType.GRAY32: 1,
    ImageLoadType.RGB32: 3,
}
_FLOATING = (ImageLoadType.GRAY32, ImageLoadType.RGB32)


def load_image(
    path_file: str | os.PathLike[str],
    desired_type: ImageLoadType = ImageLoadType.RGB32,
    device: str | torch.device | None = "cpu",
) -> Tensor:
    """Read an image file of any format that OpenCV reads, upright (EXIF orientation) and in RGB order.

    The content decides the format, not the name. GRAY8, RGB8 and RGBA8 give uint8; GRAY32 and RGB32 give float32 in
    [0, 1]. 16-bit files are scaled to the asked range, not cut; files of floating point are taken to be in [0, 1] and
    are clamped only where 8 bits are asked for. Where alpha is not asked for, the image is laid over white; where it
    is asked for and the file has none, it is opaque. Gray is 0.299 R + 0.587 G + 0.114 B.
    UNCHANGED keeps the file's channels and dtype (uint16, float32), except that OpenCV gives the colors of a
    palette, and RGBA for gray with alpha. (OpenCV 4.12 does not tell the orientation of WebP files, later ones do.)

    Args:
        path_file: the file.
        desired_type: channels, dtype and range of the result.
        device: where the result goes; the file is decoded on the CPU.

    Returns:
        (C, H, W), contiguous.

    Raises:
        TypeCheckError: `path_file` is not a path, or `desired_type` no ImageLoadType.
        FileNotFoundError, IsADirectoryError, PermissionError, OSError: the file cannot be read.
        ImageError (a ValueError): the file is empty, damaged, cut short, or of no format that OpenCV reads, or its numbers
            cannot be converted to `desired_type`. Like the OSErrors, it names the file.

    Example:
        >>> import tempfile, pathlib, torch, kvision as K
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "red.png")
        ...     K.io.write_image(path, torch.tensor([1.0, 0.0, 0.0])[:, None, None].expand(3, 2, 2))
        ...     K.io.load_image(path, K.io.ImageLoadType.GRAY8)
        tensor([[[76, 76],
                 [76, 76]]], dtype=torch.uint8)
    """
    if not isinstance(path_file, (str, os.PathLike)):
        raise TypeCheckError(
            f"load_image: expected path_file to be a str or a path, got {type(path_file).__name__}",
            actual_type=type(path_file),
        )
    if not isinstance(desired_type, ImageLoadType):
        raise TypeCheckError(
            f"load_image: expected desired_type to be an ImageLoadType, got {desired_type!r}",
            actual_type=type(desired_type),
        )
    path = Path(path_file)
    data = path.read_bytes()  # an OSError names the file and the reason by itself
    try:
        pixels = pixels_of(np.frombuffer(data, np.uint8)).to(device)
    except ImageError as error:
        raise ImageError(f"load_image: cannot decode '{path}': {error}") from error
    if reason := inconvertible(pixels, desired_type):
        raise ImageError(f"load_image: cannot convert '{path}' to {desired_type.name}: {reason}; load it as UNCHANGED")
    return convert(pixels, desired_type)


def inconvertible(pixels: Tensor, desired_type: ImageLoadType) -> str:
    """Why pixels of a file cannot become `desired_type`; nothing if they can."""
    known = pixels.dtype in (torch.uint8, torch.uint16, torch.float32, torch.float64) and len(pixels) in (1, 3, 4)
    return (
        "" if known or desired_type is ImageLoadType.UNCHANGED else f"it holds {len(pixels)} channels of {pixels.dtype}"
    )


def convert(pixels: Tensor, desired_type: ImageLoadType) -> Tensor:
    """Pixels of a file, (C, H, W) with 1, 3 or 4 channels, as `desired_type` says."""
    if desired_type is ImageLoadType.UNCHANGED:
        return pixels
    channels, floating = _CHANNELS[desired_type], desired_type in _FLOATING
    if floating or pixels.dtype != torch.uint8 or len(pixels) == 4 != channels:
        pixels = to_unit(pixels).float()
    if len(pixels) == 4 != channels:
        color, alpha = pixels[:3], pixels[3:]
        pixels = color * alpha + (1 - alpha)
    if len(pixels) == 3 and channels == 1:
        pixels = rgb_to_grayscale(pixels)
    elif len(pixels) == 1 and channels > 1:
        pixels = pixels.expand(3, -1, -1)
    if len(pixels) == 3 and channels == 4:
        opaque = 1 if pixels.is_floating_point() else 255
        pixels = torch.cat((pixels, torch.full_like(pixels[:1], opaque)))
    return (pixels if floating else to_uint8(pixels)).contiguous()
