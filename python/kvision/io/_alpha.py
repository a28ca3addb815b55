"""What OpenCV leaves undone of the transparency of PNG and TIFF files."""

from __future__ import annotations

import struct

import torch
from torch import Tensor

from kvision.core.exceptions import ImageError
from kvision.io._exif import short_of

_PNG, _TIFF = b"\x89PNG\r\n\x1a\n", (b"II*\0", b"MM\0*")
_CHUNK = struct.Struct(">I4s")  # length, kind
_SAMPLES, _EXTRA_SAMPLES = 0x0115, 0x0152
_ASSOCIATED, _UNASSOCIATED = 1, 2  # colors that are multiplied by alpha, and others


def with_straight_alpha(image: Tensor, data: memoryview) -> Tensor:
    """The pixels (C, H, W) that OpenCV reads from a file, without loss of the file's alpha, and not multiplied by it.

    OpenCV multiplies colors of TIFF files of bytes by alpha, drops the alpha of gray TIFF files, and does not see which level of
    a gray PNG file is transparent.

    Raises:
        ImageError: the alpha is lost.
    """
    start = bytes(data[:8])
    if start == _PNG:
        level = _transparent_gray(data) if image.shape[0] == 1 else None
        if level is None:
            return image
        top = torch.iinfo(image.dtype).max
        alpha = (image.int() != level).to(torch.int32) * top
        return torch.cat([image, image, image, alpha.to(image.dtype)])
    if start[:4] not in _TIFF:
        return image
    if image.shape[0] == 1 and short_of(data, _SAMPLES) == 2:
        raise ImageError("OpenCV drops the alpha of gray TIFF files")
    kind = short_of(data, _EXTRA_SAMPLES)
    is_multiplied = kind == _ASSOCIATED or (kind == _UNASSOCIATED and image.dtype == torch.uint8)
    if image.shape[0] != 4 or image.dtype not in (torch.uint8, torch.uint16) or not is_multiplied:
        return image
    values, top = image.to(torch.float64), torch.iinfo(image.dtype).max
    colors = (values[:3] * top / values[3:].clamp(min=1)).round().clamp(max=top)
    return torch.cat([colors, values[3:]]).to(image.dtype)


def _transparent_gray(data: memoryview) -> int | None:
    """The level of a gray PNG file that is transparent, of 8 or 16 bits."""
    bits, color = data[24], data[25]  # of the header, which is the first chunk
    at = len(_PNG)
    while color == 0 and at + _CHUNK.size <= len(data):
        length, kind = _CHUNK.unpack_from(data, at)
        if kind == b"tRNS" and length == 2 and at + 10 <= len(data):
            (level,) = struct.unpack_from(">H", data, at + 8)
            return level if bits == 16 else level * 255 // (2**bits - 1)
        if kind == b"IDAT":
            break
        at += 12 + length
    return None
