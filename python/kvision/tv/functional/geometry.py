"""Functions that move pixels, by the arguments of torchvision.transforms.v2.functional.

Values are those of v2's path of tensors. Its matrices and displacements map pixels of the result to those of the image.
"""

from __future__ import annotations

import inspect
import math
import operator
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype, floats
from kvision._modes import INTERPOLATION, PADDING
from kvision.geometry import transform
from kvision.geometry.transform import nearest, sampling
from kvision.geometry.transform.resize_windows import resized_windows
from kvision.tv.functional.dispatch import functional, on_device
from kvision.tv.inputs import one_or_two

Fill = float | Sequence[float] | None
Size = int | Sequence[int] | None


class InterpolationMode(Enum):
    """The interpolations of torchvision, whose own enumeration is taken as well.

    Example:
        >>> from kvision import tv
        >>> tv.InterpolationMode.BILINEAR.value
        'bilinear'
    """

    NEAREST = "nearest"
    NEAREST_EXACT = "nearest-exact"
    BILINEAR = "bilinear"
    BICUBIC = "bicubic"
    BOX = "box"
    HAMMING = "hamming"
    LANCZOS = "lanczos"


Mode = InterpolationMode | str | int
_OF_PIL = ("nearest", "lanczos", "bilinear", "bicubic", "box", "hamming")  # by the integers of PIL.Image.Resampling
_NAMES = tuple(mode.value for mode in InterpolationMode)


def interpolation_name(op: str, interpolation: Any) -> str:
    if isinstance(interpolation, Enum):
        interpolation = interpolation.value
    if _check.is_int(interpolation) and 0 <= interpolation < len(_OF_PIL):
        interpolation = _OF_PIL[interpolation]
    _check.choice(op, "interpolation", interpolation, _NAMES)
    return str(interpolation)


# --- flips and crops ------------------------------------------------------------------------------------------------


@functional(moves=True, pil=lambda image: image.transpose(0))  # PIL.Image.Transpose.FLIP_LEFT_RIGHT
def horizontal_flip(inpt: Tensor) -> Tensor:
    """Mirror the columns.

    Args:
        inpt: a tensor, tv_tensor or PIL image.

    Returns:
        What is given, of the same type and size.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.horizontal_flip(torch.tensor([[[1.0, 2.0]]]))
        tensor([[[2., 1.]]])
    """
    return inpt.flip(-1)


@functional(moves=True, pil=lambda image: image.transpose(1))  # PIL.Image.Transpose.FLIP_TOP_BOTTOM
def vertical_flip(inpt: Tensor) -> Tensor:
    """Mirror the rows.

    Args:
        inpt: a tensor, tv_tensor or PIL image.

    Returns:
        What is given, of the same type and size.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.vertical_flip(torch.tensor([[[1.0], [2.0]]])).flatten()
        tensor([2., 1.])
    """
    return inpt.flip(-2)


def windows_of(x: Tensor, corners: np.ndarray[Any, Any], height: int, width: int) -> Tensor:
    """The window of each of (B, *, H, W) with a corner (top, left) of its own, all of them inside."""
    if x.device.type == "cpu":  # 40 times as fast as indexing
        return torch.stack([_crop(image, *corner, height, width) for image, corner in zip(x, corners.tolist())])
    batch, corner = x.reshape(len(x), -1, *x.shape[-2:]), on_device(corners, x.device)[..., None, None, None]
    i = [torch.arange(n, device=x.device) for n in (*batch.shape[:2], height, width)]
    rows, columns = corner[:, 0] + i[2][:, None], corner[:, 1] + i[3]
    return batch[i[0][:, None, None, None], i[1][:, None, None], rows, columns].reshape(*x.shape[:-2], height, width)


def _crop_pil(image: Any, top: int, left: int, height: int, width: int) -> Any:
    return image.crop((left, top, left + width, top + height))


