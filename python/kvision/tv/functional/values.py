"""Functions of types, noise, erased parts, JPEG and frames, by the arguments of torchvision.transforms.v2.functional."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from itertools import accumulate
from typing import Any

import torch
from torch import Tensor

from kvision._tv_tensors import kind_of
from kvision.core.exceptions import TypeCheckError
from kvision.tv.functional.dispatch import Function, functional, on_device
from kvision.tv.inputs import channels_of, height_and_width, pil_to_tensor, to_pil_image

# A byte that is rounded after this shift is truncated: half a level below, but for rounding errors of integers.
HALF_A_LEVEL_DOWN = (-0.5 + 2.0**-10) / 255


def truncated(x: Tensor) -> float:
    """What to add to values in [0, 1] so that they are truncated where results are bytes."""
    return HALF_A_LEVEL_DOWN if x.dtype == torch.uint8 else 0.0


def largest(dtype: torch.dtype) -> float:
    """White."""
    return 1.0 if dtype.is_floating_point else 1.0 if dtype == torch.bool else float(torch.iinfo(dtype).max)


def of_all_types(kernel: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """A kernel of floating point and uint8, which computes other integers as fractions of white."""

    def call(x: Tensor, *args: Any) -> Tensor:
        if x.is_floating_point() or x.dtype == torch.uint8:
            return kernel(x, *args)
        white = largest(x.dtype)
        return (kernel(x.double() / white, *args) * white).to(x.dtype)

    return call


def tensors_only(name: str) -> Callable[..., Any]:
    def refuse(*_: Any, **__: Any) -> Any:
        raise TypeCheckError(f"{name}: expected a tensor, got a PIL image; put ToImage before")

    return refuse


def _bits(dtype: torch.dtype) -> int:
    return torch.iinfo(dtype).max.bit_length()


@functional(
    moves=True, pil=tensors_only("to_dtype"), mask=lambda mask, dtype=torch.float32, scale=False: mask.to(dtype)
)
def to_dtype(inpt: Tensor, dtype: torch.dtype = torch.float32, scale: bool = False) -> Tensor:
    """Convert an image to another type; masks keep their values, boxes and key points are torchvision's.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        dtype: the type.
        scale: white stays white: 255 of uint8 is 1 of float32.

    Returns:
        What is given, of the type.

    Raises:
        RuntimeError: the floating-point type of `inpt` has not all values of the type.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.to_dtype(torch.tensor([[[51]]], dtype=torch.uint8), torch.float32, scale=True)
        tensor([[[0.2000]]])
    """
    if inpt.dtype == dtype:
        return inpt
    if not scale:
        return inpt.to(dtype)
    source = inpt.dtype
    if dtype.is_floating_point:
        return inpt.to(dtype) if source.is_floating_point else inpt.to(dtype).mul_(1 / largest(source))
    if source.is_floating_point:
        if torch.finfo(source).bits <= _bits(dtype) + 1:
            raise RuntimeError(f"to_dtype: expected a floating-point type that has all values of {dtype}, got {source}")
        return inpt.mul(largest(dtype) + 1 - 1e-3).to(dtype)
    shift = _bits(dtype) - _bits(source)
    if torch.uint16 in (source, dtype):  # has no shifts
        wide = inpt.to(torch.int64)
        return (wide << shift if shift > 0 else wide >> -shift).to(dtype)
    return inpt.to(dtype) << shift if shift > 0 else (inpt >> -shift).to(dtype)


def convert_image_dtype(image: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
    """Convert an image to another type; white stays white.

    Args:
        image: a tensor, tv_tensor or PIL image.
        dtype: the type.

    Returns:
        The image, of the type.

    Raises:
        RuntimeError: as :func:`to_dtype`.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.convert_image_dtype(torch.tensor([[[51]]], dtype=torch.uint8))
        tensor([[[0.2000]]])
    """
    return to_dtype(image, dtype, scale=True)


@functional(pil=tensors_only("gaussian_noise"))
def gaussian_noise(inpt: Tensor, mean: float = 0.0, sigma: float = 0.1, clip: bool = True) -> Tensor:
    """Add normally distributed noise to an image of floating point or uint8.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        mean: of the noise, as a fraction of white.
        sigma: its standard deviation.
        clip: keep values between black and white; without it bytes wrap.

    Returns:
        What is given, of the same type and size.

    Raises:
        TypeCheckError, ValueError: no tensor of floating point or uint8; sigma is below 0.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.gaussian_noise(torch.ones(3, 8, 6), sigma=0.0).mean()
        tensor(1.)
    """
    if sigma < 0:
        raise ValueError(f"gaussian_noise: expected a sigma of at least 0, got {sigma}")
    if inpt.is_floating_point():
        output = inpt + (mean + torch.randn_like(inpt) * sigma)
        return output.clamp_(0, 1) if clip else output
    if inpt.dtype != torch.uint8:
        raise ValueError(f"gaussian_noise: expected floating point or uint8, got {inpt.dtype}")
    noise = (mean * 255 + torch.randn_like(inpt, dtype=torch.float32) * (sigma * 255)).to(torch.int16)
    output = inpt + noise
    return (output.clamp_(0, 255) if clip else output).to(torch.uint8)


def _erase_each(x: Tensor, rows: list[dict[str, Any]]) -> Any:
    if rows[0]["inplace"]:
        return NotImplemented
    if x.device.type == "cpu":  # 8 times as fast as choosing for each pixel
        output = x.clone()
        for i, row in enumerate(rows):
            output[i, :, row["i"] : row["i"] + row["h"], row["j"] : row["j"] + row["w"]] = row["v"]
        return output
    return _fill_windows(x, rows)


def _fill_windows(x: Tensor, rows: list[dict[str, Any]]) -> Tensor:
    """Set a window of each image to its value, without a launch for each."""
    color, sizes = rows[0]["v"], [row["h"] * row["w"] for row in rows]
    is_noise = any(row["v"] is not color for row in rows)
    firsts = [0, *accumulate(x.shape[1] * size for size in sizes[:-1])]
    numbers = [(*operator.itemgetter(*"ijhw")(row), first) for row, first in zip(rows, firsts)]
    top, left, height, width, first = on_device(numbers, x.device).T[..., None]
    y, column = (torch.arange(n, device=x.device) for n in x.shape[-2:])
    is_row, is_column = (y >= top) & (y < top + height), (column >= left) & (column < left + width)
    is_inside = is_row[:, None, :, None] & is_column[:, None, None]
    if not is_noise:
        return torch.where(is_inside, on_device(color.to(x.dtype), x.device), x)
    # The noise of all windows is one row, which each pixel of them reads.
    noise = [row["v"].expand(x.shape[1], row["h"], row["w"]).flatten() for row in rows]
    values = on_device(torch.cat(noise).to(x.dtype), x.device)
    of_row = ((y - top) * width)[:, None, :, None] + (column - left)[:, None, None]
    channel = torch.arange(x.shape[1], device=x.device)[:, None, None]
    at = first[..., None, None] + channel * (height * width)[..., None, None] + of_row
    return torch.where(~is_inside, x, values[torch.where(is_inside, at, 0)])  # in the layout of what comes first


@functional(each=_erase_each)
def erase(inpt: Tensor, i: int, j: int, h: int, w: int, v: Tensor, inplace: bool = False) -> Tensor:
    """Set a window of an image (*, C, H, W) to a value.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        i: first row.
        j: first column.
        h: height.
        w: width.
        v: the value, which broadcasts to (C, h, w).
        inplace: write into the image.

    Returns:
        What is given, of the same type and size.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.erase(torch.ones(1, 1, 3), 0, 1, 1, 1, torch.zeros(1))
        tensor([[[1., 0., 1.]]])
    """
    output = inpt if inplace else inpt.clone()
    output[..., i : i + h, j : j + w] = v
    return output


def _jpeg_pil(image: Any, quality: int) -> Any:
    import io

    import PIL.Image

    stream = io.BytesIO()
    image.save(stream, format="JPEG", quality=quality)
    return PIL.Image.open(stream).copy()


@functional(pil=_jpeg_pil)
def jpeg(image: Tensor, quality: int) -> Tensor:
    """Compress and decompress a uint8 image of 1 or 3 channels, by torchvision's codec or, without it, Pillow's.

    Args:
        image: a tensor, tv_tensor or PIL image.
        quality: 1 to 100.

    Returns:
        What is given, of the same type and size.

    Raises:
        TypeCheckError: not uint8 of 1 or 3 channels.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.jpeg(torch.full((3, 8, 8), 128, dtype=torch.uint8), 90).shape
        torch.Size([3, 8, 8])
    """
    if image.dtype != torch.uint8 or image.shape[-3] not in (1, 3):
        raise TypeCheckError(f"jpeg: expected uint8 of 1 or 3 channels, got {image.dtype} {tuple(image.shape)}")
    batch = image.reshape(-1, *image.shape[-3:])
    if batch.shape[0] == 0:
        return image.clone()
    try:
        from torchvision.io import decode_jpeg, encode_jpeg
    except ImportError:
        coded = [pil_to_tensor(_jpeg_pil(to_pil_image(x), quality)).to(image.device) for x in batch]
    else:
        coded = [decode_jpeg(encode_jpeg(x.cpu(), quality)).to(image.device) for x in batch]
    return torch.stack(coded).reshape(image.shape)


@functional()
def uniform_temporal_subsample(inpt: Tensor, num_samples: int) -> Tensor:
    """Choose frames at equal distances from videos (*, T, C, H, W), the first and the last among them.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        num_samples: how many.

    Returns:
        The frames, of the type of `inpt`.

    Raises:
        ValueError: `inpt` is no video (*, T, C, H, W).

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.uniform_temporal_subsample(torch.arange(5.0).reshape(5, 1, 1, 1), 3).flatten()
        tensor([0., 2., 4.])
    """
    if inpt.dim() < 4:
        raise ValueError(f"uniform_temporal_subsample: expected a video (*, T, C, H, W), got {tuple(inpt.shape)}")
    frames = torch.linspace(0, inpt.shape[-4] - 1, num_samples, device=inpt.device).long()
    return inpt.index_select(-4, frames)


# --- kinds of inputs ------------------------------------------------------------------------------------------------


def to_image(inpt: Any) -> Tensor:
    """A tensor, an array (H, W, C) or (H, W), or a PIL image as tv_tensors.Image; a tensor where torchvision is missing.

    Args:
        inpt: a tensor, an array or a PIL image.

    Returns:
        (C, H, W).

    Raises:
        TypeCheckError: `inpt` is none of these.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.to_image(torch.ones(3, 4, 5)).shape
        torch.Size([3, 4, 5])
    """
    kind = kind_of(inpt)
    if kind == "pil":
        inpt = pil_to_tensor(inpt)
    elif kind == "array":
        inpt = torch.from_numpy(inpt[..., None] if inpt.ndim < 3 else inpt).permute(2, 0, 1).contiguous()
    elif not isinstance(inpt, Tensor):
        raise TypeCheckError(f"to_image: expected a tensor, an array or a PIL image, got {type(inpt).__name__}")
    try:
        from torchvision.tv_tensors import Image
    except ImportError:
        return inpt
    return Image(inpt)


def get_dimensions(inpt: Any) -> list[int]:
    """Channels, height and width.

    Args:
        inpt: a tensor, tv_tensor or PIL image.

    Returns:
        A list of the three.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.get_dimensions(torch.ones(3, 4, 5))
        [3, 4, 5]
    """
    return [channels_of(inpt), *height_and_width(inpt)]


def get_num_channels(inpt: Any) -> int:
    """The number of channels.

    Args:
        inpt: a tensor, tv_tensor or PIL image.

    Returns:
        An int.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.get_num_channels(torch.ones(3, 4, 5))
        3
    """
    return channels_of(inpt)


def get_size(inpt: Any) -> list[int]:
    """Height and width, of boxes and key points those of their canvas.

    Args:
        inpt: a tensor, tv_tensor or PIL image.

    Returns:
        A list of the two.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.get_size(torch.ones(3, 4, 5))
        [4, 5]
    """
    return list(height_and_width(inpt))


def get_num_frames(inpt: Tensor) -> int:
    """The number of frames of a video (*, T, C, H, W).

    Args:
        inpt: a video.

    Returns:
        An int.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.get_num_frames(torch.ones(7, 3, 4, 5))
        7
    """
    return inpt.shape[-4]


def is_pure_tensor(inpt: Any) -> bool:
    """Whether an input is a tensor of none of torchvision's classes.

    Args:
        inpt: a tensor, tv_tensor or PIL image.

    Returns:
        A bool.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.is_pure_tensor(torch.ones(3, 4, 5))
        True
    """
    return kind_of(inpt) == "tensor"


def _of_torchvision(function: Function) -> Function:
    """torchvision's function of this name, of boxes or key points, whose classes are its own."""

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        from torchvision.transforms.v2 import functional as v2

        return getattr(v2, function.__name__)(*args, **kwargs)

    return call  # type: ignore[return-value]  # takes what torchvision's takes


