"""Images of NumPy, PIL, OpenCV and files as tensors, and back: the one place where they are converted."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from kvision import _check
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.core.pixels import to_dtype, to_uint8, to_unit
from kvision.image.convert import view_array

__all__ = ["to_numpy", "to_pil", "to_tensor"]

# PIL's modes whose channels are neither brightness nor RGB, or are so times alpha, and what they are converted to.
_MODES = {
    "CMYK": "RGB",
    "HSV": "RGB",
    "LAB": "RGB",
    "PA": "RGBA",
    "RGBX": "RGB",
    "RGBa": "RGBA",
    "La": "LA",
    "YCbCr": "RGB",
}


def to_tensor(images: Any, dtype: torch.dtype | None = None, *, bgr: bool = False) -> Tensor | list[Tensor]:
    """Images of NumPy, PIL, OpenCV or files as tensors with the channels first, in memory of their own.

    Values keep their type, or get `dtype` and are scaled from the range of the one to that of the other: integers reach up to the
    largest number of their type, floating point is in [0, 1]. Palettes and the colors of print (CMYK), video (YCbCr), HSV and LAB
    become RGB. Files are read as :func:`kvision.io.load_image` reads them, upright; PIL images are not turned.

    Args:
        images: an array (H, W), (H, W, C) or (B, H, W, C), a PIL image, a path, or a list of those. Tensors are channels-first
            already, and only get the type.
        dtype: a floating-point type or uint8; default: that of the image.
        bgr: arrays have their colors in the order of OpenCV, blue first.

    Returns:
        (1, H, W) for (H, W); (C, H, W) for (H, W, C); (B, C, H, W) for (B, H, W, C). For a list a batch (B, C, H, W) where all
        images have one size and type, else a list.

    Raises:
        TypeError: `images` is none of these, of a type that torch does not have; `dtype` is another type.
        ValueError: an array has less than two axes; a list is empty; `bgr` and other than 1, 3 or 4 channels.
        OSError, ImageError: a file cannot be read.

    Example:
        >>> import numpy as np, torch, kvision as K
        >>> photo = np.full((480, 640, 3), 255, np.uint8)
        >>> K.to_tensor(photo).shape, K.to_tensor([photo, photo], torch.float32).max()
        (torch.Size([3, 480, 640]), tensor(1.))
    """
    _check_options("to_tensor", dtype, bgr)
    return _tensors("to_tensor", "images", images, dtype, bgr)


def to_numpy(images: Any, dtype: torch.dtype | None = None, *, bgr: bool = False) -> Any:
    """Tensors as NumPy images with the channels last, on the CPU, in memory of their own; the way back from :func:`to_tensor`.

    Gradients end here. bfloat16, which NumPy lacks, becomes float32.

    Args:
        images: a tensor (H, W), (C, H, W) or (B, C, H, W), or a list of those; or what :func:`to_tensor` takes.
        dtype: a floating-point type or uint8, to whose range values are scaled; default: that of the image.
        bgr: give colors in the order of OpenCV, blue first.

    Returns:
        (H, W) for (1, H, W); (H, W, C) for (C, H, W); (B, H, W, C) for (B, C, H, W); a list for a list.

    Raises:
        TypeError: `images` is none of these; `dtype` is another type.
        ValueError: a tensor has other axes; `bgr` and other than 1, 3 or 4 channels.

    Example:
        >>> import torch, kvision as K
        >>> K.to_numpy(torch.rand(3, 480, 640), torch.uint8, bgr=True).shape
        (480, 640, 3)
    """
    _check_options("to_numpy", dtype, bgr)
    if isinstance(images, (list, tuple)):
        return [to_numpy(image, dtype, bgr=bgr) for image in images]
    x = _rank("to_numpy", images if isinstance(images, Tensor) else to_tensor(images))
    x = to_dtype(x.detach().cpu(), dtype)
    array = channels_last(_swapped("to_numpy", x) if bgr else x)
    return array[..., 0] if x.dim() == 3 and array.shape[-1] == 1 else array


def to_pil(images: Any) -> Any:
    """Tensors as PIL images, a batch as a list.

    uint8 keeps its values; floating point is taken to be in [0, 1], clamped, with NaN black, and rounded to 8 bits. Other integers
    keep their values where there is one channel (modes "1", "I;16" and "I"), as masks do; colors are scaled to 8 bits.

    Args:
        images: a tensor (H, W), (C, H, W) or (B, C, H, W) of 1 to 4 channels, or a list of those; or what :func:`to_tensor` takes.

    Returns:
        An image of mode "L", "LA", "RGB" or "RGBA", or of those above; a list of them for a batch or a list.

    Raises:
        TypeError: `images` is none of these.
        ValueError: a tensor has other axes or channels, or integers beyond 32 bits.

    Example:
        >>> import torch, kvision as K
        >>> K.to_pil(torch.rand(3, 480, 640)).size
        (640, 480)
    """
    if _check.is_pil(images):
        return images
    if isinstance(images, (list, tuple)):
        return [to_pil(image) for image in images]
    x = _rank("to_pil", images if isinstance(images, Tensor) else to_tensor(images))
    return [_pil(image) for image in x] if x.dim() == 4 else _pil(x if x.dim() == 3 else x[None])


def module_image(module: Any, x: Any) -> Tensor:
    """An image as a module takes it: floating point, integers in [0, 1], with the device and type of the module's state."""
    image = _tensors("to_tensor", "x", x, None, False)
    if not isinstance(image, Tensor):
        raise TypeCheckError(f"to_tensor: expected x to be one image or images of one size, got {type(x).__name__}")
    image = to_unit(image)
    state = [*module.parameters(), *module.buffers()] if isinstance(module, nn.Module) else []
    like = next((p for p in state if p.is_floating_point()), None)
    return image if like is None else image.to(like)


