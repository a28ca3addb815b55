"""Pixels that read random neighbors, as behind frosted glass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Border
from kvision._dtype import compute_dtype
from kvision._list_ops import ListOperator
from kvision._ops import Operator, match_layout, register
from kvision.augmentation.keys import flatten_draws
from kvision.augmentation.lists import filter_lists
from kvision.augmentation.lists.pixels import unpacked_maps
from kvision.augmentation.noise import NO_KEY, PixelNoise, words_of_pixels
from kvision.augmentation.random_generator.base import Shape
from kvision.filters.smoothing.gaussian import blur_arguments
from kvision.geometry.transform.lists.arguments import row
from kvision.geometry.transform.lists.kept_sizes import Operation, Operations, register_filter

MAX_DELTA = 2**15  # of kernels


def _reference(
    images: Tensor,
    keys: Tensor,
    seeds: Tensor | None,
    uniform: Tensor | None,
    plan: Sequence[int],
    max_delta: int,
    steps: int,
) -> Tensor:
    """Images whose pixels each read another one: it moves `steps` times, down and to the right, and stays in the image.

    A move is from -max_delta to max_delta - 1, as in the benchmark of Hendrycks and Dietterich, by two numbers of each pixel and
    step: the upper and the lower half of a word, or those of `uniform` (B, 2 steps, H, W) float32.
    """
    height, width = images.shape[-2:]
    if uniform is None:
        uniform = _halves(words_of_pixels(images, steps, keys, seeds, plan))
    moves = ((uniform * (2 * max_delta)).long() - max_delta).flatten(2)
    at = torch.arange(height * width, device=images.device).expand(len(images), -1)
    for move in moves.split(2, 1):
        along_y, along_x = move.gather(2, at[:, None].expand(-1, 2, -1)).unbind(1)
        row, column = (at // width + along_y).clamp(0, height - 1), (at % width + along_x).clamp(0, width - 1)
        at = row * width + column
    y = images.flatten(2).gather(2, at[:, None].expand(-1, images.shape[1], -1)).view(images.shape)
    return match_layout(y, images)


def _halves(words: Tensor) -> Tensor:
    """The upper and the lower halves of words (B, n, H, W), in [0, 1), float32 (B, 2 n, H, W)."""
    words = words ^ 2**31
    return torch.stack([words >> 16, words & 0xFFFF], 2).flatten(1, 2).float() / 2**16


def _backward(needs: Sequence[bool], grad: Tensor, images: Tensor, *args: Any) -> list[Tensor | None]:
    """Each pixel's gradient is added to that of the pixel which it reads: an image of positions tells where that is.

    On CUDA sums are in any order: sorted ones took 1.95 in place of 0.25 ms (128x3x224x224, H200).
    """
    batch, channels, height, width = images.shape
    positions = torch.arange(height * width, device=grad.device, dtype=torch.float64).view(1, 1, height, width)
    read: Tensor = read_neighbors(positions.expand(batch, -1, -1, -1), *args)
    at, own = read.long().flatten(2).expand(-1, channels, -1), grad.to(compute_dtype(grad)).flatten(2)
    total = torch.zeros_like(own).scatter_add(2, at, own).view(images.shape)
    return [total.to(grad.dtype), None, None, None]


def _supports(*args: Any) -> str | None:
    """Pixels move by at most 32768, and images have at most 2^30 of them."""
    images, max_delta = args[0], args[5]
    if max_delta > MAX_DELTA or images.shape[2] * images.shape[3] > 2**30:
        return f"there is no kernel for moves of {max_delta} pixels in images of {tuple(images.shape)}"
    return None


read_neighbors: Operator = register(
    "read_neighbors", _reference, backward=_backward, bytes=True, supports=_supports, flatten=flatten_draws(keys=1)
)


def _with_maps(
    images: Sequence[Tensor], keys: Tensor, seeds: Any, uniform: Any, plan: Any, *moves: int
) -> tuple[Any, ...]:
    """The arguments of a list with the numbers of each image in place of packed ones."""
    _, steps = moves
    return keys, seeds, unpacked_maps(uniform, images, 2 * steps), plan, *moves


def _of_sample(
    b: int, keys: Tensor, seeds: Tensor | None, uniform: Sequence[Tensor | None], plan: Sequence[int], *moves: int
) -> tuple[Any, ...]:
    form, first = [*plan, 0, 0][4:6]
    return keys, row(seeds, b), uniform[b], [*plan[:4], form, first + b], *moves


def _sums_reference(grads: Sequence[Tensor], chosen: Tensor | None, *args: Any) -> list[Tensor]:
    args = _with_maps(grads, *args)
    each: Any = [_backward((), g[None], g[None], *_of_sample(b, *args))[0] for b, g in enumerate(grads)]
    if chosen is None:
        return [y[0] for y in each]
    return [torch.where(row(chosen, b) != 0, y[0], g) for b, (y, g) in enumerate(zip(each, grads))]


def _read_gradients(needs: Sequence[bool], grad_grads: Any, grads: Any, *args: Any) -> list[Any]:
    return [_read_neighbors_list(grad_grads, *args), *(None,) * (len(needs) - 1)]


_sums_list = ListOperator(
    "read_neighbors_list_backward",
    read_neighbors,
    _sums_reference,
    fake=lambda grads, *args: [torch.empty_like(g, memory_format=torch.contiguous_format) for g in grads],
    backward=_read_gradients,
    nondeterministic=lambda grads, *args: grads[0].is_cuda,
)
_read_neighbors_list = register_filter(
    "read_neighbors_list",
    read_neighbors,
    _of_sample,
    _backward,
    of_images=lambda grads, images, *args: _sums_list(grads, *args),
    by_image=_with_maps,
)


class Moves(NamedTuple):
    """A map like :class:`NoiseMap` of the numbers that move pixels, so many times."""

    steps: int

    @property
    def moves_pixels(self) -> bool:
        """All channels alike."""
        return True

    @property
    def is_exact(self) -> bool:
        """Words of 32 bits as two numbers of 16 bits."""
        return True

    def draw(self, noise: PixelNoise, shape: Shape, number: int) -> Tensor:
        """The map with a number of its own among those of an augmentation, float32."""
        u = noise.uniform((shape[0], self.steps, *shape[-2:]), number, torch.float64)
        return _halves((u * 2**32).long() ^ 2**31)


def glass(
    like: Tensor, noise: PixelNoise | Tensor, sigma: float, max_delta: int, steps: int, border: Border = "reflect"
) -> Operations:
    """Between two blurs, pixels read neighbors, by a source of noise or a uniform map, a packed one of a list.

    `like` is a batch of images, or as small as any of a list.
    """
    reach = reach_of(sigma)
    _check.reflectable("GlassBlur", like, (reach, reach), border, "lower sigma")
    size = (2 * reach + 1,) * 2
    blur = Operation(filter_lists.gaussian_blur2d, blur_arguments("GlassBlur", like, size, (sigma, sigma), border)[1:])
    chosen: Tensor | None = None
    read: tuple[Any, ...]
    if isinstance(noise, Tensor):
        read = (NO_KEY, None, noise.to(like.device, torch.float32), (0, 0, 1, 0))
    else:
        keys, seeds, chosen, plan = noise.arguments()
        read = (keys, seeds, None, plan)
    return Operations((blur, Operation(read_neighbors, (*read, max_delta, steps)), blur), chosen)


def reach_of(sigma: float) -> int:
    """Taps of a Gaussian to each side, up to four standard deviations."""
    return int(4 * sigma + 0.5)
