"""Histogram equalisation of whole image planes and volumes."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision._ops import register
from kvision.enhance.batch import as_batch, images

LEVELS = 256


def levels(x: Tensor) -> Tensor:
    """The 8-bit levels floor(255 x) of an image as int64, values outside [0, 1] saturated, NaN as 0.

    The product is rounded to the type of the image, so that the levels of bytes divided by 255 are those bytes, in
    every type that can tell them apart.
    """
    return (x.nan_to_num(0.0).clamp(0, 1) * 255).long()


def level_counts(level: Tensor, counted: Tensor) -> Tensor:
    """How often each level occurs: (*, P) levels and which of them count, as (*, 256)."""
    zero = torch.zeros_like(level[..., :1]).expand(*level.shape[:-1], LEVELS)
    return zero.scatter_add(-1, level, counted.to(level.dtype))


def _reference(x: Tensor) -> tuple[Tensor, Tensor]:
    """(B, C, H, W) planes by themselves, and (B, C): 1 for planes that change, 0 for those that stay as they are."""
    flat = x.flatten(2)
    level, number = levels(flat), ~flat.isnan()
    counts = level_counts(level, number)
    # As PIL does: a whole number of pixels makes one output level, and the brightest bin that is not empty is left out.
    bins = torch.arange(LEVELS, device=x.device)
    brightest = torch.where(counts > 0, bins, 0).amax(-1, keepdim=True)
    step = (counts.sum(-1, keepdim=True) - counts.gather(-1, brightest)) // 255
    darker = counts.cumsum(-1) - counts
    table = ((darker + step // 2) // step.clamp(min=1)).clamp(max=255)
    equalized = (table.gather(-1, level).to(x.dtype)) / 255
    return torch.where((step > 0) & number, equalized, flat).reshape(x.shape), (step > 0).to(x.dtype).squeeze(-1)


def _backward(needs, grad, _, output, changed, x):
    """Levels have no gradient; what comes back as it is has its own."""
    return [grad.masked_fill((changed > 0)[..., None, None] & ~output.isnan(), 0)]


_equalize = register(
    "equalize",
    _reference,
    fake=lambda x: [x.shape, x.shape[:2]],
    backward=_backward,
    saves_results=True,
    constant=(1,),
    halves=True,
)


def equalize(input: Tensor) -> Tensor:
    """Spread the values of every image plane evenly over [0, 1]; PIL's equalize.

    Args:
        input: (*, H, W), floating point, in [0, 1]. A value x has the level floor(255 x); values outside count as 0 or
            1, and NaN does not count.

    Returns:
        The image with equalised levels, divided by 255. A plane that has no 255 pixels below its brightest level comes
        back as it is. There is no gradient, except that of the pixels that come back as they are.

    Raises:
        TypeCheckError: input is no floating-point tensor.
        ShapeError: input is not (*, H, W), or has no pixels.

    Example:
        >>> import torch, kvision as K
        >>> ramp = torch.linspace(0.4, 0.6, 1024).view(1, 1, 32, 32)
        >>> y = K.enhance.equalize(ramp)
        >>> y.amin(), y.amax()
        (tensor(0.), tensor(1.))
    """
    images("equalize", "input", input)
    return _equalize(as_batch(input))[0].reshape(input.shape)


def equalize3d(input: Tensor) -> Tensor:
    """Spread the values of every volume evenly over [0, 1]: `equalize` over depth, height and width.

    Args:
        input: (*, D, H, W), floating point, in [0, 1]; values outside count as 0 or 1, and NaN does not count.

    Returns:
        The volumes with equalised levels, as :func:`equalize` gives them.

    Raises:
        TypeCheckError: input is no floating-point tensor.
        ShapeError: input is not (*, D, H, W), or has no voxels.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.equalize3d(torch.rand(2, 1, 4, 16, 16)).shape
        torch.Size([2, 1, 4, 16, 16])
    """
    images("equalize3d", "input", input, spatial=3)
    return _equalize(as_batch(input.flatten(-3, -2)))[0].reshape(input.shape)
