"""Photographs to try things on, without a network: those inside the scikit-image package."""

from __future__ import annotations

import os
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import TypeCheckError
from kvision.image.convert import image_to_tensor
from kvision.io.load import ImageLoadType, convert, load_image

__all__ = ["get_sample_images"]

# The images of skimage.data that the package contains; the others it would download.
# fmt: off
_BUNDLED = (
    "astronaut", "brick", "camera", "cat", "cell", "checkerboard", "chelsea", "clock", "coffee", "coins",
    "colorwheel", "grass", "gravel", "horse", "hubble_deep_field", "immunohistochemistry", "logo", "microaneurysms",
    "moon", "page", "retina", "rocket", "text",
)
# fmt: on


def get_sample_images(
    resize: tuple[int, int] | None = None,
    paths: Sequence[str | os.PathLike[str]] = ("astronaut", "chelsea", "coffee", "rocket"),
    *,
    as_list: bool = False,
) -> Tensor | list[Tensor]:
    """Photographs as RGB in [0, 1], from scikit-image (`skimage.data`) or from files. Nothing is downloaded.

    Args:
        resize: height and width to bring all of them to (bilinear, antialiased).
        paths: names of images that scikit-image's package contains, or paths of files.
        as_list: a list even where `resize` is given.

    Returns:
        (B, 3, resize), float32, where `resize` is given and `as_list` is not; otherwise a list of (3, H, W).

    Raises:
        TypeCheckError: `paths` is a single name or path, or `resize` no pair of ints.
        ImportError: a name is asked for, and scikit-image is not installed.
        FileNotFoundError, OSError, ImageError: an entry is no such name, and no file that can be read.

    Example:
        >>> import kvision as K
        >>> K.io.get_sample_images(resize=(128, 192)).shape
        torch.Size([4, 3, 128, 192])
    """
    if isinstance(paths, (str, os.PathLike)):
        raise TypeCheckError(f"get_sample_images: expected paths to be a sequence of names or paths, got {paths!r}")
    photos = [_bundled(path) if path in _BUNDLED else load_image(path) for path in paths]
    if resize is not None:
        size = _check.pair("get_sample_images", "resize", resize, maximum=_check.LARGEST_INT)
        photos = [F.interpolate(photo[None], size, mode="bilinear", antialias=True)[0] for photo in photos]
    return photos if as_list or resize is None else torch.stack(photos)


def _bundled(name: str) -> Tensor:
    try:
        import skimage.data
    except ImportError as error:
        raise ImportError(
            f"get_sample_images: '{name}' comes with scikit-image, which is not installed: pip install scikit-image"
        ) from error
    return convert(image_to_tensor(getattr(skimage.data, name)()), ImageLoadType.RGB32)
