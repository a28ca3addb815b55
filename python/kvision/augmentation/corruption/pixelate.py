"""Images of blocks: each pixel becomes the value of the block that it lies in."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision._dtype import compute_dtype
from kvision._limits import MAX_PIXELATE_ROW, MAX_PIXELATE_SIDE
from kvision._modes import BLOCK_VALUE
from kvision._ops import match_layout, register, without_autocast_and_tf32
from kvision.geometry.transform.lists.arguments import largest_shape, row
from kvision.geometry.transform.lists.kept_sizes import register_filter


@without_autocast_and_tf32
def _reference(images: Tensor, counts: Tensor, value: int) -> Tensor:
    """`counts` (B, 2) of blocks down and across, whole numbers from 1 to the pixels that there are.

    A block is the mean of what it covers of pixels, or of the pixels whose centers it covers, as in Pillow's box filter: pixels
    show the block that their centers lie in. Or it is the pixel that its first corner lies in, as in OpenCV's nearest
    interpolation, and pixels show the block that their first corners lie in.
    """
    down, across = _axes(images, counts, value)
    x = images.to(down.dtype)
    is_number = x.isfinite()  # blocks that have none keep away from the sums of others
    mean = down @ torch.where(is_number, x, 0) @ across.mT
    own = down.dtype
    has_others = (down > 0).to(own) @ (~is_number).to(own) @ (across > 0).to(own).mT > 0
    mean = torch.where(has_others, torch.nan, mean)
    return match_layout((mean.round() if images.dtype == torch.uint8 else mean).to(images.dtype), images)


@without_autocast_and_tf32
def _reference_backward(grad: Tensor, counts: Tensor, value: int) -> Tensor:
    """The transpose."""
    down, across = _axes(grad, counts, value)
    return match_layout((down.mT @ grad.to(down.dtype) @ across).to(grad.dtype), grad)


def _axes(images: Tensor, counts: Tensor, value: int) -> list[Tensor]:
    """The weights (B, 1, size, size) down and across, of the type that is computed in."""
    sizes, own = images.shape[-2:], compute_dtype(images)
    each = [count.long().clamp(min=1).clamp(max=size)[:, None] for count, size in zip(counts.unbind(1), sizes)]
    return [_weights(size, count, value).to(own)[:, None] for size, count in zip(sizes, each)]


def _weights(size: int, count: Tensor, value: int) -> Tensor:
    """Weights (B, size, size) of pixels in the blocks that others show."""
    # Positions are multiples of a pixel divided by `count`: `low` of pixels, and `first` of blocks.
    low = torch.arange(size, device=count.device) * count
    if value == BLOCK_VALUE["pixel"]:
        return F.one_hot(low // size * size // count, size).double()
    first = ((2 * low + count) // (2 * size) * size)[..., None]
    last, low, high = first + size, low[:, None], (low + count)[:, None]
    if value == BLOCK_VALUE["mean_of_whole"]:
        covered = (low + high > 2 * first) & (low + high <= 2 * last)
    else:
        covered = (torch.minimum(high, last) - torch.maximum(low, first)).clamp(min=0)
    return covered.double() / covered.sum(2, keepdim=True)


def _supports(images: Tensor, *_: object) -> str | None:
    """Positions fit 32 bits, and on CUDA a row fits shared memory."""
    return _serves(tuple(images.shape), images)


def _supports_list(images: Sequence[Tensor], *_: object) -> str | None:
    """Positions fit 32 bits, and on CUDA a row fits shared memory."""
    return _serves(largest_shape(images), images[0])


def _serves(shape: tuple[int, ...], like: Tensor) -> str | None:
    height, width = shape[-2:]
    row_size = width * (1 if like.is_contiguous() else shape[1])
    if max(height, width) > MAX_PIXELATE_SIDE or (like.is_cuda and row_size > MAX_PIXELATE_ROW):
        return f"there is no kernel for images as large as {shape}"
    return None


pixelate = register(
    "pixelate", _reference, gradients="images: pixelate_backward", linear=True, bytes=True, supports=_supports
)
_pixelate_backward = register(
    "pixelate_backward",
    _reference_backward,
    gradients="grad: pixelate(images=grad_grad)",
    linear=True,
    supports=_supports,
)


def _of_sample(b: int, counts: Tensor, value: int) -> tuple[Tensor | None, int]:
    return row(counts, b), value


register_filter("pixelate_list", pixelate, _of_sample, transposed=_pixelate_backward, supports=_supports_list)
register_filter("pixelate_backward_list", _pixelate_backward, _of_sample, transposed=pixelate, supports=_supports_list)