@_of_torchvision
def clamp_bounding_boxes(inpt: Any, format: Any = None, canvas_size: Any = None, clamping_mode: Any = "auto") -> Any:
    """Cut boxes off at the borders of their canvas, by torchvision's function.

    Args:
        inpt: tv_tensors.BoundingBoxes, or a tensor with a format and a canvas.
        format: such as "XYXY", of tensors.
        canvas_size: height and width, of tensors.
        clamping_mode: "soft", "hard" or None for rotated boxes, "auto" for their own.

    Returns:
        What is given.

    Example:
        >>> import kvision.tv.functional as F
        >>> F.clamp_bounding_boxes.__name__
        'clamp_bounding_boxes'
    """


@_of_torchvision
def clamp_keypoints(inpt: Any, canvas_size: Any = None) -> Any:
    """Move key points to the nearest pixel of the canvas, by torchvision's function.

    Args:
        inpt: tv_tensors.KeyPoints, or a tensor with a canvas.
        canvas_size: height and width, of tensors.

    Returns:
        What is given.

    Example:
        >>> import kvision.tv.functional as F
        >>> F.clamp_keypoints.__name__
        'clamp_keypoints'
    """


@_of_torchvision
def convert_bounding_box_format(
    inpt: Any, old_format: Any = None, new_format: Any = None, inplace: bool = False
) -> Any:
    """Convert boxes to another format, by torchvision's function.

    Args:
        inpt: tv_tensors.BoundingBoxes, or a tensor with a format.
        old_format: such as "XYXY", of tensors.
        new_format: such as "CXCYWH".
        inplace: write into the boxes.

    Returns:
        What is given.

    Example:
        >>> import kvision.tv.functional as F
        >>> F.convert_bounding_box_format.__name__
        'convert_bounding_box_format'
    """


