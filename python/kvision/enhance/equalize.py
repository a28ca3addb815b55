"""Histogram equalization of whole image planes and volumes."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._ops import register
from kvision.enhance.batch import as_batch, images, shaped

LEVELS = 256


def levels(x: Tensor) -> Tensor:
    """The 8-bit levels floor(255 x) of an image as int64, values outside [0, 1] saturated, NaN as 0.

    The product is rounded to the type of the image, so that the levels of bytes divided by 255 are those bytes, in
    every type that can tell them apart.
    """
    return (x.nan_to_num(0.0).clamp(0, 1) * 255).long()


def level_counts(level: Tensor, counted: Tensor) -> Tensor:
    """Histograms (*, 256) of levels (*, P), with a mask of those that count."""
    zero = torch.zeros_like(level[..., :1]).expand(*level.shape[:-1], LEVELS)
    return zero.scatter_add(-1, level, counted.to(level.dtype))


def _reference(x: Tensor, opencv: bool) -> tuple[Tensor, Tensor]:
    """Equalize every plane of (B, C, H, W); also return (B, C): 0 for planes that are unchanged, 1 for planes that are
    mapped, 2 for planes that are mapped except for their NaN."""
    flat = x.flatten(2)
    level, number = levels(flat), ~flat.isnan()
    table, changes = (_opencv_table if opencv else _pil_table)(level_counts(level, number))
    equalized = table.gather(-1, level).to(x.dtype) / 255
    change = changes * (2 - number.all(-1, keepdim=True).long())
    return torch.where(changes & number, equalized, flat).reshape(x.shape), change.to(x.dtype).squeeze(-1)


def _pil_table(counts: Tensor) -> tuple[Tensor, Tensor]:
    """PIL: one output level takes a whole number of pixels; the brightest level that is not empty is not counted."""
    bins = torch.arange(LEVELS, device=counts.device)
    brightest = torch.where(counts > 0, bins, 0).amax(-1, keepdim=True)
    step = (counts.sum(-1, keepdim=True) - counts.gather(-1, brightest)) // 255
    darker = counts.cumsum(-1) - counts
    return ((darker + step // 2) // step.clamp(min=1)).clamp(max=255), step > 0


def _opencv_table(counts: Tensor) -> tuple[Tensor, Tensor]:
    """OpenCV: the darkest level that is not empty is not counted, and levels are rounded."""
    darkest = counts.gather(-1, (counts > 0).int().argmax(-1, keepdim=True))
    counted = counts.sum(-1, keepdim=True) - darkest
    up_to = (counts.cumsum(-1) - darkest).clamp(min=0)
    scale = torch.full_like(counted, 255, dtype=torch.float32) / counted.clamp(min=1)  # 255 / x multiplies by 1 / x
    return (up_to * scale).round(), counted > 0


def _equalize_vjp(grad: Tensor, output: Tensor, changed: Tensor | None) -> Tensor:
    """Levels have zero gradient; pixels that are returned unchanged pass theirs."""
    equalized = ~output.isnan()
    if changed is not None:
        equalized &= (changed > 0)[..., None, None]
    return grad.masked_fill(equalized, 0)


equalize_backward = register(
    "equalize_backward",
    _equalize_vjp,
    gradients="grad: equalize_backward(grad=grad_grad)",
    native_half=True,
    layout_of=1,
)


_equalize = register(
    "equalize",
    _reference,
    fake=lambda x, _: [x.shape, x.shape[:2]],
    gradients="input: equalize_backward(output=result0, changed=result1)",
    non_differentiable=(1,),
    native_half=True,
    bytes=True,
    levels=255,
    clamps=True,
)


def equalize(input: Tensor, opencv: bool = False) -> Tensor:
    """Spread the values of every image plane evenly over [0, 1]; PIL's equalize.

    Args:
        input: (*, H, W), floating point, in [0, 1], or uint8. A value x has the level floor(255 x); values outside
            count as 0 or 1, and NaN does not count.
        opencv: return the result of `cv2.equalizeHist` for the bytes 255 x, divided by 255 as above, instead of PIL's.

    Returns:
        The image with equalized levels, divided by 255 unless it is uint8. A plane that has no 255 pixels below its
        brightest level, or with opencv all pixels in one level, comes back as it is. There is no gradient, except that
        of the pixels that come back as they are.

    Raises:
        TypeCheckError: input is not a tensor of floats or uint8, opencv not a bool.
        ShapeError: input is not (*, H, W), or has no pixels.

    Example:
        >>> import torch, kvision as K
        >>> ramp = torch.linspace(0.4, 0.6, 1024).view(1, 1, 32, 32)
        >>> y = K.enhance.equalize(ramp)
        >>> y.amin(), y.amax()
        (tensor(0.), tensor(1.))
    """
    images("equalize", "input", input)
    _check.flag("equalize", "opencv", opencv)
    return shaped(_equalize(as_batch(input), opencv)[0], input)


def equalize3d(input: Tensor) -> Tensor:
    """Spread the values of every volume evenly over [0, 1]: `equalize` over depth, height and width.

    Args:
        input: (*, D, H, W), floating point, in [0, 1], or uint8; values outside count as 0 or 1, and NaN does
            not count.

    Returns:
        The volumes with equalized levels, as :func:`equalize` gives them.

    Raises:
        TypeCheckError: input is not a tensor of floats or uint8.
        ShapeError: input is not (*, D, H, W), or has no voxels.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.equalize3d(torch.rand(2, 1, 4, 16, 16)).shape
        torch.Size([2, 1, 4, 16, 16])
    """
    images("equalize3d", "input", input, spatial=3)
    return _equalize(as_batch(input.flatten(-3, -2)), False)[0].reshape(input.shape)
