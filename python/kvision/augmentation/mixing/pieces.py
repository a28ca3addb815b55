"""Images that are made of pieces of the images of a batch, as mixing augmentations make them.

A piece is a rectangle of a result that reads from a sample at a distance: (left, top, right, bottom, source, user, dx, dy, weight).
Columns [left, right) and rows [top, bottom) become v + weight (s - v): v is what is there, the image itself or earlier pieces, and
s the pixel at a distance of (dx, dy) of the sample `source` behind this one, 0 outside of its image. `user` is where the sample is
whose piece of the same number reads from this one; there is exactly one, so that gradients are gathered.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision._limits import MAX_PIECES
from kvision._modes import MIX_KIND
from kvision._ops import match_layout, register
from kvision.augmentation.random_generator import mix as drawn

# --- from partners, windows and weights -----------------------------------------------------------------------------


def make_piece(
    window: Tensor, partner: Tensor | None = None, shift: Tensor | None = None, weight: Tensor | float = 1.0
) -> Tensor:
    """A piece (B, 9) for windows (B, 4), a permutation (B,) of the samples, shifts (B, 2) and weights (B,)."""
    window = window.float()
    samples = torch.arange(window.shape[0], device=window.device)
    zero = torch.zeros_like(window[:, 0])
    source, user = (zero, zero) if partner is None else (partner - samples, partner.argsort() - samples)
    moved = zero[:, None].expand(-1, 2) if shift is None else shift.float()
    weights = weight.float() if isinstance(weight, Tensor) else torch.full_like(zero, weight)
    return torch.cat([window, torch.stack([source, user], 1).float(), moved, weights[:, None]], 1)


def mixup_pieces(partner: Tensor, weight: Tensor, height: int, width: int) -> Tensor:
    """Another image over the whole of each."""
    window = torch.tensor([0, 0, width, height], device=weight.device).expand(len(weight), 4)
    return make_piece(window, partner, weight=weight)[:, None]


def cutmix_pieces(rounds: Sequence[tuple[Tensor, Tensor]]) -> Tensor:
    """Windows (B, 4) of partners (B,), in rounds."""
    return torch.stack([make_piece(window, partner) for partner, window in rounds], 1)


def jigsaw_pieces(order: Tensor, grid: tuple[int, int], height: int, width: int) -> Tensor:
    """The cells of a grid in an order (B, cells)."""
    (rows, columns), cells = grid, torch.arange(order.shape[1], device=order.device)
    size = torch.tensor([width // columns, height // rows], device=order.device)
    corner = torch.stack([cells % columns, cells // columns], 1) * size
    pieces = []
    for n in range(order.shape[1]):
        window = torch.cat([corner[n], corner[n] + size]).expand(len(order), 4)
        pieces.append(make_piece(window, shift=corner[order[:, n]] - corner[n]))
    return torch.stack(pieces, 1)


def mosaic_pieces(
    permutation: Tensor, start: Tensor, grid: tuple[int, int], source: tuple[int, int], size: tuple[int, int]
) -> Tensor:
    """Images in a grid, samples `permutation` (B, cells), seen through a window that begins at `start` (B, 2)."""
    (height, width), start = source, start.long()
    whole = torch.tensor([0, 0, size[1], size[0]], device=start.device).expand(len(start), 4)
    # The first one reads out of the image: 0 is where there is no cell.
    pieces = [make_piece(whole, shift=torch.tensor([width, height], device=start.device).expand(len(start), 2))]
    for n, partner in enumerate(permutation.unbind(1)):
        corner = torch.tensor([n % grid[1] * width, n // grid[1] * height], device=start.device) - start
        window = torch.cat([corner, corner + torch.tensor([width, height], device=start.device)], 1)
        pieces.append(make_piece(window, partner, -corner))
    return torch.stack(pieces, 1)


def _mix_reference(columns: Tensor, plan: Sequence[int], numbers: Sequence[float]) -> Tensor:
    kind, first, chosen, count, rows, across, height, width, h, w = plan
    values = columns[:, first:]
    if kind == MIX_KIND["mixup"]:
        return mixup_pieces(drawn.partners(values[:, 0]), values[:, 1], height, width)
    if kind == MIX_KIND["cutmix"]:
        low, high = numbers
        rounds = []
        for order, kept, u, v in values[:, : 4 * count].unflatten(1, (count, 4)).permute(1, 2, 0):
            window = drawn.cutmix_window(kept, u, v, low, high, height, width)
            rounds.append((drawn.partners(order), window))
        return cutmix_pieces(rounds)
    if kind == MIX_KIND["patch_mix"]:
        corner = values[:, 1:3].long()
        window = torch.cat([corner, corner + torch.tensor([across, rows], device=corner.device)], 1)
        return cutmix_pieces([(drawn.partners(values[:, 0]), window)])
    if kind == MIX_KIND["jigsaw"]:
        order = drawn.jigsaw_order(values[:, :count], bool(numbers[0]))
        pieces = jigsaw_pieces(order, (rows, across), height, width)
    else:
        start = drawn.mosaic_start(values[:, 0], values[:, 1], (rows, across), (height, width), (h, w))
        permutation = drawn.mosaic_permutation(values[:, 2:count])
        pieces = mosaic_pieces(permutation, torch.stack(start, 1), (rows, across), (height, width), (h, w))
    if chosen >= 0:  # the others keep their image: their pieces have no columns
        is_mixed = columns[:, chosen, None] > 0.5
        pieces[..., 2] = torch.where(is_mixed, pieces[..., 2], pieces[..., 0])
    return pieces


# The pieces (B, N, 9) of a mixing augmentation, from the columns (B, P) that it has drawn. The plan is the number of its kind, the
# first column, the column that says which samples are mixed or -1, N, rows and columns of its grid (or height and width of its
# patch), height and width of the images and of the results. Partners are found in the whole batch.
mix_pieces = register(
    "mix_pieces",
    _mix_reference,
    fake=lambda columns, plan, numbers: (columns.shape[0], plan[3], 9),
    flatten=lambda n, in_dims, args: None,
    backward=lambda needs, grad, *_: [None],
)


# --- images ---------------------------------------------------------------------------------------------------------


def _paste_reference(images: Tensor, pieces: Tensor, size: Sequence[int]) -> Tensor:
    height, width = size
    y = F.pad(images, (0, width - images.shape[3], 0, height - images.shape[2]))
    rows, columns = (torch.arange(n, device=images.device) for n in (height, width))
    whole = pieces[..., :8].long()
    for (left, top, right, bottom, source, _, dx, dy), weight in zip(whole.permute(1, 2, 0), pieces[..., 8].unbind(1)):
        across = (columns >= left[:, None]) & (columns < right[:, None])
        down = (rows >= top[:, None]) & (rows < bottom[:, None])
        inside = (down[:, :, None] & across[:, None])[:, None]
        other = _shifted(images, source, columns + dx[:, None], rows + dy[:, None])
        if images.is_floating_point():
            part = weight.to(images)[:, None, None, None]
            other = torch.where(part == 1, other, y * (1 - part) + other * part)
        y = torch.where(inside, other, y)
    return match_layout(y, images)


def _shifted(images: Tensor, source: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Columns x (B, w) and rows y (B, h) of the samples `source` behind each, 0 outside."""
    height, width = images.shape[2:]
    samples = torch.arange(len(images), device=images.device) + source
    inside = ((0 <= y) & (y < height))[:, :, None] & ((0 <= x) & (x < width))[:, None]
    inside = inside & ((0 <= samples) & (samples < len(images)))[:, None, None]
    at = samples.clamp(0, max(len(images) - 1, 0))[:, None, None]
    read = images[at, :, y.clamp(0, height - 1)[:, :, None], x.clamp(0, width - 1)[:, None]]
    return torch.where(
        inside[:, None], read.permute(0, 3, 1, 2), torch.zeros((), dtype=images.dtype, device=images.device)
    )


