"""OpenCV, imported when the first file is read or written: `import kvision` does not need it."""

from __future__ import annotations

import functools
import tempfile
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from kvision._hints import look_at_opencv
from kvision.core.exceptions import ImageError
from kvision.io._alpha import with_straight_alpha
from kvision.io._exif import orientation_of, upright


@functools.cache
def opencv() -> ModuleType:
    """The module cv2; a hint comes with it where several distributions have written its files."""
    try:
        import cv2
    except ImportError as error:
        raise ImportError(
            "kvision.io reads and writes files with OpenCV: pip install opencv-python-headless"
        ) from error
    if not hasattr(cv2, "imdecodeWithMetadata"):
        raise ImportError(
            f"kvision.io needs OpenCV 4.12 or newer, found {cv2.__version__}: pip install -U opencv-python-headless"
        )
    look_at_opencv()
    return cv2


def pixels_of(data: np.ndarray[Any, Any]) -> Tensor:
    """The pixels (C, H, W) of an image file, upright, in RGB(A) order, in the file's type, contiguous.

    Raises:
        ImageError: the reason alone, for a message that names the file.
    """
    if not len(data):
        raise ImageError("the file is empty")
    cv2 = opencv()
    try:
        # Without conversion: OpenCV would cut 16 bits to 8, and drop alpha as soon as it applies the orientation.
        pixels, kinds, blocks = cv2.imdecodeWithMetadata(data, flags=cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise ImageError(error.err) from error
    if pixels is None:
        has_reader = _has_reader(data[:4096].tobytes())
        raise ImageError("the file is damaged or cut short" if has_reader else "it is in no format that OpenCV reads")
    metadata = dict(zip(np.ravel(kinds).tolist(), blocks, strict=True))
    exif = bytes(np.ravel(metadata.get(cv2.IMAGE_METADATA_EXIF, np.empty(0, np.uint8))))
    planes = cv2.split(pixels)
    rgb = {3: (2, 1, 0), 4: (2, 1, 0, 3)}.get(len(planes), range(len(planes)))
    image = with_straight_alpha(torch.from_numpy(np.stack([planes[c] for c in rgb])), data.data)
    return upright(image, orientation_of(exif))


def _has_reader(start: bytes) -> bool:
    """Whether OpenCV reads the format of a file that begins so.

    OpenCV asks for a file. It gets one of ours: the name of another may be no valid text, at which it crashes (5.0), and a
    pipe cannot be read twice.
    """
    with tempfile.NamedTemporaryFile() as file:
        file.write(start)
        file.flush()
        return bool(opencv().haveImageReader(file.name))
