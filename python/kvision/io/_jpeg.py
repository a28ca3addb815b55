"""The header of a JPEG file."""

from __future__ import annotations

import struct
from typing import NamedTuple

from kvision.io._exif import orientation_of

_SEGMENT = struct.Struct(">BBH")  # 0xff, kind, length
_FRAME = struct.Struct(">BHHB")  # bits, height, width, components
_ENDS = struct.Struct(">H")
_FRAMES = (0xC0, 0xC1, 0xC2)  # baseline, extended, progressive; with Huffman codes
_TABLES = (0xC4, 0xDB)  # of codes, of quantization
_START_OF_SCAN, _JFIF, _EXIF, _ADOBE = 0xDA, 0xE0, 0xE1, 0xEE


class JpegHeader(NamedTuple):
    """Of a JPEG file that all decoders take alike."""

    components: int  # 1 is gray, 3 is YCbCr
    orientation: int


def jpeg_header(data: bytes | memoryview) -> JpegHeader | None:
    """The header of a JPEG file of 8 bits, gray or YCbCr, that ends as it should. None for others and for what is no JPEG file.

    Others are CMYK and RGB, whose conversion decoders disagree on, and files without an end, which some decode in silence.
    """
    size = len(data)
    if size < 4 or _ENDS.unpack_from(data)[0] != 0xFFD8 or _ENDS.unpack_from(data, size - 2)[0] != 0xFFD9:
        return None
    components, orientation, transform, ids = 0, 1, None, b""
    at = 2
    while at + 14 <= size:
        mark, kind, length = _SEGMENT.unpack_from(data, at)
        if mark != 0xFF:
            return None
        if kind in _TABLES:  # most segments, and of no interest
            at += 2 + length
            continue
        if kind == 0xFF:  # a byte of padding
            at += 1
            continue
        if kind == _START_OF_SCAN:
            is_rgb = transform == 0 or (transform is None and ids == b"RGB")
            return JpegHeader(components, orientation) if components == 1 or (components == 3 and not is_rgb) else None
        body = at + 4
        if kind in _FRAMES:
            bits, height, width, components = _FRAME.unpack_from(data, body)
            if bits != 8 or not height or not width:
                return None
            if transform is None:
                ids = bytes(data[body + 6 : body + 6 + 3 * components : 3])
        elif kind == _JFIF and transform is None:
            transform = 1
        elif kind == _EXIF and orientation == 1 and data[body : body + 6] == b"Exif\0\0":
            orientation = orientation_of(bytes(data[body : at + 2 + length]))
        elif kind == _ADOBE and transform is None and length >= 14 and data[body : body + 5] == b"Adobe":
            transform = data[body + 11]
        at += 2 + length
    return None
