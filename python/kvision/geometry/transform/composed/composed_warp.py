"""Chains of matrices and maps as one warp.

A link is a matrix (B, 3, 3) that maps pixels of its input to pixels of its output, or a map: displacements (B, 2, H, W), x and y
in pixels, so that pixel p of its output reads its input at p + displacement. Displacements are interpolated bilinearly, with the
replicate border. The sampling coordinates of a pixel of the result are found by walking back through the chain, from the last link
to the first. The image is interpolated once, and no intermediate image is stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._clamp import clamp
from kvision._dtype import compute_dtype
from kvision._limits import MAX_LINKS
from kvision._modes import INTERPOLATION_NAMES, PADDING_NAMES
from kvision._ops import has_pixels, register
from kvision.geometry.linalg import adjugate
from kvision.geometry.transform import sampling

# Arguments of the operators: MAX_LINKS links in the compute type, the first one first, None after the last one; each has one row or
# one for each sample. composed_coords gives the sampling coordinates (B, 2, h, w) of the pixels of a result of size (h, w).


def _coords_reference(*args: Any) -> Tensor:
    *links, size = args
    links = [link for link in links if link is not None]
    batch, (height, width), like = max(link.shape[0] for link in links), size, links[0]
    x = torch.arange(width, dtype=torch.float64, device=like.device).expand(batch, height, width)
    y = torch.arange(height, dtype=torch.float64, device=like.device)[:, None].expand(batch, height, width)
    for link in reversed(links):
        x, y = _apply_inverse(link.double(), x, y) if link.dim() == 3 else _displaced(link.double(), x, y)
    return torch.stack([x, y], 1).to(like.dtype)


def _apply_inverse(matrix: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    inverse = adjugate(matrix)
    m = (inverse / sampling.homography_scale(inverse.detach()))[..., None, None]
    u, v, depth = (m[:, i, 0] * x + (m[:, i, 1] * y + m[:, i, 2]) for i in range(3))
    horizon = depth == 0
    depth = torch.where(horizon, 1, depth)
    return torch.where(horizon, torch.nan, u / depth), torch.where(horizon, torch.nan, v / depth)


def _displaced(displacements: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    batch, (height, width) = x.shape[0], displacements.shape[2:]
    planes = displacements.expand(batch, -1, -1, -1).flatten(2)
    (column, right, tx), (row, below, ty) = _pair(x, width), _pair(y, height)

    def at(rows: Tensor, columns: Tensor) -> Tensor:
        index = (rows * width + columns).flatten(1)[:, None].expand(-1, 2, -1)
        return planes.gather(2, index).unflatten(2, x.shape[1:])

    tx, ty = tx[:, None], ty[:, None]
    above = at(row, column) * (1 - tx) + at(row, right) * tx
    under = at(below, column) * (1 - tx) + at(below, right) * tx
    moved = above * (1 - ty) + under * ty
    return x + moved[:, 0], y + moved[:, 1]


def _pair(x: Tensor, size: int) -> tuple[Tensor, Tensor, Tensor]:
    """The two pixels around a coordinate along an axis, and the weight of the second one."""
    x = clamp(torch.where(x >= 0, x, 0.0), high=size - 1)  # NaN is at the first pixel
    first = x.detach().floor().clamp(max=max(size - 2, 0))
    return first.long(), (first.long() + 1).clamp(max=size - 1), x - first


def _coords_backward(needs: Sequence[bool], grad: Tensor, *args: Any) -> list[Tensor | None]:
    links = args[:MAX_LINKS]
    grads = _composed_coords_backward(grad, *links, [int(need) for need in needs[:MAX_LINKS]])
    return [g.sum_to_size(link.shape) if need else None for need, g, link in zip(needs, grads, links)]


def _coords_backward_reference(grad: Tensor, *args: Any) -> tuple[Tensor, ...]:
    """The gradients of each sample, (B, 0) where none is needed."""
    *links, needs_grad = args
    batch, size = grad.shape[0], grad.shape[2:]
    indices = [i for i, needed in enumerate(needs_grad) if needed and links[i] is not None]

    def coords(*values: Tensor) -> Tensor:
        full = list(links)
        for i, value in zip(indices, values):
            full[i] = value
        return _coords_reference(*full, size)

    vjp_fn: Any = torch.func.vjp(coords, *(links[i].expand(batch, *links[i].shape[1:]) for i in indices))[1]
    grads = dict(zip(indices, vjp_fn(grad)))
    return tuple(grads[i].contiguous() if i in grads else grad.new_empty(batch, 0) for i in range(MAX_LINKS))


def _fake_coords(*args: Any) -> Tensor:
    *links, size = args
    batch = max(link.shape[0] for link in links if link is not None)
    return links[0].new_empty(batch, 2, *size)


def _fake_coords_backward(grad: Tensor, *args: Any) -> list[Tensor]:
    *links, needs_grad = args
    shapes = [link.shape[1:] if need and link is not None else (0,) for link, need in zip(links, needs_grad)]
    return [grad.new_empty(grad.shape[0], *shape) for shape in shapes]


def _adds_by_atomics(grad: Tensor, *args: Any) -> bool:
    *links, needs_grad = args
    return grad.is_cuda and any(need and link is not None and link.dim() == 4 for link, need in zip(links, needs_grad))


composed_coords = register(
    "composed_coords", _coords_reference, fake=_fake_coords, backward=_coords_backward, casts_outputs=True
)
_composed_coords_backward = register(
    "composed_coords_backward",
    _coords_backward_reference,
    fake=_fake_coords_backward,
    casts_outputs=True,
    nondeterministic=_adds_by_atomics,
)


def _reference(image: Tensor, *args: Any) -> Tensor:
    *links, fill, size, interpolation, padding, align_corners = args
    coords = _coords_reference(*links, size).expand(image.shape[0], -1, -1, -1).to(compute_dtype(image))
    mode, border = INTERPOLATION_NAMES[interpolation], PADDING_NAMES[padding]
    return sampling.sample(image, coords.unbind(1), mode, border, align_corners, fill)


def _backward(needs: Sequence[bool], grad: Tensor, image: Tensor, *args: Any) -> list[Tensor | None]:
    """Computes the sampling coordinates again and calls the backward operators of remap."""
    links, fill, size, options = args[:MAX_LINKS], args[MAX_LINKS], args[MAX_LINKS + 1], args[MAX_LINKS + 2 :]
    needs_links, needs_fill = needs[1 : MAX_LINKS + 1], needs[MAX_LINKS + 1]
    map_x, map_y = composed_coords(*links, size).unbind(1)
    needed = (needs[0], any(needs_links), any(needs_links), needs_fill, False)
    grad_image, grad_x, grad_y, grad_fill, _ = sampling.remap.backward(
        needed, grad, image, map_x, map_y, fill, None, *options, False, False
    )
    grads: list[Tensor | None] = [None] * MAX_LINKS
    if grad_x is not None and grad_y is not None:
        grads = _coords_backward(needs_links, torch.stack([grad_x, grad_y], 1), *links, size)
    return [grad_image, *grads, grad_fill]


composed_warp = register(
    "composed_warp",
    _reference,
    fake=lambda image, *args: (*image.shape[:2], *args[MAX_LINKS + 1]),
    backward=_backward,
    bytes=True,
    supports=has_pixels,
)


def link_arguments(links: Sequence[Tensor], size: Sequence[int]) -> list[Tensor | None]:
    """The links as arguments of the operators, padded by None. The last links of a longer chain are composed to one map."""
    arguments = list(links)
    while len(arguments) > MAX_LINKS:
        height, width = size
        coords = composed_coords(*arguments[-MAX_LINKS:], list(size))
        y, x = (torch.arange(n, dtype=coords.dtype, device=coords.device) for n in (height, width))
        pixels = torch.stack([x.expand(height, width), y[:, None].expand(height, width)])
        arguments[-MAX_LINKS:] = [coords - pixels]
    return [*arguments, *[None] * (MAX_LINKS - len(arguments))]
