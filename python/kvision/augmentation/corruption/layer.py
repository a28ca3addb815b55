"""Images behind a layer: fog, frost, drops and stains."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._clamp import clamp
from kvision._constants import constant
from kvision._dtype import compute_dtype
from kvision._ops import match_layout, register
from kvision.geometry.transform.lists.arguments import halves, largest_shape, row, sizes
from kvision.geometry.transform.lists.kept_sizes import Operation, register_filter, register_list_backward
from kvision.geometry.transform.lists.remap_list import unpacked

Layers = Tensor | Sequence[Tensor]


def _reference(images: Tensor, layer: Tensor, windows: Tensor | None, factors: Tensor) -> Tensor:
    """`x (a + b m) + c m + d` of images x, clamped to [0, 1] before and after, where m is the layer (B, C or 1, H, W).

    Factors (B or 1, C or 1, 4) are a, b, c and d. Windows (B, 3) int64 are where each sample has its layer, of any number and
    size: the index of the layer, and its first row and column.
    """
    is_bytes = images.dtype == torch.uint8
    x = images.float() / 255 if is_bytes else images.to(compute_dtype(images))
    if windows is not None:
        layer = _cut(layer, windows, images.shape[-2:])
    a, b, c, d = factors[..., None, None].unbind(2)
    y = clamp(clamp(x, 0, 1) * (a + b * layer) + (c * layer + d), 0, 1)
    return match_layout((255 * y).round().to(torch.uint8) if is_bytes else y.to(images.dtype), images)


def _cut(layers: Tensor, windows: Tensor, size: Sequence[int]) -> Tensor:
    """The windows of layers of a size."""
    (height, width), (count, _, tall, wide) = size, layers.shape
    index, top, left = windows[:, :, None, None].unbind(1)
    rows = top.clamp(0, tall - height) + torch.arange(height, device=layers.device)[:, None]
    columns = left.clamp(0, wide - width) + torch.arange(width, device=layers.device)
    return layers[index.clamp(0, count - 1), :, rows, columns].movedim(-1, 1)


add_layer = register("add_layer", _reference, bytes=True, casts_outputs=True)


def _by_image(
    images: Sequence[Tensor], layer: Tensor, windows: Tensor | None, factors: Tensor
) -> tuple[Layers, Tensor | None, Tensor]:
    """The arguments of a list with the layers of each image, (1, 1, H, W), in place of packed ones (N,)."""
    if layer.dim() > 1:
        return layer, windows, factors
    return [own[None] for own in unpacked(layer, sizes(images), 1)], windows, factors


def arguments_of_sample(b: int, layer: Layers, windows: Tensor | None, factors: Tensor) -> tuple[Tensor | None, ...]:
    """The arguments of an image of a list: without windows the upper left part of its layer."""
    own = row(factors, b)
    if not isinstance(layer, Tensor):
        return layer[b], None, own
    if windows is None:
        return row(layer, b), torch.zeros(1, 3, dtype=torch.int64, device=layer.device), own
    return layer, windows[b : b + 1], own


def _gradients_reference(images_and_grads: Sequence[Tensor], chosen: Tensor | None, *args: Any) -> list[Tensor]:
    images, grads = halves(images_and_grads)
    each, of_each = [], _by_image(images, *args)
    for b, (x, g) in enumerate(zip(images, grads)):
        of_image: Any = add_layer.differentiate_reference(
            (True, False, False, False), g[None], x[None], *arguments_of_sample(b, *of_each)
        )[0]
        each.append(of_image[0] if chosen is None else torch.where(row(chosen, b) != 0, of_image[0], g))
    return each


_add_layer_list_backward = register_list_backward("add_layer_list_backward", add_layer, _gradients_reference)
register_filter(
    "add_layer_list",
    add_layer,
    arguments_of_sample,
    of_images=lambda grads, images, *args: _add_layer_list_backward([*images, *grads], *args),
    by_image=_by_image,
    differentiates_batches=True,
)


def clamp_gradients(images: Sequence[Tensor], grads: Sequence[Tensor], chosen: Tensor | None) -> Sequence[Tensor]:
    """The gradients of images (C, H, W), for those of what clamps them to [0, 1] where they are `chosen`: a layer of factor 0."""
    as_they_are = constant((((1.0, 0.0, 0.0, 0.0),),), images[0], compute_dtype(images[0]))
    layer = as_they_are[..., 1:2, None].expand(1, 1, *largest_shape(images)[-2:])
    return _add_layer_list_backward([*images, *grads], chosen, layer, None, as_they_are)


def layered(layer: Tensor, *factors: Tensor | float, windows: Tensor | None = None) -> Operation:
    """Images behind a layer, by the factors a, b, c and d: numbers, or (B or 1, C or 1), of the type that is computed in.

    Layers of a list may be packed (N,), as `remap_list.packed` does, each of the size of its image.
    """
    if not any(isinstance(f, Tensor) for f in factors):
        return Operation(add_layer, (layer, windows, constant(((factors,),), layer)))
    each = [f.to(layer) if isinstance(f, Tensor) else constant(((f,),), layer) for f in factors]
    return Operation(add_layer, (layer, windows, torch.stack(torch.broadcast_tensors(*each), -1)))
