"""Helpers for chosen samples, added axes and masks of known pixels."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision.augmentation.base.execution import Shape


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


def known_everywhere(shape: Shape, device: torch.device) -> Tensor:
    """One channel of ones for images of a shape (B, C, H, W)."""
    return torch.ones((shape[0], 1, *shape[2:]), device=device)


def is_known(back: Tensor) -> Tensor:
    """Pixels that were read from ones alone."""
    return back > 1 - 1e-3