@functional(moves=True, pil=_crop_pil)
def crop(inpt: Tensor, top: int, left: int, height: int, width: int) -> Tensor:
    """Cut a window out of an image, a view of a tensor where the window is inside; what is outside is 0.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        top: first row.
        left: first column.
        height: of the window.
        width: of the window.

    Returns:
        The window, of the type of `inpt`.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.crop(torch.arange(6.0).reshape(1, 2, 3), 0, 1, 2, 2)
        tensor([[[1., 2.],
                 [4., 5.]]])
    """
    h, w = inpt.shape[-2:]
    bottom, right = top + height, left + width
    if top >= 0 and left >= 0 and bottom <= h and right <= w:
        return inpt[..., top:bottom, left:right]
    inside = inpt[..., max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)]
    before = [min(max(-left, 0), width), min(max(-top, 0), height)]
    after = [width - inside.shape[-1] - before[0], height - inside.shape[-2] - before[1]]
    return F.pad(inside, [before[0], after[0], before[1], after[1]])


_crop = inspect.unwrap(crop)  # of tensors


def _center(height: int, width: int, size: tuple[int, int]) -> tuple[int, int]:
    """The corner of a crop in the center; an odd number of pixels too many or too few is split as in v2."""
    return _before(height, size[0]), _before(width, size[1])


