"""Tensors to image files, through OpenCV."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ImageError, ShapeError, TypeCheckError, ValueCheckError
from kvision.core.pixels import to_uint8
from kvision.io._opencv import opencv

__all__ = ["write_image"]

# What each format stores: numbers of channels, dtypes.
_JPEG = ((1, 3), (torch.uint8,))
_PNG = ((1, 3, 4), (torch.uint8, torch.uint16))
_TIFF = ((1, 3, 4), (torch.uint8, torch.uint16, torch.float32))
_WEBP = ((1, 3, 4), (torch.uint8,))
_FORMATS = {".jpg": _JPEG, ".jpeg": _JPEG, ".png": _PNG, ".tif": _TIFF, ".tiff": _TIFF, ".webp": _WEBP}


def write_image(path_file: str | os.PathLike[str], image: Tensor, quality: int = 80) -> None:
    """Write an image file in the format its extension names: .jpg, .jpeg, .png, .tif, .tiff or .webp, in any case.

    uint8 is stored as it is in every format, uint16 in PNG and TIFF, float32 in TIFF. Other floating point (in TIFF
    only half and double, as float32) is taken to be in [0, 1]: it is clamped, with NaN black, and rounded to 8 bits.

    Args:
        path_file: the file; it is overwritten.
        image: (C, H, W) or (H, W), on any device, gray or RGB; also RGBA, except for JPEG.
        quality: of JPEG and WebP, 0 to 100.

    Raises:
        TypeCheckError: `path_file` is not a path, `image` no tensor or of a dtype the format cannot store, or `quality`
            no int.
        ShapeError: `image` has another shape, no pixel, or a number of channels the format cannot store.
        ValueCheckError: the extension is unknown, or `quality` is not in 0 to 100.
        FileNotFoundError, NotADirectoryError, IsADirectoryError, PermissionError, OSError: the file cannot be
            written; a missing folder is not made.
        ImageError: OpenCV cannot encode the image, say because WebP ends at 16383 pixels a side.

    Example:
        >>> import tempfile, pathlib, torch, kvision as K
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "gray.png")
        ...     K.io.write_image(path, torch.tensor([[0.0, 0.5, 1.0]]))
        ...     K.io.load_image(path, K.io.ImageLoadType.UNCHANGED)
        tensor([[[  0, 128, 255]]], dtype=torch.uint8)
    """
    data = encoded(path_file, image, quality)
    Path(path_file).write_bytes(data)  # an OSError names the file and the reason by itself


def encoded(path_file: str | os.PathLike[str], image: Tensor, quality: int = 80) -> bytes:
    """What :func:`write_image` writes to a file of this name."""
    if not isinstance(path_file, (str, os.PathLike)):
        raise TypeCheckError(
            f"write_image: expected path_file to be a str or a path, got {type(path_file).__name__}",
            actual_type=type(path_file),
        )
    _check.is_tensor("write_image", "image", image)
    quality = _check.scalar("write_image", "quality", quality)
    if not isinstance(quality, int) or isinstance(quality, bool):
        raise TypeCheckError(f"write_image: expected quality to be an int, got {quality!r}", actual_type=type(quality))
    if not 0 <= quality <= 100:
        raise ValueCheckError(f"write_image: expected quality in 0 to 100, got {quality}", actual_value=quality)
    path = Path(path_file)
    suffix = path.suffix.lower()
    if suffix not in _FORMATS:
        raise ValueCheckError(
            f"write_image: extension must be one of {', '.join(_FORMATS)}; got {path.suffix!r} in '{path}'",
            actual_value=path.suffix,
        )
    channels, dtypes = _FORMATS[suffix]
    planes = image[None] if image.dim() == 2 else image
    if planes.dim() != 3 or 0 in planes.shape or len(planes) not in channels:
        raise ShapeError(
            f"write_image: expected image of shape (C, H, W) with C of {' or '.join(map(str, channels))} for {suffix}, "
            f"got {tuple(image.shape)}{_check.channels_advice(image.shape)}",
            actual_shape=image.shape,
        )
    if planes.is_floating_point():
        planes = planes.float() if torch.float32 in dtypes else to_uint8(planes)
    if planes.dtype not in dtypes:
        listed = ", ".join(str(dtype).removeprefix("torch.") for dtype in dtypes)
        raise TypeCheckError(
            f"write_image: expected image to be floating point or {listed} for {suffix}, got {image.dtype}",
            actual_type=image.dtype,
        )
    return _encode(path, planes, quality)


def _encode(path: Path, planes: Tensor, quality: int) -> bytes:
    cv2 = opencv()
    pixels = planes.detach().cpu().numpy()
    bgr = {3: [2, 1, 0], 4: [2, 1, 0, 3]}.get(len(pixels), slice(None))
    pixels = np.ascontiguousarray(np.moveaxis(pixels[bgr], 0, 2))
    suffix = path.suffix.lower()
    options: tuple[int, ...] = ()
    if suffix == ".webp":
        options = (cv2.IMWRITE_WEBP_QUALITY, max(quality, 1))
    elif suffix in (".jpg", ".jpeg"):
        options = (cv2.IMWRITE_JPEG_QUALITY, quality)
    elif suffix in (".tif", ".tiff"):
        options = (cv2.IMWRITE_TIFF_COMPRESSION, cv2.IMWRITE_TIFF_COMPRESSION_LZW)  # OpenCV 4's default loses floats
    try:
        done, data = cv2.imencode(suffix, pixels, options)
    except cv2.error as error:
        raise ImageError(f"write_image: cannot encode '{path}': {error.err}") from error
    if not done:
        raise ImageError(f"write_image: cannot encode '{path}': OpenCV refuses {tuple(planes.shape)} {planes.dtype}")
    return bytes(data)
