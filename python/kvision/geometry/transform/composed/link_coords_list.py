"""Chains of matrices and maps on lists: where the results of a list read its images, a link at a time.

A link has a matrix for each image, (B, 3, 3), or maps of a size each in one tensor, as `remap_list` takes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._ops import register
from kvision.geometry.transform.composed.composed_warp import _apply_inverse, _displaced
from kvision.geometry.transform.lists.remap_list import packed, packed_size, unpacked

# Arguments of the operator: the link; the coordinates in one tensor that results read behind it, or None for their own pixels; of
# maps height and width of each; height and width of each result.


def _reference(link: Tensor, coordinates: Tensor | None, before: Sequence[int], sides: Sequence[int]) -> Tensor:
    behind: list[Any] = [None] * (len(sides) // 2) if coordinates is None else unpacked(coordinates, sides)
    links = link.split(1) if link.dim() == 3 else [own[None] for own in unpacked(link, before)]
    each = []
    for own, known, height, width in zip(links, behind, sides[::2], sides[1::2]):
        if known is None:
            y, x = (torch.arange(n, dtype=torch.float64, device=link.device) for n in (height, width))
            known = torch.stack([x.expand(height, width), y[:, None].expand(height, width)])
        x, y = known.double()[:, None]
        read = _apply_inverse(own.double(), x, y) if link.dim() == 3 else _displaced(own.double(), x, y)
        each.append(torch.cat(read).to(link.dtype))
    return packed(each)


link_coords_list = register(
    "link_coords_list",
    _reference,
    fake=lambda link, coordinates, before, sides: (packed_size(sides),),
    flatten=lambda *_: None,  # of a list there is no vmap
)


def composed_coords_list(links: Sequence[tuple[Tensor, Sequence[int]]], sides: Sequence[int]) -> Tensor:
    """The coordinates (2, h, w) of results of these heights and widths, in one tensor, after a chain of links.

    The first link is the first one; with maps comes height and width of each, with matrices nothing.
    """
    coordinates: Tensor | None = None
    for link, before in reversed(links):
        link = link if link.dim() == 1 else link.expand(len(sides) // 2, 3, 3)
        coordinates = link_coords_list(link, coordinates, list(before), list(sides))
    assert coordinates is not None
    return coordinates
