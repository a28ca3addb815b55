"""Sides of the images of a batch, or of those of a list, which differ: for maps that are computed for all of them at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._constants import on_device
from kvision._dtype import compute_dtype
from kvision.geometry.transform.lists.arguments import sizes


class Side(NamedTuple):
    """A side in pixels: of all images of a batch, or (B, 1) of those of a list, float64, and the longest of them."""

    size: int | Tensor
    longest: int

    def positions(self, like: Tensor) -> Tensor:
        """The positions of pixels along the longest side, of the type and device of a tensor."""
        return torch.arange(self.longest, dtype=like.dtype, device=like.device)

    def inside(self, like: Tensor) -> Tensor:
        """Which positions the images of a list have, bool (B, longest)."""
        return self.positions(like.double()) < self.size

    def extremes(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """The least and the most (B, 1) of values (B, longest) at pixels of the images."""
        if isinstance(self.size, Tensor):
            inside = self.inside(values)
            return (
                values.masked_fill(~inside, torch.inf).amin(1, keepdim=True),
                values.masked_fill(~inside, -torch.inf).amax(1, keepdim=True),
            )
        return values.amin(1, keepdim=True), values.amax(1, keepdim=True)


def sizes_of_list(images: Sequence[Tensor]) -> Tensor:
    """Height and width of images (C, H, W), (B, 2) float64 on their device."""
    return rows_on_device(torch.tensor(sizes(images), dtype=torch.float64, device="cpu").view(-1, 2), images[0])


def sides_of(like: Tensor, images: Sequence[Tensor] | None) -> tuple[Any, Any]:
    """Height and width of images like a batch, or (B, 1) of those of a list, of the type that is computed in."""
    if images is None:
        height, width = like.shape[-2:]
        return height, width
    own = sizes_of_list(images).to(compute_dtype(like))
    return own[:, :1], own[:, 1:]


def rows_on_device(rows: Tensor, like: Tensor, dtype: torch.dtype = torch.float64) -> Tensor:
    """A row of numbers of each image on the CPU, on the device of a tensor, without waiting for it."""
    return on_device(rows.to(dtype), like.device)


def sides_of_list(images: Sequence[Tensor]) -> tuple[Side, Side]:
    """The heights and the widths of images (C, H, W)."""
    each, own = sizes(images), sizes_of_list(images)
    return Side(own[:, :1], max(each[::2])), Side(own[:, 1:], max(each[1::2]))
