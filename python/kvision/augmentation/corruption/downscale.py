"""Images of fewer pixels, enlarged again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype
from kvision._ops import without_autocast_and_tf32
from kvision.augmentation.engine import Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.random_generator.mapped import MappedGenerator
from kvision.augmentation.ranges import Numbers


class Downscale(IntensityAugmentationBase2D, keeps_contract=True):
    """Shrink images by a random factor and enlarge them again, so that pixels become blocks.

    Args:
        scale_range: pair of the lowest and the highest factor, above 0 and at most 1; at least one pixel remains.
        antialias: blocks are means of their pixels; otherwise one of them.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0.0, 0.2, 0.4, 0.6]]]])
        >>> K.augmentation.Downscale((0.5, 0.5), antialias=True, p=1.0)(x)
        tensor([[[[0.1000, 0.1000, 0.5000, 0.5000]]]])
    """

    accepts_bytes = False

    def __init__(
        self,
        scale_range: Numbers = (0.25, 0.25),
        antialias: bool = False,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self.antialias = _check.switch("Downscale", "antialias", antialias)
        self._param_generator = MappedGenerator(
            (scale_range, "scale", None, (1e-6, 1.0)), identity=[1.0], op="Downscale"
        )

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        scale = params["scale"].to(input.device, torch.float64)[:, None]
        sizes = [(n * scale).round().clamp(min=1) for n in input.shape[-2:]]
        if self.antialias:
            means: Tensor = block_means(input, sizes)
            return means
        y, x = (_read(_block(n, size), n, size) for n, size in zip(input.shape[-2:], sizes))
        at = y[:, :, None] * input.shape[-1] + x[:, None]
        return input.flatten(2).gather(2, at.flatten(1)[:, None].expand(-1, input.shape[1], -1)).view_as(input)


@without_autocast_and_tf32
def block_means(x: Tensor, sizes: Sequence[Tensor], whole: bool = False) -> Tensor:
    """Images whose pixels are the means of blocks, of which `sizes` (B, 1) lie down and across.

    Pixels belong to blocks in part, or, if they are `whole`, to the one that their center is in, as in Pillow's box filter.
    """
    down, across = (_block_means(n, size, whole).to(compute_dtype(x)) for n, size in zip(x.shape[-2:], sizes))
    return down[:, None] @ x.to(down.dtype) @ across[:, None].mT


def _block(size: int, count: Tensor) -> Tensor:
    """The blocks (B, size) of pixels along an axis that has `count` (B, 1) of them."""
    return (torch.arange(size, device=count.device) * count / size).floor()


def _read(block: Tensor, size: int, count: Tensor) -> Tensor:
    """The pixels that blocks show."""
    return (block * size / count).floor().long().clamp(max=size - 1)


def _block_means(size: int, count: Tensor, whole: bool) -> Tensor:
    """Weights (B, size, size) of pixels in the blocks of others: those that the center of a pixel is in."""
    length, at = size / count, torch.arange(size, device=count.device, dtype=count.dtype)
    first = (((at + 0.5) / length).floor() * length)[..., None]
    last = first + length[..., None]
    if whole:
        covered = ((at + 0.5 > first) & (at + 0.5 <= last)).to(at)
    else:
        covered = (torch.minimum(at + 1, last) - torch.maximum(at, first)).clamp(min=0)
    return covered / covered.sum(2, keepdim=True)
