"""Local affine frames in pixels and in fractions of an image."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import floats
from kvision.geometry._formula import of_rows, register_formula


def check_lafs(op: str, laf: Tensor, name: str = "laf") -> Tensor:
    """`laf` as floating-point numbers; raise unless it is a tensor (B, N, 2, 3)."""
    _check.shape(op, name, laf, "B", "N", 2, 3)
    return floats(laf)


def _scale_parts_reference(laf: Tensor, shape: float, x: float, y: float) -> Tensor:
    center = torch.stack([laf[..., 0, 2] * x, laf[..., 1, 2] * y], -1)
    return torch.cat([laf[..., :2] * shape, center[..., None]], -1)


_scale_parts = register_formula("scale_laf_parts", _scale_parts_reference, lambda *args: (2, 3))


def scale_laf_parts(laf: Tensor, shape: float, x: float, y: float) -> Tensor:
    """[k A | (sx, sy) c], from one image's pixels to those of a resized one."""
    if laf.is_cpu and laf.dtype in (torch.float32, torch.float64) and not is_compiling():
        return laf * torch.tensor([[shape, shape, x], [shape, shape, y]], dtype=laf.dtype, device=laf.device)
    return of_rows(_scale_parts, laf, 2, shape, x, y)


def _extent(op: str, images: Tensor) -> tuple[float, float]:
    """The distance between the outermost pixel centers, along x and y; 1 for a single pixel."""
    _check.images(op, "images", images)
    height, width = images.shape[-2:]
    return float(max(width - 1, 1)), float(max(height - 1, 1))


def normalize_laf(LAF: Tensor, images: Tensor) -> Tensor:
    """Convert frames in pixels to frames in fractions of the image.

    Args:
        LAF: (B, N, 2, 3). Integers give float32.
        images: (B, C, H, W), for its size.

    Returns:
        (B, N, 2, 3): centers (x / (W - 1), y / (H - 1)), the rest divided by min(H, W) - 1.

    Raises:
        TypeCheckError: an argument is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.normalize_laf(torch.tensor([[[[2.0, 0, 5], [0, 2, 7]]]]), torch.zeros(1, 1, 11, 21))
        tensor([[[[0.2000, 0.0000, 0.2500],
                  [0.0000, 0.2000, 0.7000]]]])
    """
    laf = check_lafs("normalize_laf", LAF, "LAF")
    width, height = _extent("normalize_laf", images)
    return scale_laf_parts(laf, 1 / min(width, height), 1 / width, 1 / height)


def denormalize_laf(LAF: Tensor, images: Tensor) -> Tensor:
    """Convert frames in fractions of the image to frames in pixels, the inverse of `normalize_laf`.

    Args:
        LAF: (B, N, 2, 3). Integers give float32.
        images: (B, C, H, W), for its size.

    Returns:
        (B, N, 2, 3).

    Raises:
        TypeCheckError: an argument is not a tensor of real numbers.
        ShapeError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.denormalize_laf(torch.tensor([[[[0.25, 0, 0.5], [0, 0.25, 0.75]]]]), torch.zeros(1, 1, 9, 17))
        tensor([[[[2., 0., 8.],
                  [0., 2., 6.]]]])
    """
    laf = check_lafs("denormalize_laf", LAF, "LAF")
    width, height = _extent("denormalize_laf", images)
    return scale_laf_parts(laf, min(width, height), width, height)