def _before(image: int, crop: int) -> int:
    return -((crop - image) // 2) if crop > image else round((image - crop) / 2.0)


@functional(moves=True)
def center_crop(inpt: Tensor, output_size: int | Sequence[int]) -> Tensor:
    """Cut the center out of an image, with 0 around smaller ones.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        output_size: height and width, an int for both.

    Returns:
        The window, of the type of `inpt`.

    Raises:
        ValueError: the size has not the form in Args.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.center_crop(torch.arange(9.0).reshape(1, 3, 3), 1)
        tensor([[[4.]]])
    """
    size = one_or_two("center_crop", "output_size", output_size)
    return _crop(inpt, *_center(inpt.shape[-2], inpt.shape[-1], size), *size)


@functional()
def five_crop(inpt: Tensor, size: int | Sequence[int]) -> tuple[Tensor, ...]:
    """Cut out the corners and the center: upper left, upper right, lower left, lower right, center.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        size: height and width, an int for both.

    Returns:
        A tuple of five windows, of the type of `inpt`.

    Raises:
        ValueError: the size has not the form in Args, or is larger than the image.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> [x.item() for x in F.five_crop(torch.arange(9).reshape(1, 3, 3), 1)]
        [0, 2, 6, 8, 4]
    """
    (h, w), (height, width) = one_or_two("five_crop", "size", size), inpt.shape[-2:]
    if h > height or w > width:
        raise ValueError(f"five_crop: expected a size of at most {height} x {width}, got {h} x {w}")
    corners = [(0, 0), (0, width - w), (height - h, 0), (height - h, width - w), _center(height, width, (h, w))]
    return tuple(_crop(inpt, *corner, h, w) for corner in corners)


@functional()
def ten_crop(inpt: Tensor, size: int | Sequence[int], vertical_flip: bool = False) -> tuple[Tensor, ...]:
    """Cut out the corners and the center of an image and of its mirror image.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        size: height and width, an int for both.
        vertical_flip: mirror the rows, not the columns.

    Returns:
        A tuple of ten windows, of the type of `inpt`.

    Raises:
        ValueError: the size has not the form in Args, or is larger than the image.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> [x.item() for x in F.ten_crop(torch.arange(9).reshape(1, 3, 3), 1)]
        [0, 2, 6, 8, 4, 2, 0, 8, 6, 4]
    """
    return five_crop(inpt, size) + five_crop(inpt.flip(-2 if vertical_flip else -1), size)


# --- sizes ----------------------------------------------------------------------------------------------------------


def resized_size(height: int, width: int, size: Any, max_size: int | None) -> tuple[int, int]:
    """The height and width of `resize`: both, the shorter one with a limit of the longer one, or that limit alone."""
    if isinstance(size, int):
        size = [size]
    if size is not None and len(size) == 2:
        if max_size is not None:
            raise ValueError(f"resize: expected no max_size where size has height and width, got {max_size}")
        return int(size[0]), int(size[1])
    short, long = min(height, width), max(height, width)
    if size is None:
        if not isinstance(max_size, int):
            raise ValueError(f"resize: expected max_size to be an int where size is None, got {max_size!r}")
        new_short, new_long = int(max_size * short / long), max_size
    else:
        new_short, new_long = size[0], int(size[0] * long / short)
        if max_size is not None:
            if max_size <= new_short:
                raise ValueError(
                    f"resize: expected max_size above the size {new_short} of the shorter side, got {max_size}"
                )
            if new_long > max_size:
                new_short, new_long = int(max_size * new_short / new_long), max_size
    return (new_long, new_short) if width <= height else (new_short, new_long)


def _resize_pil(
    image: Any, size: Any, interpolation: Any = "bilinear", max_size: int | None = None, antialias: bool | None = True
) -> Any:
    """PIL's antialiased resizing, which torch's of bytes follows, and of bits and palettes, whose nearest pixels it takes.

    NotImplemented for what PIL does otherwise.
    """
    mode = interpolation_name("resize", interpolation)
    if image.mode not in ("1", "P") and ("nearest" in mode or image.mode not in ("L", "RGB", "I;16")):
        return NotImplemented
    new = resized_size(image.height, image.width, size, max_size)
    return image if new == (image.height, image.width) else image.resize(new[::-1], _OF_PIL.index(mode))


def _resize_mask(mask: Tensor, size: Any, interpolation: Any = "nearest", **options: Any) -> Tensor:
    exact = interpolation_name("resize", interpolation) == "nearest-exact"
    return resize(mask, size, "nearest-exact" if exact else "nearest", options.get("max_size"))


@functional(moves=True, pil=_resize_pil, mask=_resize_mask)
def resize(
    inpt: Tensor,
    size: Size,
    interpolation: Mode = "bilinear",
    max_size: int | None = None,
    antialias: bool | None = True,
) -> Tensor:
    """Resize to a height and width, or by the shorter or the longer side; masks by the nearest pixel.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        size: height and width; an int, or one in a sequence, for the shorter side; None where max_size has the longer one.
        interpolation: 'nearest', 'nearest-exact', 'bilinear', 'bicubic' or 'lanczos', also as InterpolationMode or PIL's integer.
        max_size: the longest that the longer side may become where size is of the shorter one.
        antialias: where the image becomes smaller, average the pixels that a pixel of the result covers.

    Returns:
        What is given in the new size, of the same type.

    Raises:
        ValueError: the sizes or the interpolation are not as in Args.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.resize(torch.ones(3, 8, 6), 3).shape
        torch.Size([3, 4, 3])
    """
    mode: Any = interpolation_name("resize", interpolation)
    *leading, height, width = inpt.shape
    new = resized_size(height, width, size, max_size)
    if mode in ("box", "hamming") or (mode == "lanczos" and not antialias):
        raise ValueError(f"resize: {mode!r} needs {'antialias=True' if mode == 'lanczos' else 'a PIL image'}")
    if new == (height, width):
        return inpt
    if inpt.numel() == 0:
        return inpt.new_empty(*leading, *new)
    batch = inpt.reshape(-1, *inpt.shape[-3:])
    if "nearest" in mode:  # by torch, whose rounded scale decides between two pixels that are equally near
        output = nearest.of_values(F.interpolate(nearest.as_values(batch, mode), new, mode=mode), batch, mode)
    else:
        output = transform.resize(batch, new, mode, antialias=bool(antialias))
    if output.dtype != inpt.dtype:
        output = output.round_().to(inpt.dtype)
    return output.reshape(*leading, *new)


def _resized_crop_mask(mask: Tensor, top: int, left: int, height: int, width: int, size: Any, **_: Any) -> Tensor:
    return _resize_mask(_crop(mask, top, left, height, width), size)


def _resized_crop_pil(image: Any, top: int, left: int, height: int, width: int, *args: Any, **options: Any) -> Any:
    return resize(_crop_pil(image, top, left, height, width), *args, **options)


_WINDOW = operator.itemgetter("top", "left", "height", "width")


def _resized_crop_each(x: Tensor, rows: list[dict[str, Any]]) -> Any:
    mode = interpolation_name("resized_crop", rows[0]["interpolation"])
    computes = x.is_floating_point() or x.dtype == torch.uint8
    if "nearest" in mode or not (rows[0]["antialias"] and computes):
        return NotImplemented
    corners, sizes = np.array([*map(_WINDOW, rows)]).reshape(-1, 2, 2).swapaxes(0, 1)
    if (corners < 0).any() or (corners + sizes > x.shape[-2:]).any():
        return NotImplemented
    size = one_or_two("resized_crop", "size", rows[0]["size"])
    scale = size / sizes
    shift = (0.5 - corners) * scale - 0.5
    matrix = np.tile(np.eye(3), (len(rows), 1, 1))
    matrix[:, [1, 0], [1, 0]], matrix[:, 1::-1, 2] = scale, shift  # x before y
    to_result = on_device(torch.from_numpy(matrix).to(compute_dtype(x)), x.device)
    return resized_windows(x, to_result, [*size], INTERPOLATION[mode], False)


@functional(moves=True, pil=_resized_crop_pil, mask=_resized_crop_mask, each=_resized_crop_each)
def resized_crop(
    inpt: Tensor,
    top: int,
    left: int,
    height: int,
    width: int,
    size: int | Sequence[int],
    interpolation: Mode = "bilinear",
    antialias: bool | None = True,
) -> Tensor:
    """Cut a window out of an image and resize it.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        top: first row.
        left: first column.
        height: of the window.
        width: of the window.
        size: as in :func:`resize`.
        interpolation: as in :func:`resize`.
        antialias: as in :func:`resize`.

    Returns:
        The window in the new size, of the type of `inpt`.

    Raises:
        ValueError: the sizes or the interpolation are not as in Args.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.resized_crop(torch.ones(3, 8, 6), 1, 2, 4, 3, [2, 5]).shape
        torch.Size([3, 2, 5])
    """
    return resize(_crop(inpt, top, left, height, width), size, interpolation, antialias=antialias)


def four_paddings(padding: int | Sequence[int]) -> list[int]:
    """Left, right, top and bottom of a padding of one, two (x and y) or four (left, top, right, bottom) numbers."""
    if isinstance(padding, int):
        return [padding] * 4
    p = list(padding)
    if len(p) not in (1, 2, 4) or not all(isinstance(n, int) for n in p):
        raise ValueError(f"pad: expected padding to be an int or 1, 2 or 4 of them, got {padding!r}")
    left, top, right, bottom = p * (4 // len(p))
    return [left, right, top, bottom]


PADDING_MODES = ("constant", "edge", "reflect", "symmetric")


def _source_indices(size: int, before: int, after: int, mode: str, device: torch.device) -> Tensor:
    i = torch.arange(-before, size + after, device=device)
    if mode == "edge":
        return i.clamp(0, size - 1)
    period = 2 * size if mode == "symmetric" else max(2 * size - 2, 1)
    i = i.remainder(period)
    return torch.minimum(i, period - (mode == "symmetric") - i)


def _pad_mask(mask: Tensor, padding: Any, fill: Any = None, padding_mode: str = "constant") -> Tensor:
    if isinstance(fill, (tuple, list)):
        raise ValueError(f"pad: expected a number as the fill of masks, got {fill!r}")
    return pad(mask, padding, fill, padding_mode)


@functional(moves=True, mask=_pad_mask)
def pad(inpt: Tensor, padding: int | Sequence[int], fill: Fill = None, padding_mode: str = "constant") -> Tensor:
    """Add pixels at the borders.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        padding: how many: an int; x and y; or left, top, right and bottom.
        fill: a number, or one of each channel; None for 0.
        padding_mode: 'constant', 'edge', 'reflect' or 'symmetric'.

    Returns:
        What is given with the border, of the same type.

    Raises:
        ValueError: the padding, the fill or the mode is not as in Args.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.pad(torch.ones(1, 1, 2), [1, 0], fill=3)
        tensor([[[3., 1., 1., 3.]]])
    """
    left, right, top, bottom = four_paddings(padding)
    _check.choice("pad", "padding_mode", padding_mode, PADDING_MODES)
    if isinstance(fill, (tuple, list)) and len(fill) == 1:
        fill = fill[0]
    if padding_mode != "constant":
        if isinstance(fill, (tuple, list)):
            raise ValueError(f"pad: expected a fill of several channels only with 'constant', got {padding_mode!r}")
        rows = _source_indices(inpt.shape[-2], top, bottom, padding_mode, inpt.device)
        columns = _source_indices(inpt.shape[-1], left, right, padding_mode, inpt.device)
        return inpt[..., rows[:, None], columns]
    if not isinstance(fill, (tuple, list)):
        return F.pad(inpt, [left, right, top, bottom], value=float(fill or 0))  # type: ignore[arg-type]
    height, width = inpt.shape[-2:]
    colors = torch.tensor(fill, device=inpt.device).to(inpt.dtype).reshape(-1, 1, 1)
    output = colors.expand(*inpt.shape[:-2], height + top + bottom, width + left + right).contiguous()
    _crop(output, top, left, height, width).copy_(inpt)
    return output


# --- warps ----------------------------------------------------------------------------------------------------------


def _filled(op: str, sample: Any, inpt: Tensor, size: tuple[int, int], interpolation: Any, fill: Fill) -> Tensor:
    """`sample(images, fill, mode)` of images (B, C, H, W), with v2's rule of colors at the border.

    Where m of a pixel's weight is inside, bilinear values s (zeros outside) become (s - fill) m + fill.
    """
    *leading, height, width = inpt.shape
    mode = interpolation_name(op, interpolation)
    if mode not in ("nearest", "bilinear"):
        raise ValueError(f"{op}: expected an interpolation of 'nearest' or 'bilinear', got {mode!r}")
    if fill is not None:
        fill = [float(f) for f in fill] if isinstance(fill, (tuple, list)) else [float(fill)]  # type: ignore[arg-type]
        if len(fill) not in (1, inpt.shape[-3]):
            raise ValueError(f"{op}: expected a fill of {inpt.shape[-3]} channels, got {fill}")
    if 0 in inpt.shape:
        return inpt.new_empty(*leading, *size)
    batch = inpt.reshape(-1, *inpt.shape[-3:])
    if mode == "nearest":
        _, color = sampling.padding_and_fill(op, batch, "zeros" if fill is None else "fill", fill, None, mode)
        output = nearest.of_values(sample(nearest.as_values(batch, mode), color, mode), batch, mode)
    elif fill is None:
        output = sample(batch if batch.dtype == torch.uint8 else floats(batch), None, mode)
    else:
        values = floats(batch)
        inside = sample(values.new_ones(1, 1, height, width), None, mode)
        output = sample(values, None, mode)
        colors = torch.tensor(fill, device=batch.device).to(values.dtype)[:, None, None]
        output = output.sub_(colors).mul_(inside).add_(colors) if any(fill) else output.mul_(inside)
    if output.dtype != inpt.dtype:
        output = output.round_().to(inpt.dtype)
    return output.reshape(*leading, *size)


Matrix = list[list[Any]]  # of numbers, or of arrays (B,) with those of each image


def _warp(op: str, inpt: Tensor, matrix: Matrix, size: tuple[int, int], interpolation: Any, fill: Fill) -> Tensor:
    """Sample at a matrix, of all or of each, times the pixels (x, y, 1) of the result; the center of the first is (0, 0)."""
    dtype = torch.float64 if inpt.dtype == torch.float64 else torch.float32
    entries = [v for row in matrix for v in row]
    if any(isinstance(v, np.ndarray) for v in entries):
        each = np.stack([np.broadcast_to(v, len(inpt)) for v in entries], 1).reshape(len(inpt), -1, 3)
        to_source = on_device(torch.from_numpy(each).to(dtype), inpt.device)
    else:
        to_source = torch.tensor([matrix], dtype=dtype, device=inpt.device)

    def sample(images: Tensor, color: Tensor | None, mode: str) -> Tensor:
        options = (INTERPOLATION[mode], PADDING["fill"], False, False, False)
        return sampling.warp(images, to_source, color, None, list(size), *options)

    return _filled(op, sample, inpt, size, interpolation, fill)


def _affine_matrix(center: Sequence[float], angle: Any, translate: Any, scale: Any, shear: Any) -> Matrix:
    """From pixels of the result to those of the image: rotation R, shears and scale around a center, then a translation.

    T(center) (scale R(angle) Sy Sx)^-1 T(-center - translate), angles in degrees, clockwise in the image.
    """
    rotation, x, y = (a * (math.pi / 180) for a in (angle, *shear))
    a, c = np.cos(rotation - y) / np.cos(y), np.sin(rotation - y) / np.cos(y)
    b, d = -(a * np.tan(x) + np.sin(rotation)), np.cos(rotation) - c * np.tan(x)
    rows = [[d / scale, -b / scale], [-c / scale, a / scale]]  # the determinant of [a b; c d] is 1
    shifted = [center[0] + translate[0], center[1] + translate[1]]
    return [[*row, center[i] - row[0] * shifted[0] - row[1] * shifted[1]] for i, row in enumerate(rows)]


def _of_pixels(matrix: Matrix, image: Sequence[int], result: Sequence[int]) -> Matrix:
    """A matrix of coordinates from the image's center as one of pixels; sizes are (height, width)."""
    rows = []
    for row, size in zip(matrix, image[::-1]):
        shift = row[2] - row[0] * (result[1] - 1) / 2 - row[1] * (result[0] - 1) / 2 + (size - 1) / 2
        rows.append([row[0], row[1], shift])
    return rows


def _warp_each(op: str, matrix_of: Callable[..., Matrix], *names: str) -> Callable[..., Any]:
    """The kernel of warps by a matrix of each image, which `matrix_of` the size and arguments gives; `names` and centers differ."""

    def each(x: Tensor, rows: list[dict[str, Any]]) -> Any:
        if any(row[name] is None for row in rows for name in names):
            return NotImplemented
        columns: dict[str, Any] = {}
        for name in names:
            column = np.array([row[name] for row in rows], dtype=np.float64)
            columns[name] = tuple(column.T) if column.ndim == 2 else column
        height, width = size = x.shape[-2], x.shape[-1]
        if any(row.get("center") is not None for row in rows):
            centers = [row.get("center") or (width * 0.5, height * 0.5) for row in rows]
            columns["center"] = tuple(np.array(centers, dtype=np.float64).T)
        return _warp(op, x, matrix_of(size, **{**rows[0], **columns}), size, rows[0]["interpolation"], rows[0]["fill"])

    return each


def _from_center(center: Any, height: int, width: int) -> list[float]:
    return [0.0, 0.0] if center is None else [center[0] - width * 0.5, center[1] - height * 0.5]


def _matrix_of_affine(size: Any, angle: Any, translate: Any, scale: Any, shear: Any, center: Any, **_: Any) -> Matrix:
    if np.min(scale) <= 0:
        raise ValueError(f"affine: expected a scale above 0, got {scale}")
    shear = [shear, 0.0] if isinstance(shear, (int, float)) else list(shear) * (2 // len(shear))
    return _of_pixels(_affine_matrix(_from_center(center, *size), angle, translate, scale, shear), size, size)


@functional(
    moves=True, mask="nearest", each=_warp_each("affine", _matrix_of_affine, "angle", "translate", "scale", "shear")
)
def affine(
    inpt: Tensor,
    angle: float,
    translate: Sequence[float],
    scale: float,
    shear: float | Sequence[float],
    interpolation: Mode = "nearest",
    fill: Fill = None,
    center: Sequence[float] | None = None,
) -> Tensor:
    """Warp by a rotation, translation, scale and shear around a center.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        angle: in degrees, clockwise.
        translate: x and y in pixels.
        scale: above 0.
        shear: along x, or along x and y, in degrees.
        interpolation: 'nearest' or 'bilinear', also as InterpolationMode or PIL's integer.
        fill: color of pixels from outside: a number, or one of each channel; None for 0.
        center: x and y of what stays, from the upper left corner; None for the center.

    Returns:
        What is given, of the same type and size.

    Raises:
        ValueError: a scale that is not above 0; an interpolation or a fill that is not as in Args.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.affine(torch.tensor([[[1.0, 2.0, 3.0]]]), 0.0, [1, 0], 1.0, [0.0])
        tensor([[[0., 1., 2.]]])
    """
    size = inpt.shape[-2], inpt.shape[-1]
    matrix = _matrix_of_affine(size, angle, translate, scale, shear, center)
    return _warp("affine", inpt, matrix, size, interpolation, fill)


def _expanded_size(matrix: Matrix, height: int, width: int) -> tuple[int, int]:
    """The size that holds an image after a rotation, by its corners in float32 as v2 rounds them."""
    corners = torch.tensor(
        [[x * width / 2, y * height / 2, 1.0] for x, y in ((-1, -1), (-1, 1), (1, 1), (1, -1))], device="cpu"
    )
    low, high = (corners @ torch.tensor(matrix, dtype=corners.dtype, device="cpu").T).aminmax(dim=0)
    half, tolerance = torch.tensor([width / 2, height / 2], device="cpu"), 1e-4
    low, high = ((x + half).mul_(1 / tolerance).trunc_().mul_(tolerance) for x in (low, high))
    w, h = high.ceil_().sub_(low.floor_()).tolist()
    return int(h), int(w)


def _rotation(size: tuple[int, int], angle: Any, center: Any) -> Matrix:
    return _affine_matrix(_from_center(center, *size), -angle, (0.0, 0.0), 1.0, (0.0, 0.0))


def _matrix_of_rotation(size: tuple[int, int], angle: Any, center: Any, **_: Any) -> Matrix:
    return _of_pixels(_rotation(size, angle, center), size, size)


@functional(moves=True, mask="nearest", each=_warp_each("rotate", _matrix_of_rotation, "angle"))
def rotate(
    inpt: Tensor,
    angle: float,
    interpolation: Mode = "nearest",
    expand: bool = False,
    center: Any = None,
    fill: Fill = None,
) -> Tensor:
    """Rotate counterclockwise.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        angle: in degrees.
        interpolation: 'nearest' or 'bilinear', also as InterpolationMode or PIL's integer.
        expand: enlarge the result to hold the rotated image.
        center: x and y of what stays, from the upper left corner; None for the center.
        fill: color of pixels from outside: a number, or one of each channel; None for 0.

    Returns:
        What is given, rotated, of the same type.

    Raises:
        ValueError: an interpolation or a fill that is not as in Args.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.rotate(torch.tensor([[[1.0, 2.0], [3.0, 4.0]]]), 90)
        tensor([[[2., 4.],
                 [1., 3.]]])
    """
    height, width = inpt.shape[-2:]
    angle = angle % 360
    if center is None:
        if angle == 0:
            return inpt.clone()
        if angle == 180 or (angle in (90, 270) and (expand or height == width)):
            return inpt.rot90(int(angle) // 90, (-2, -1))
    matrix = _rotation((height, width), angle, center)
    size = _expanded_size(matrix, height, width) if expand else (height, width)
    return _warp("rotate", inpt, _of_pixels(matrix, (height, width), size), size, interpolation, fill)


def _coefficients(startpoints: Any, endpoints: Any, coefficients: Any) -> Sequence[Any]:
    """The numbers a to h of x = (a u + b v + c) / (g u + h v + 1), y = (d u + e v + f) / (...) from end to start points."""
    if (coefficients is None) == (startpoints is None or endpoints is None):
        raise ValueError("perspective: expected either startpoints and endpoints or coefficients")
    if coefficients is not None:
        if len(coefficients) != 8:
            raise ValueError(f"perspective: expected 8 coefficients, got {len(coefficients)}")
        return list(coefficients)
    starts, ends = (torch.as_tensor(p, dtype=torch.float64, device="cpu") for p in (startpoints, endpoints))
    if starts.shape[-2] != 4 or ends.shape[-2] != 4:
        raise ValueError(f"perspective: expected four points each, got {starts.shape[-2]} and {ends.shape[-2]}")
    matrices = transform.get_perspective_transform(ends.reshape(-1, 4, 2), starts.reshape(-1, 4, 2))
    entries = matrices.flatten(1)[:, :8].float().double().numpy()  # rounded as v2's
    return entries[0].tolist() if starts.dim() == 2 else [*entries.T]


def _matrix_of_perspective(size: Any, startpoints: Any, endpoints: Any, coefficients: Any, **_: Any) -> Matrix:
    a, b, c, d, e, f, g, h = _coefficients(startpoints, endpoints, coefficients)
    # The coefficients are of coordinates from the corner of the first pixel, half a pixel before its center.
    k = g / 2 + h / 2 + 1
    rows = [[a, b, a / 2 + b / 2 + c], [d, e, d / 2 + e / 2 + f]]
    return [*[[r - 0.5 * s for r, s in zip(row, (g, h, k))] for row in rows], [g, h, k]]


@functional(
    moves=True, mask="nearest", each=_warp_each("perspective", _matrix_of_perspective, "startpoints", "endpoints")
)
def perspective(
    inpt: Tensor,
    startpoints: Sequence[Sequence[int]] | None,
    endpoints: Sequence[Sequence[int]] | None,
    interpolation: Mode = "bilinear",
    fill: Fill = None,
    coefficients: Sequence[float] | None = None,
) -> Tensor:
    """Warp by the perspective that takes four points to four others.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        startpoints: four points (x, y) of the image.
        endpoints: where they go.
        interpolation: 'nearest' or 'bilinear', also as InterpolationMode or PIL's integer.
        fill: color of pixels from outside: a number, or one of each channel; None for 0.
        coefficients: a to h of x = (a u + b v + c) / (g u + h v + 1), y = (d u + e v + f) / (g u + h v + 1), in place of points.

    Returns:
        What is given, of the same type and size.

    Raises:
        ValueError: not four points each, or eight coefficients; an interpolation or a fill that is not as in Args.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> corners = [[0, 0], [5, 0], [5, 7], [0, 7]]
        >>> F.perspective(torch.ones(3, 8, 6), corners, corners).shape
        torch.Size([3, 8, 6])
    """
    size = inpt.shape[-2], inpt.shape[-1]
    matrix = _matrix_of_perspective(size, startpoints, endpoints, coefficients)
    return _warp("perspective", inpt, matrix, size, interpolation, fill)


def _elastic_each(x: Tensor, rows: list[dict[str, Any]]) -> Tensor:
    displacements = torch.cat([row["displacement"] for row in rows])
    return _elastic(x, displacements, rows[0]["interpolation"], rows[0]["fill"])


@functional(moves=True, mask="nearest", each=_elastic_each)
def elastic(inpt: Tensor, displacement: Tensor, interpolation: Mode = "bilinear", fill: Fill = None) -> Tensor:
    """Sample at displaced pixels.

    Args:
        inpt: a tensor, tv_tensor or PIL image.
        displacement: x and y of each pixel, (1, H, W, 2), as fractions of half the width and height.
        interpolation: 'nearest' or 'bilinear', also as InterpolationMode or PIL's integer.
        fill: color of pixels from outside: a number, or one of each channel; None for 0.

    Returns:
        What is given, of the same type and size.

    Raises:
        TypeCheckError, ValueError: the displacement, an interpolation or a fill is not as in Args.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> F.elastic(torch.ones(3, 8, 6), torch.zeros(1, 8, 6, 2)).shape
        torch.Size([3, 8, 6])
    """
    _check.shape("elastic", "displacement", displacement, 1, *inpt.shape[-2:], 2)
    return _elastic(inpt, displacement, interpolation, fill)


def _elastic(inpt: Tensor, displacement: Tensor, interpolation: Any, fill: Fill) -> Tensor:
    """By a displacement (B or 1, H, W, 2) of each image or of all."""
    height, width = inpt.shape[-2:]
    dtype = torch.float64 if inpt.dtype == torch.float64 else torch.float32
    moved = displacement.to(inpt.device, dtype)
    x = moved[..., 0] * (width / 2) + torch.arange(width, device=inpt.device)
    y = moved[..., 1] * (height / 2) + torch.arange(height, device=inpt.device)[:, None]

    def sample(images: Tensor, color: Tensor | None, mode: str) -> Tensor:
        return sampling.remap(images, x, y, color, None, INTERPOLATION[mode], PADDING["fill"], False, False, False)

    return _filled("elastic", sample, inpt, (height, width), interpolation, fill)


hflip, vflip, elastic_transform = horizontal_flip, vertical_flip, elastic
