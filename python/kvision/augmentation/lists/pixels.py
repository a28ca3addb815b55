"""Numbers of the pixels of a list of images: all as one row, for operations of torch, and maps that are given for each image.

So many operations do for any number of images.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._constants import on_device

Maps = Tensor | Sequence[Tensor]  # as parameters have them: (B, P, H, W), or an entry (1, P, H, W) of each image


class PixelRow:
    """The pixels of images (C, H, W) of different sizes as one row (N,)."""

    def __init__(self, images: Sequence[Tensor]) -> None:
        self.images, self._shapes = images, [x.shape for x in images]

    def of(self, each: Sequence[Tensor]) -> Tensor:
        """The row of tensors that have the sizes of the images."""
        return torch.cat([x.reshape(-1) for x in each])

    def of_images(self, numbers: Tensor) -> Tensor:
        """The row of numbers (B,) or (1,) of images."""
        return self._repeated(numbers.expand(len(self._shapes)), [math.prod(shape) for shape in self._shapes])

    def by_channel(self) -> Tensor:
        """The pixels as a batch of one image (1, C, 1, N), each with its channels."""
        return torch.cat([x.flatten(1) for x in self.images], 1)[None, :, None]

    def split_channels(self, pixels: Tensor) -> list[Tensor]:
        """The images of such a batch."""
        each = pixels[0, :, 0].split([h * w for _, h, w in self._shapes], 1)
        return self.split(torch.cat([pixels.new_empty(0), *(plane for own in each for plane in own)]))

    def of_pixels(self, numbers: Tensor) -> Tensor:
        """The numbers (B,) or (1,) of images at each pixel of such a batch."""
        repeated = self._repeated(numbers.expand(len(self._shapes)), [h * w for _, h, w in self._shapes])
        return repeated[None, None, None]

    def of_channels(self, numbers: Tensor) -> Tensor:
        """The row of numbers (B or 1, C or 1) of channels."""
        channels = self._shapes[0][0]
        counts = [h * w for _, h, w in self._shapes for _ in range(channels)]
        return self._repeated(numbers.expand(len(self._shapes), channels).reshape(-1), counts)

    def of_maps(self, maps: Maps) -> Tensor:
        """The row of maps, whose plane, if there is one, is that of all channels, on the device of the images."""
        return _joined(maps, self._shapes).to(self.images[0].device)

    def split(self, row: Tensor) -> list[Tensor]:
        """The images of a row."""
        each = row.split([math.prod(shape) for shape in self._shapes])
        return [own.view(shape) for own, shape in zip(each, self._shapes)]

    def _repeated(self, numbers: Tensor, counts: list[int]) -> Tensor:
        repeats = on_device(torch.tensor(counts, device="cpu"), numbers.device)
        return torch.repeat_interleave(numbers, repeats, output_size=sum(counts))


def _joined(maps: Maps, shapes: Sequence[Sequence[int]]) -> Tensor:
    """Maps of shapes (P, H, W) as one row."""
    planes: list[Tensor] = []
    for own, shape in zip(maps, shapes):
        own = own[0] if own.dim() == 4 else own
        if own.shape[0] == 1:  # no copy of it
            planes += [own.expand(1, *shape[1:]).reshape(-1)] * shape[0]
        else:
            planes.append(own.expand(*shape).reshape(-1))
    return torch.cat(planes)


def packed_maps(maps: Maps, images: Sequence[Tensor], planes: int | None = None) -> Tensor:
    """Maps with so many planes, default: those of the images, as one row (N,) of float32 on the device of the images."""
    shapes = [(planes or x.shape[0], *x.shape[1:]) for x in images]
    return _joined(maps, shapes).to(images[0].device, torch.float32)


def unpacked_maps(packed: Tensor | None, images: Sequence[Tensor], planes: int) -> list[Any]:
    """The maps (1, P, H, W) of each image in what `packed_maps` gives; None of each for None."""
    if packed is None:
        return [None] * len(images)
    shapes = [(1, planes, *x.shape[1:]) for x in images]
    return [own.view(shape) for own, shape in zip(packed.split([math.prod(shape) for shape in shapes]), shapes)]


def given_maps(maps: Maps, device: torch.device, dtype: torch.dtype, chosen: Tensor | None = None) -> list[Tensor]:
    """Maps (P, H, W) of each image, in a type and on a device, by one copy; 0 of those that are not `chosen`, (B,).

    Where all are the same for all channels they are (1, H, W).
    """
    each = [own[0] if own.dim() == 4 else own for own in maps]
    is_shared = all(own.stride(0) == 0 for own in each)
    row = PixelRow([own[:1] for own in each] if is_shared else each)
    values = row.of(row.images).to(device, dtype)
    return row.split(values if chosen is None else values * row.of_images(chosen.to(values)))
