"""Maps of lists of images by displacements of each: the operator `remap` for one image after the other, in one launch.

The maps (2, H, W) of a list are one tensor, each at a multiple of 16 numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._list_ops import ListOperator
from kvision.geometry.transform import sampling
from kvision.geometry.transform.lists import arguments as lists

_UNIT = 16

# Arguments: images (C, H, W); maps in pixels, of each or of each of its channels; fills, as those of `remap`; interpolation,
# padding and align_corners; whether the maps are those of channels.


def packed(maps: Sequence[Tensor]) -> Tensor:
    """Maps (C, H, W) as one tensor."""
    beyond = maps[0].new_zeros(_UNIT)
    return torch.cat([part for own in maps for part in (own.flatten(), beyond[: -own.numel() % _UNIT])])


def packed_size(sides: Sequence[int], channels: int = 2) -> int:
    """How many numbers the maps for height and width of each take."""
    return sum(_counts(sides, channels))


def unpacked(maps: Tensor, sides: Sequence[int], channels: int = 2) -> list[Tensor]:
    """The maps (C, H, W) for height and width of each."""
    each = zip(maps.split(_counts(sides, channels)), sides[::2], sides[1::2])
    return [own[: channels * h * w].view(channels, h, w) for own, h, w in each]


def repeated(maps: Tensor, sides: Sequence[int], samples: Sequence[int]) -> Tensor:
    """The maps of samples, some of them several times, of the maps for height and width of each."""
    each = maps.split(_counts(sides, 2))
    return torch.cat([each[i] for i in samples])


def _counts(sides: Sequence[int], channels: int) -> list[int]:
    return [channels * h * w + -channels * h * w % _UNIT for h, w in zip(sides[::2], sides[1::2])]


def _samples(images: Sequence[Tensor], maps: Tensor, fill: Tensor | None, by_channel: bool) -> list[tuple[Any, ...]]:
    """Images, maps of x and of y, and fills of each, as `remap` takes them."""
    each = images[0].shape[0] if by_channel else 1
    own_maps = unpacked(maps, [n for x in images for _ in range(each) for n in x.shape[-2:]])
    own = []
    for b, x in enumerate(images):
        map_x, map_y = torch.stack(own_maps[each * b : each * (b + 1)]).unbind(1)
        f = lists.row(fill, b)
        if by_channel:
            x, f = x[:, None], None if f is None else f.expand(1, each).mT
        else:
            x = x[None]
        own.append((x, map_x, map_y, f))
    return own


def _reference(images, maps, fill, interpolation, padding, align_corners, by_channel):
    options = (None, interpolation, padding, align_corners, False, True)
    results = [sampling.remap.reference(*own, *options) for own in _samples(images, maps, fill, by_channel)]
    return [y.flatten(0, 1) if by_channel else y[0] for y in results]


def _fake(images, maps, fill, interpolation, padding, align_corners, by_channel):
    like = [x.contiguous() for x in images] if by_channel else images
    return lists.fake_results(like, [n for x in images for n in x.shape[-2:]])


def _backward(needs, grads, images, maps, fill, *options):
    of_images = remap_list_backward(grads, maps, *options) if needs[0] else None
    if not (needs[1] or needs[2]):
        return of_images, None, None
    *rest, by_channel = options
    of_maps, of_fill = [], []
    for g, (x, map_x, map_y, f) in zip(grads, _samples(images, maps, fill, by_channel)):
        needed = (False, needs[1], needs[1], needs[2])
        grad = g[:, None] if by_channel else g[None]
        _, along_x, along_y, own = sampling.remap.backward(needed, grad, x, map_x, map_y, f, None, *rest, False, True)[
            :4
        ]
        of_maps += [] if along_x is None else list(torch.stack([along_x, along_y], 1))
        of_fill.append(own if own is None or not by_channel else own.mT)
    return (
        of_images,
        packed(of_maps) if needs[1] else None,
        torch.cat(of_fill).sum_to_size(fill.shape) if needs[2] else None,
    )


def _image_backward_reference(grads, maps, interpolation, padding, align_corners, by_channel):
    options, results = (interpolation, padding, align_corners, False, True), []
    for g, map_x, map_y, _ in _samples(grads, maps, None, by_channel):
        size = [g.shape[0], *g.shape[2:]]
        y = sampling._remap_image_backward.reference(g, map_x, map_y, None, size, *options)
        results.append(y.flatten(0, 1) if by_channel else y[0])
    return results


def _image_backward_backward(needs, grad_grads, grads, maps, *options):
    of_grads = remap_list(grad_grads, maps, None, *options) if needs[0] else None
    if not needs[1]:
        return of_grads, None

    def result(maps: Tensor) -> tuple[Tensor, ...]:
        return tuple(_image_backward_reference(grads, maps, *options))

    _, vjp_fn = torch.func.vjp(result, maps)
    return of_grads, vjp_fn(tuple(grad_grads))[0]


remap_list = ListOperator(
    "remap_list",
    sampling.remap,
    _reference,
    fake=_fake,
    backward=_backward,
)
remap_list_backward = ListOperator(
    "remap_list_backward",
    sampling._remap_image_backward,
    _image_backward_reference,
    fake=lambda grads, *args: [torch.empty_like(g, memory_format=torch.contiguous_format) for g in grads],
    backward=_image_backward_backward,
    nondeterministic=lambda grads, *args: grads[0].is_cuda,
)
