"""Image files to tensors, through OpenCV."""

from __future__ import annotations

import os
import struct
import tempfile
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from kvision.color import rgb_to_grayscale
from kvision.core.exceptions import ImageError, TypeCheckError
from kvision.core.pixels import to_uint8, to_unit
from kvision.io._opencv import opencv

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
    pixels = torch.from_numpy(_decode(path)).to(device)
    if desired_type is ImageLoadType.UNCHANGED:
        return pixels
    if pixels.dtype not in (torch.uint8, torch.uint16, torch.float32, torch.float64) or len(pixels) not in (1, 3, 4):
        raise ImageError(
            f"load_image: cannot convert '{path}' to {desired_type.name}: it holds {len(pixels)} channels of "
            f"{pixels.dtype}; load it as UNCHANGED"
        )
    return convert(pixels, desired_type)


def convert(pixels: Tensor, desired_type: ImageLoadType) -> Tensor:
    """Pixels of a file, (C, H, W) with 1, 3 or 4 channels, as `desired_type` (not UNCHANGED) says."""
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


def _decode(path: Path) -> np.ndarray[Any, Any]:
    """The file's pixels (C, H, W), upright, in RGB(A) order, contiguous."""
    data = path.read_bytes()  # an OSError names the file and the reason by itself
    if not data:
        raise ImageError(f"load_image: cannot decode '{path}': the file is empty")
    cv2 = opencv()
    try:
        # Without conversion: OpenCV would cut 16 bits to 8, and drop alpha as soon as it applies the orientation.
        pixels, kinds, blocks = cv2.imdecodeWithMetadata(np.frombuffer(data, np.uint8), flags=cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise ImageError(f"load_image: cannot decode '{path}': {error.err}") from error
    if pixels is None:
        reason = "the file is damaged or cut short" if _has_reader(data) else "it is in no format that OpenCV reads"
        raise ImageError(f"load_image: cannot decode '{path}': {reason}")
    metadata = dict(zip(np.ravel(kinds).tolist(), blocks, strict=True))
    exif = bytes(np.ravel(metadata.get(cv2.IMAGE_METADATA_EXIF, np.empty(0, np.uint8))))
    planes = cv2.split(_apply_orientation(pixels, _orientation(exif)))
    rgb = {3: (2, 1, 0), 4: (2, 1, 0, 3)}.get(len(planes), range(len(planes)))
    return np.stack([planes[c] for c in rgb])


def _has_reader(data: bytes) -> bool:
    """Whether OpenCV reads the format of a file that begins so.

    OpenCV asks for a file. It gets one of ours: the name of another may be no valid text, at which it crashes (5.0), and a
    pipe cannot be read twice.
    """
    with tempfile.NamedTemporaryFile() as file:
        file.write(data[:4096])
        file.flush()
        return bool(opencv().haveImageReader(file.name))


def _apply_orientation(pixels: np.ndarray[Any, Any], orientation: int) -> np.ndarray[Any, Any]:
    """A stored image (H, W) or (H, W, C) as it is meant to be seen.

    EXIF says which sides of the image the first row and the first column are:
    1 top left, 2 top right, 3 bottom right, 4 bottom left, 5 left top, 6 right top, 7 right bottom, 8 left bottom.
    """
    cv2 = opencv()
    if orientation >= 5:
        pixels = cv2.transpose(pixels)
    if orientation in (4, 8):
        pixels = cv2.flip(pixels, 0)
    elif orientation in (2, 6):
        pixels = cv2.flip(pixels, 1)
    elif orientation in (3, 7):
        pixels = cv2.flip(pixels, -1)
    return pixels


def _orientation(exif: bytes) -> int:
    """The orientation, 1 to 8, in an EXIF block (a TIFF header and its directories); 1 where there is none to read."""
    exif = exif.removeprefix(b"Exif\0\0")
    order = {b"II": "<", b"MM": ">"}.get(exif[:2])
    if order is None:
        return 1
    try:
        (start,) = struct.unpack_from(order + "I", exif, 4)
        (entries,) = struct.unpack_from(order + "H", exif, start)
        for i in range(entries):
            tag, _, _, value = struct.unpack_from(order + "HHIH", exif, start + 2 + 12 * i)
            if tag == 0x0112:
                return int(value) if 1 <= value <= 8 else 1
    except struct.error:  # the block ends before it should
        pass
    return 1