def _paste_backward_reference(grad: Tensor, pieces: Tensor, size: Sequence[int]) -> Tensor:
    zeros = grad.new_zeros(*grad.shape[:2], *size)
    vjp_fn: Any = torch.func.vjp(lambda x: _paste_reference(x, pieces, grad.shape[2:]), zeros)[1]
    return match_layout(vjp_fn(grad)[0], grad)


def _supports(images: Tensor, pieces: Tensor, *_: Any) -> str | None:
    """On CUDA the pieces of a sample fit shared memory."""
    if images.is_cuda and pieces.shape[1] > MAX_PIECES:
        return f"there is no kernel for more than {MAX_PIECES} pieces, here {pieces.shape[1]}"
    return None


def _size(images: Tensor, pieces: Any, size: Sequence[int]) -> tuple[int, ...]:
    return (*images.shape[:2], *size)


# Results (B, C, h, w) of images (B, C, H, W) and pieces (B, N, 9), which get no gradients. Integers are copied whatever the weight.
paste_pieces = register(
    "paste_pieces",
    _paste_reference,
    fake=_size,
    supports=_supports,
    gradients="images: paste_pieces_backward(size=sizes(images))",
    linear=True,
    bytes=True,
)
paste_pieces_backward = register(
    "paste_pieces_backward",
    _paste_backward_reference,
    fake=_size,
    supports=_supports,
    gradients="grad: paste_pieces(images=grad_grad, size=sizes(grad))",
    linear=True,
)