def channels_last(x: Tensor) -> np.ndarray[Any, Any]:
    """A tensor as an array of its own memory; (C, H, W) and (B, C, H, W) with the channels last."""
    x = x.detach().cpu()
    array = (x.float() if x.dtype == torch.bfloat16 else x).numpy()
    return np.array(np.moveaxis(array, -3, -1) if x.dim() in (3, 4) else array, order="C")


def label_image(x: Any) -> Tensor:
    """A mask of NumPy or PIL as a tensor with its values, also the numbers of a palette: (1, H, W), or the channels first."""
    return _channels_first("to_tensor", "mask", np.array(x) if _check.is_pil(x) else x)


def _check_options(op: str, dtype: Any, bgr: Any) -> None:
    _check.flag(op, "bgr", bgr)
    if dtype is not None and dtype not in (*_check.FLOATING, torch.uint8):
        raise TypeCheckError(f"{op}: expected dtype to be uint8 or a floating-point type, got {dtype!r}")


def _tensors(op: str, name: str, x: Any, dtype: torch.dtype | None, bgr: bool) -> Any:
    if isinstance(x, (list, tuple)):
        if not x:
            raise ValueCheckError(f"{op}: expected {name} to hold at least one image, got an empty {type(x).__name__}")
        return _batch([_tensors(op, f"{name}[{i}]", image, dtype, bgr) for i, image in enumerate(x)])
    if isinstance(x, Tensor):
        return to_dtype(x, dtype)
    if isinstance(x, (str, os.PathLike)):
        from kvision.io import ImageLoadType, load_image

        return to_dtype(load_image(x, ImageLoadType.UNCHANGED), dtype)
    if isinstance(x, np.ndarray):
        image = _channels_first(op, name, x)
        return to_dtype(_swapped(op, image) if bgr else image, dtype)
    if _check.is_pil(x):
        mode = _MODES.get(x.mode)
        if x.mode == "P":
            mode = "RGBA" if "transparency" in x.info or getattr(x.palette, "mode", "RGB") == "RGBA" else "RGB"
        return to_dtype(_channels_first(op, name, np.array(x if mode is None else x.convert(mode))), dtype)
    raise TypeCheckError(
        f"{op}: expected {name} to be a Tensor, an array, a PIL image or a path, or a list of those, got {type(x).__name__}",
        actual_type=type(x),
    )


def _batch(images: Sequence[Any]) -> Any:
    first = images[0]
    same = all(isinstance(x, Tensor) and x.shape == first.shape and x.dtype == first.dtype for x in images)
    return torch.stack(list(images)) if same else images


def _channels_first(op: str, name: str, array: np.ndarray[Any, Any]) -> Tensor:
    x = view_array(op, name, array)
    if x.dim() < 2:
        raise ShapeError(
            f"{op}: expected {name} of shape (H, W), (H, W, C) or (B, H, W, C), got {tuple(x.shape)}",
            actual_shape=x.shape,
        )
    x = x[None] if x.dim() == 2 else x.movedim(-1, -3)
    return x.clone(memory_format=torch.contiguous_format)


def _swapped(op: str, x: Tensor) -> Tensor:
    """Colors (..., C, H, W) in the opposite order, before alpha; one channel as it is."""
    channels = 1 if x.dim() == 2 else x.shape[-3]
    if channels == 1:
        return x
    if channels not in (3, 4):
        raise ShapeError(f"{op}: expected images of 1, 3 or 4 channels with bgr, got {channels}", actual_shape=x.shape)
    return x[..., [2, 1, 0, *range(3, channels)], :, :]


def _rank(op: str, x: Any) -> Tensor:
    _check.is_tensor(op, "images", x)
    if not 2 <= x.dim() <= 4:
        raise ShapeError(
            f"{op}: expected images of shape (H, W), (C, H, W) or (B, C, H, W), got {tuple(x.shape)}",
            actual_shape=x.shape,
        )
    checked: Tensor = x
    return checked


def _pil(x: Tensor) -> Any:
    """(C, H, W) as a PIL image."""
    import PIL.Image

    if not 1 <= len(x) <= 4:
        advice = _check.channels_advice(x.shape)
        raise ShapeError(f"to_pil: expected images of 1 to 4 channels, got {len(x)}{advice}", actual_shape=x.shape)
    x = x.detach().cpu()
    keeps = len(x) == 1 and not x.is_floating_point()
    if not keeps:
        x = to_uint8(x)
    elif x.dtype not in (torch.bool, torch.uint8, torch.uint16):
        wide = x.to(torch.int64)
        if x.numel() and (int(wide.max()) > _check.LARGEST_INT or int(wide.min()) < -_check.LARGEST_INT - 1):
            raise ValueCheckError("to_pil: expected integers of at most 32 bits, which PIL has")
        x = wide.to(torch.int32)
    array = channels_last(x)
    return PIL.Image.fromarray(array[..., 0] if len(x) == 1 else array)
