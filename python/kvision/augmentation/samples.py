"""Helpers for chosen samples, added axes and masks of known pixels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor


def without_added_axes(y: Tensor, input: Tensor) -> Tensor:
    """The result of a batch of one with as many axes as the input had."""
    return y.reshape(y.shape[y.dim() - input.dim() :]) if y.dim() > input.dim() else y


def with_matrix(y: Any, before: Tensor | None, transform: Tensor | None) -> Any:
    """A result, with its matrix behind the one that came with the images; `transform` is None if it is not asked for."""
    if transform is None:
        return y if before is None else (y, before)
    return y, transform if before is None else transform @ before.to(transform)


def per_sample(values: Tensor, like: Tensor) -> Tensor:
    """Values (B,) that broadcast with the samples of `like`, (B, 1, ...) on its device."""
    return values.to(like.device).reshape(-1, *[1] * (like.dim() - 1))


def where_chosen(chosen: Tensor | None, y: Tensor, x: Tensor | float) -> Tensor:
    """`y` of the samples that are chosen, None for all, and `x` of the others."""
    return y if chosen is None else torch.where(per_sample(chosen, y), y, x)


def inverse_at(x: Tensor, size: Sequence[int], invert: Callable[[Tensor], Tensor]) -> Tensor:
    """The inverse of predictions of any size for results of a size: enlarged, moved back, and read at their own scale.

    Both times the pixels at the centers are read, with the edges of the images in place.
    """
    own = x.shape[2:]
    if tuple(own) == tuple(size) or 0 in x.shape or 0 in size or len(own) != len(size):
        return invert(x)
    return at_scale(invert(_read_nearest(x, size)), own, size)


def at_scale(y: Tensor, own: Sequence[int], size: Sequence[int]) -> Tensor:
    """What is as large as the images before a call, read at the scale of predictions of a size `own` for results of `size`."""
    if tuple(own) == tuple(size) or 0 in own or 0 in size or len(own) != len(size):
        return y
    return _read_nearest(y, [max((2 * n * m + k) // (2 * k), 1) for n, m, k in zip(y.shape[2:], own, size)])


def _read_nearest(x: Tensor, size: Sequence[int]) -> Tensor:
    """Images (B, C, ...) of a size, each pixel of which is the one at its center."""
    for axis, n in enumerate(size, start=2):
        at = (torch.arange(n, device=x.device) * 2 + 1) * x.shape[axis] // (2 * n)
        x = x.index_select(axis, at)
    return x


def known_everywhere(shape: tuple[int, ...], device: torch.device) -> Tensor:
    """One channel of ones for images of a shape (B, C, H, W)."""
    return torch.ones((shape[0], 1, *shape[2:]), device=device)


def is_known(back: Tensor) -> Tensor:
    """Pixels that were read from ones alone."""
    return back > 1 - 1e-3