@_of_torchvision
def sanitize_bounding_boxes(  # type: ignore[empty-body]
    bounding_boxes: Any, format: Any = None, canvas_size: Any = None, min_size: float = 1.0, min_area: float = 1.0
) -> tuple[Any, Tensor]:
    """Remove boxes that are small or leave their canvas, by torchvision's function.

    Args:
        bounding_boxes: tv_tensors.BoundingBoxes, or a tensor with a format and a canvas.
        format: such as "XYXY", of tensors.
        canvas_size: height and width, of tensors.
        min_size: least width and height.
        min_area: least area.

    Returns:
        The boxes that are valid, and which they are.

    Example:
        >>> import kvision.tv.functional as F
        >>> F.sanitize_bounding_boxes.__name__
        'sanitize_bounding_boxes'
    """


@_of_torchvision
def sanitize_keypoints(key_points: Any, canvas_size: Any = None) -> tuple[Any, Tensor]:  # type: ignore[empty-body]
    """Remove key points, or groups of them, that leave their canvas, by torchvision's function.

    Args:
        key_points: tv_tensors.KeyPoints, or a tensor with a canvas.
        canvas_size: height and width, of tensors.

    Returns:
        The key points that are valid, and which they are.

    Example:
        >>> import kvision.tv.functional as F
        >>> F.sanitize_keypoints.__name__
        'sanitize_keypoints'
    """


get_image_num_channels = get_num_channels
