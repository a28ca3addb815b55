"""Images as colored text, to inspect a tensor over ssh."""

from __future__ import annotations

import os

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ImageError, TypeCheckError, ValueCheckError

__all__ = ["image_to_string", "print_image"]

# xterm's palette from 16 on: a cube of 6 x 6 x 6 colors with these levels, then 24 grays 8, 18, ... 238. The 16
# colors before them depend on the user's theme.
_CUBE = (0, 95, 135, 175, 215, 255)


def image_to_string(image: Tensor, max_width: int = 256) -> str:
    r"""Convert an image to text that shows it on a terminal of 256 colors: two spaces a pixel, a line a row.

    Args:
        image: (3, H, W), RGB, or (1, H, W); floating point in [0, 1] or integers in [0, 255].
        max_width: wider images are reduced to this many pixels, averaging, in their proportions.

    Returns:
        The lines, each ended by an escape sequence that resets the color and a newline.

    Raises:
        TypeCheckError: `image` is not a tensor or `max_width` not an int.
        ImageError: `image` is not (3, H, W) or (1, H, W), or has no pixel.
        ValueCheckError: a value of `image` is outside its range or NaN, or `max_width` is less than 1.

    Example:
        >>> import torch, kvision as K
        >>> K.image.image_to_string(torch.tensor([[[1.0]], [[0.0]], [[0.0]]]))
        '\x1b[48;5;196m  \x1b[0m\n'
    """
    op = "image_to_string"
    _check.is_tensor(op, "image", image)
    (max_width,) = _check.ints(op, "max_width", max_width, 1)
    if image.dim() != 3 or image.shape[0] not in (1, 3) or 0 in image.shape:
        raise ImageError(f"{op}: expected image of shape (3, H, W) or (1, H, W), got {tuple(image.shape)}")
    top = 1 if image.is_floating_point() else 255
    pixels = image.detach() if image.dtype == torch.float64 else image.detach().float()
    low, high = (v.item() for v in pixels.aminmax())
    if not (low >= 0 and high <= top):
        raise ValueCheckError(
            f"{op}: expected image in [0, {top}], got values from {low:g} to {high:g}",
            actual_value=(low, high),
            expected_range=(0, top),
        )
    height, width = image.shape[1:]
    if width > max_width:
        pixels = F.interpolate(pixels[None], (max(1, height * max_width // width), max_width), mode="area")[0]
    if image.is_floating_point():
        pixels = pixels * 255
    codes = _nearest_codes(pixels.cpu().expand(3, -1, -1).double().contiguous())
    return "".join("".join(f"\033[48;5;{code}m  " for code in row) + "\033[0m\n" for row in codes.tolist())


def print_image(image: Tensor | str | os.PathLike[str], max_width: int = 96) -> None:
    """Print an image, a tensor or a file, to a terminal of 256 colors; see `image_to_string`.

    Args:
        image: what `image_to_string` takes, or the path of a file `kvision.io.load_image` reads.
        max_width: wider images are reduced to this many pixels.

    Raises:
        TypeCheckError: `image` is neither a tensor nor a path.
        OSError, ImageError: the file cannot be read.

    Example:
        >>> import torch, kvision as K
        >>> K.image.print_image(torch.zeros(1, 1, 1))
        \x1b[48;5;16m  \x1b[0m
    """
    if isinstance(image, (str, os.PathLike)):
        from kvision.io import ImageLoadType, load_image

        image = load_image(image, ImageLoadType.RGB8)
    elif not isinstance(image, Tensor):
        raise TypeCheckError(
            f"print_image: expected image to be a Tensor or a path, got {type(image).__name__}",
            actual_type=type(image),
        )
    print(image_to_string(image, max_width), end="")


def _nearest_codes(rgb: Tensor) -> Tensor:
    """Palette indices (H, W) of the nearest colors to values (3, H, W) from 0 to 255. Ties take the lowest index."""
    levels = torch.tensor(_CUBE, dtype=rgb.dtype, device=rgb.device)
    cube = torch.bucketize(rgb, (levels[1:] + levels[:-1]) / 2)  # nearest for each channel is nearest in the cube
    gray = ((rgb.mean(0) - 8) / 10 - 0.5).ceil().clamp(0, 23)
    to_cube = (levels[cube] - rgb).square().sum(0)
    to_gray = (8 + 10 * gray - rgb).square().sum(0)
    r, g, b = cube
    return torch.where(to_cube <= to_gray, 16 + 36 * r + 6 * g + b, 232 + gray.long())
