"""Maps of lists of images: the operator `remap` for one image after the other, in one launch.

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

# Arguments: images (C, H, W); maps in pixels, of each or of each of its channels; fills, as those of `remap`; height and width of
# each result for coordinates, none for displacements in results of the sizes of images; interpolation, padding and align_corners;
# whether the maps are those of channels. Those of the backward operator have height and width of each image.


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


def _samples(
    images: Sequence[Tensor], maps: Tensor, fill: Tensor | None, sides: Sequence[int], by_channel: bool
) -> list[tuple[Any, ...]]:
    """Images, maps of x and of y, for height and width of each, and fills, as `remap` takes them."""
    each = images[0].shape[0] if by_channel else 1
    own_maps = unpacked(maps, [n for b in range(len(images)) for _ in range(each) for n in sides[2 * b : 2 * b + 2]])
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


def _reference(images, maps, fill, sizes, interpolation, padding, align_corners, by_channel):
    options = (None, interpolation, padding, align_corners, False, not sizes)
    samples = _samples(images, maps, fill, sizes or lists.sizes(images), by_channel)
    results = [sampling.remap.reference(*own, *options) for own in samples]
    return [y.flatten(0, 1) if by_channel else y[0] for y in results]


def _fake(images, maps, fill, sizes, interpolation, padding, align_corners, by_channel):
    like = [x.contiguous() for x in images] if by_channel else images
    return lists.fake_results(like, sizes or lists.sizes(images))


def _backward(needs, grads, images, maps, fill, sizes, *options):
    of_images = None
    if needs[0]:
        of_images = remap_list_backward(grads, maps, lists.sizes(images) if sizes else [], *options)
    if not (needs[1] or needs[2]):
        return of_images, None, None
    *rest, by_channel = options
    of_maps, of_fill = [], []
    for g, (x, map_x, map_y, f) in zip(grads, _samples(images, maps, fill, lists.sizes(grads), by_channel)):
        needed = (False, needs[1], needs[1], needs[2])
        grad = g[:, None] if by_channel else g[None]
        _, along_x, along_y, own = sampling.remap.backward(
            needed, grad, x, map_x, map_y, f, None, *rest, False, not sizes
        )[:4]
        of_maps += [] if along_x is None else list(torch.stack([along_x, along_y], 1))
        of_fill.append(own if own is None or not by_channel else own.mT)
    return (
        of_images,
        packed(of_maps) if needs[1] else None,
        torch.cat(of_fill).sum_to_size(fill.shape) if needs[2] else None,
    )


def _image_backward_reference(grads, maps, sizes, interpolation, padding, align_corners, by_channel):
    options, results = (interpolation, padding, align_corners, False, not sizes), []
    sides = lists.sizes(grads)
    for b, (g, map_x, map_y, _) in enumerate(_samples(grads, maps, None, sides, by_channel)):
        size = [g.shape[0], *(sizes or sides)[2 * b : 2 * b + 2]]
        y = sampling._remap_image_backward.reference(g, map_x, map_y, None, size, *options)
        results.append(y.flatten(0, 1) if by_channel else y[0])
    return results


def _image_backward_fake(grads, maps, sizes, *options):
    like = [g.contiguous() for g in grads]
    return lists.fake_results(like, sizes or lists.sizes(grads))


def _image_backward_backward(needs, grad_grads, grads, maps, sizes, *options):
    of_grads = None
    if needs[0]:
        of_grads = remap_list(grad_grads, maps, None, lists.sizes(grads) if sizes else [], *options)
    if not needs[1]:
        return of_grads, None

    def result(maps: Tensor) -> tuple[Tensor, ...]:
        return tuple(_image_backward_reference(grads, maps, sizes, *options))

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
    fake=_image_backward_fake,
    backward=_image_backward_backward,
    nondeterministic=lambda grads, *args: grads[0].is_cuda,
)
