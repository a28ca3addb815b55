"""Kinds of inputs, and images between PIL, arrays and tensors."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision._tv_tensors import kind_of
from kvision.core.exceptions import TypeCheckError

IMAGES = frozenset({"tensor", "image", "video", "pil"})
PIXELS = frozenset({*IMAGES, "mask"})
LABELS = frozenset({"boxes", "points"})
EVERYTHING = PIXELS | LABELS


def one_or_two(op: str, name: str, value: Any) -> tuple[Any, Any]:
    """Two numbers, from one for both, or a sequence of one or two."""
    values = [value] if isinstance(value, (int, float)) else value
    if not isinstance(values, (tuple, list)) or len(values) not in (1, 2):
        raise ValueError(f"{op}: expected {name} to be a number or one or two of them, got {value!r}")
    return values[0], values[-1]


def height_and_width(x: Any) -> tuple[int, int]:
    kind = kind_of(x)
    if kind == "pil":
        return x.height, x.width
    if kind in LABELS:
        return tuple(x.canvas_size)
    return x.shape[-2], x.shape[-1]


def channels_of(x: Any) -> int:
    if kind_of(x) == "pil":
        return len(x.getbands())
    return x.shape[-3] if x.ndim > 2 else 1


# --- PIL and arrays -------------------------------------------------------------------------------------------------


def pil_to_tensor(pic: Any) -> Tensor:
    """Copy a PIL image into a tensor of the same type.

    Args:
        pic: a PIL image.

    Returns:
        (C, H, W), channels last in memory, as v2's.

    Raises:
        TypeCheckError: `pic` is no PIL image.

    Example:
        >>> import kvision.tv.functional as F, PIL.Image
        >>> F.pil_to_tensor(PIL.Image.new("RGB", (3, 2))).shape
        torch.Size([3, 2, 3])
    """
    import numpy as np

    if kind_of(pic) != "pil":
        raise TypeCheckError(f"pil_to_tensor: expected pic to be a PIL image, got {type(pic).__name__}")
    return torch.from_numpy(np.array(pic)).view(pic.height, pic.width, len(pic.getbands())).permute(2, 0, 1)


_MODES = {
    1: {"uint8": "L", "bool": "1", "int16": "I;16", "uint16": "I;16", "int32": "I", "float32": "F"},
    2: {"uint8": "LA"},
    3: {"uint8": "RGB"},
    4: {"uint8": "RGBA"},
}
_FURTHER_MODES = {3: ("YCbCr", "HSV"), 4: ("CMYK", "RGBX")}


def to_pil_image(pic: Any, mode: str | None = None) -> Any:
    """Make a PIL image of a tensor or an array.

    Args:
        pic: a tensor (C, H, W) or (H, W), or an array (H, W, C) or (H, W), of at most 4 channels; floats are multiplied by
            255 and truncated.
        mode: PIL's mode; None for the one of the number of channels and the type.

    Returns:
        A PIL image.

    Raises:
        TypeCheckError: `pic` is neither a tensor nor an array, or PIL has no mode for its type.
        ValueError: the shape has no image of PIL, or not of this mode.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.to_pil_image(torch.zeros(3, 2, 4, dtype=torch.uint8)).size
        (4, 2)
    """
    import numpy as np
    import PIL.Image

    if isinstance(pic, Tensor):
        array = (pic.permute(1, 2, 0) if pic.dim() == 3 else pic).numpy(force=True)
    elif kind_of(pic) == "array":
        array = pic
    else:
        raise TypeCheckError(f"to_pil_image: expected pic to be a Tensor or an array, got {type(pic).__name__}")
    if array.ndim not in (2, 3) or (array.ndim == 3 and not 1 <= array.shape[2] <= 4):
        raise ValueError(f"to_pil_image: expected pic of two axes and 1 to 4 channels, got {tuple(pic.shape)}")
    if np.issubdtype(array.dtype, np.floating) and mode != "F":
        array = (array * 255).astype(np.uint8)
    channels = 1 if array.ndim == 2 else array.shape[2]
    modes = _MODES[channels]
    usual = modes.get(array.dtype.name)
    if usual is None:
        raise TypeCheckError(f"to_pil_image: expected pic of {', '.join(modes)}, got {array.dtype.name}")
    if mode is not None and mode != usual and mode not in _FURTHER_MODES.get(channels, ()):
        raise ValueError(f"to_pil_image: expected a mode of {channels} channels of {array.dtype.name}, got {mode!r}")
    array = array[..., 0] if array.ndim == 3 and channels == 1 else array
    if mode is not None and mode != usual:
        return PIL.Image.frombytes(mode, array.shape[1::-1], np.ascontiguousarray(array).tobytes())
    return PIL.Image.fromarray(array.view(np.uint16) if array.dtype == np.int16 else array)  # I;16, not I, as v2's
