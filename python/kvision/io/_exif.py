"""Which way up a stored image is."""

from __future__ import annotations

import struct

import torch
from torch import Tensor

# EXIF says which sides of the image the first row and the first column are: 1 top left, 2 top right, 3 bottom right,
# 4 bottom left, 5 left top, 6 right top, 7 right bottom, 8 left bottom. From 5 on, rows and columns are exchanged first.
_FLIPPED = {2: (-1,), 3: (-2, -1), 4: (-2,), 6: (-1,), 7: (-2, -1), 8: (-2,)}
_ORIENTATION = 0x0112


def upright(image: Tensor, orientation: int) -> Tensor:
    """A stored image (C, H, W) as it is meant to be seen, contiguous where the orientation is not 1."""
    if orientation == 1:
        return image
    if orientation >= 5:
        image = image.mT
    if orientation not in _FLIPPED:
        return image.contiguous()
    bits = image.view(torch.int16) if image.dtype == torch.uint16 else image  # torch flips no uint16
    return bits.flip(_FLIPPED[orientation]).view(image.dtype).contiguous()  # flip keeps the strides of a transpose


def orientation_of(exif: bytes) -> int:
    """The orientation, 1 to 8, in an EXIF block (a TIFF header and its directories); 1 where there is none to read."""
    value = short_of(exif.removeprefix(b"Exif\0\0"), _ORIENTATION)
    return value if value is not None and 1 <= value <= 8 else 1


def short_of(block: bytes | memoryview, tag: int) -> int | None:
    """The 16-bit number of a tag in the first directory of a TIFF file, or of an EXIF block; None where there is none to read."""
    order = {b"II": "<", b"MM": ">"}.get(bytes(block[:2]))
    if order is None:
        return None
    try:
        (start,) = struct.unpack_from(order + "I", block, 4)
        (entries,) = struct.unpack_from(order + "H", block, start)
        for i in range(entries):
            entry, _, _, value = struct.unpack_from(order + "HHIH", block, start + 2 + 12 * i)
            if entry == tag:
                return int(value)
    except struct.error:  # the block ends before it should
        pass
    return None
