"""Weighted sums of moved and scaled copies of images: blurs along paths."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision._constants import constant
from kvision._list_ops import ListOperator
from kvision._ops import register, vjp
from kvision.geometry.transform.lists.arguments import row
from kvision.geometry.transform.lists.kept_sizes import register_list


def _reference(images: Tensor, moves: Tensor) -> Tensor:
    """Moves (B, K, 4) are scale s, x, y and weight: the sum of weight times the image at (s column + x, s row + y).

    Values between pixels are bilinear, those outside of the image are of its border. A copy of weight 0 is not read,
    and its weight has no gradient.
    """
    total = torch.zeros_like(images)
    for scale, x, y, weight in (move.unbind(1) for move in moves.unbind(1)):
        rows = _read(images, 2, scale, y)
        moved = _read(rows, 3, scale, x)
        weight = weight[:, None, None, None]
        total = total + torch.where(weight == 0, 0.0, weight * moved)
    return total


def _read(images: Tensor, axis: int, scale: Tensor, shift: Tensor) -> Tensor:
    """Images read along an axis at scale times the index of the pixel + shift."""
    size = images.shape[axis]
    at = torch.arange(size, device=images.device, dtype=scale.dtype)
    at = (scale[:, None] * at + shift[:, None]).clamp(0, size - 1)
    first = at.long()
    t = at - first
    second = first + (t > 0)
    shape = [-1, 1, 1, 1]
    shape[axis] = size

    def gather(index: Tensor) -> Tensor:
        return images.gather(axis, index.view(shape).expand(images.shape))

    values, t = gather(first), t.view(shape)
    return torch.where(t > 0, values + t * (gather(second) - values), values)


def _reference_backward(grad: Tensor, moves: Tensor) -> Tensor:
    """The transpose."""
    of_images: Tensor = vjp(_reference)(grad, torch.zeros_like(grad), moves)
    return of_images


sum_of_moved = register(
    "sum_of_moved", _reference, gradients="images: sum_of_moved_backward; moves: reference", bytes=True
)
_sum_of_moved_backward = register(
    "sum_of_moved_backward", _reference_backward, gradients="grad: sum_of_moved(images=grad_grad); moves: reference"
)


def _kept(chosen: Tensor, moves: Tensor) -> tuple[Tensor]:
    """The moves of those that are chosen; the others are the sum of one copy that is not moved."""
    still = tuple((1.0, 0.0, 0.0, float(k == 0)) for k in range(moves.shape[1]))
    return (torch.where(chosen[:, None, None] != 0, moves, constant(still, moves)),)


def _of_sample(b: int, moves: Tensor) -> tuple[Tensor | None]:
    return (row(moves, b),)


_sum_of_moved_list: ListOperator = register_list(
    "sum_of_moved_list",
    sum_of_moved,
    _of_sample,
    kept=_kept,
    of_images=lambda grads, images, moves: _sum_of_moved_backward_list(grads, moves),
)
_sum_of_moved_backward_list: ListOperator = register_list(
    "sum_of_moved_backward_list",
    _sum_of_moved_backward,
    _of_sample,
    of_images=lambda grad_grads, grads, moves: _sum_of_moved_list(grad_grads, moves),
)
