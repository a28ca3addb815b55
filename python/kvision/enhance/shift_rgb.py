"""Shift of the color channels."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision.color.scale_shift import scale_shift_rgb
from kvision.core.exceptions import ImageError, ShapeError
from kvision.enhance.batch import parameter


def shift_rgb(image: Tensor, r_shift: float | Tensor, g_shift: float | Tensor, b_shift: float | Tensor) -> Tensor:
    """Add a number to each channel of an RGB image and clamp to [0, 1].

    Args:
        image: (B, 3, H, W), floating point, in [0, 1], or uint8.
        r_shift: what is added to red: a number, or a tensor (B,) or (1,).
        g_shift: what is added to green.
        b_shift: what is added to blue.

    Returns:
        The image with other colors, differentiable in image and shifts.

    Raises:
        TypeCheckError: image is not a tensor of floats or uint8; a shift is neither number nor tensor.
        ImageError: image is not (B, 3, H, W).
        ShapeError: a shift that is not (B,) or (1,).
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.shift_rgb(torch.full((1, 3, 1, 1), 0.5), 0.1, 0.0, -0.6).flatten()
        tensor([0.6000, 0.5000, 0.0000])
    """
    _check.numbers("shift_rgb", "image", image)
    _check.floating_or_bytes("shift_rgb", "image", image)
    if image.dim() != 4 or image.shape[1] != 3:
        raise ImageError(f"shift_rgb: expected image of shape (B, 3, H, W), got {tuple(image.shape)}")
    shifts = [_shift(n, s, image) for n, s in (("r_shift", r_shift), ("g_shift", g_shift), ("b_shift", b_shift))]
    return scale_shift_rgb(image, 1.0, 1.0, 1.0, *shifts, 1.0)


def _shift(name: str, shift: float | Tensor, image: Tensor) -> float | Tensor:
    checked = parameter("shift_rgb", name, shift, image)
    if isinstance(checked, Tensor) and checked.shape[1:].numel() != 1:
        raise ShapeError(f"shift_rgb: expected {name} of shape (B,), got {tuple(shift.shape)}")  # type: ignore[union-attr]
    return checked
