"""Fractal noise by the diamond-square algorithm."""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype
from kvision._ops import register
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.enhance.min_max import normalize_min_max


def diamond_square(
    output_size: tuple[int, int, int, int],
    roughness: float | Tensor = 0.5,
    random_scale: float | Tensor = 1.0,
    random_fn: Callable[..., Tensor] | None = None,
    normalize_range: tuple[float, float] | None = None,
    device: torch.device | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """Make fractal noise, clouds of all sizes, by the diamond-square algorithm.

    The first grid has 3 pixels along its shorter side. Every step puts a pixel between any two: the mean of the four around
    it, or of three at the border, mixed with noise. The weight of the noise shrinks from step to step.

    Args:
        output_size: (B, C, H, W).
        roughness: factor of the weight of noise from one step to the next, a number or one for each sample (B,).
        random_scale: weight of noise before the first step, a number or one for each sample (B,).
        random_fn: makes noise of a size, with device= and dtype=; None for torch.rand.
        normalize_range: stretch the values of every plane to this range; None leaves them.
        device: of the result; None for the default one.
        dtype: of the result; None for the default one.

    Returns:
        (B, C, H, W).

    Raises:
        TypeCheckError: output_size not of ints; roughness or random_scale of the wrong type.
        ShapeError: roughness or random_scale neither a number nor one for each sample.
        ValueCheckError: output_size not of four numbers of at least 1.

    Source: A. Fournier et al., "Computer rendering of stochastic models" (1982).

    Example:
        >>> import torch, kvision as K
        >>> K.contrib.diamond_square((1, 1, 5, 5), random_fn=torch.ones).unique()
        tensor([1.])
    """
    op = "diamond_square"
    output_size = _check.scalars(op, "output_size", output_size)
    if not isinstance(output_size, (tuple, list, torch.Size)) or not all(map(_check.is_int, output_size)):
        raise TypeCheckError(f"{op}: expected output_size to be four ints, got {output_size!r}")
    if len(output_size) != 4 or min(output_size) < 1:
        raise ValueCheckError(f"{op}: expected output_size of four ints of at least 1, got {output_size!r}")
    b, c, h, w = output_size
    random_fn = torch.rand if random_fn is None else random_fn
    planes = b * c
    grow, weight = (
        _per_plane(op, name, value, b, c, device, dtype)
        for name, value in (("roughness", roughness), ("random_scale", random_scale))
    )
    steps = [_halvings(n) for n in (h, w)]
    doublings = min(steps) - 1
    rows, columns = (2 ** (n - doublings) + 1 for n in steps)
    noise = random_fn([planes, 1, 2, (max(rows, columns) + 1) // 2], device=device, dtype=dtype)
    image = _seed(noise, upright=columns == 3)
    for _ in range(doublings):
        weight = weight * grow
        size = [planes, 1, 2 * image.shape[2] - 1, 2 * image.shape[3] - 1]
        noise = random_fn(torch.Size(size), device=image.device, dtype=image.dtype)
        image = refine_fractal(image, noise.to(image.dtype), weight.to(compute_dtype(image)))
    image = image[..., :h, :w].reshape(b, c, h, w)
    if normalize_range is None:
        return image
    low, high = normalize_range
    return normalize_min_max(image, float(low), float(high))


def _halvings(n: int) -> int:
    """How often a side of at least n pixels, 2 ** k + 1, halves: at least once, to 3. A graph of other sizes knows the number."""
    k = 1
    while 2**k + 1 < n:
        k += 1
    return k


def _per_plane(
    op: str, name: str, value: float | Tensor, b: int, c: int, device: torch.device | None, dtype: torch.dtype | None
) -> Tensor:
    if not isinstance(value, Tensor):
        return torch.full((b * c, 1, 1, 1), _check.number(op, name, value), device=device, dtype=dtype)
    _check.numbers(op, name, value)
    if not _check.is_one_or(value.numel(), b):
        raise ShapeError(f"{op}: expected {name} with 1 or {b} numbers, got {tuple(value.shape)}")
    value = value.to(device=device, dtype=dtype or torch.get_default_dtype()).reshape(-1, 1)
    return value.expand(b, c).reshape(-1, 1, 1, 1)


def _seed(noise: Tensor, upright: bool) -> Tensor:
    """Noise (N, 1, 2, n) at every second pixel of a grid of 3 x (2 n - 1), or its transpose, and means in between."""
    planes, _, _, n = noise.shape
    x = noise.new_zeros(planes, 1, 3, 2 * n - 1)
    x[..., ::2, ::2] = noise
    x = _squares(_diamonds(x))
    return x.transpose(2, 3) if upright else x


def _diamonds(x: Tensor) -> Tensor:
    """The diamond step: the center of four pixels gets their mean."""
    y = x.clone()
    y[..., 1::2, 1::2] = (x[..., :-1:2, :-1:2] + x[..., :-1:2, 2::2] + x[..., 2::2, :-1:2] + x[..., 2::2, 2::2]) / 4
    return y


def _squares(x: Tensor) -> Tensor:
    """The square step: the other new pixels get the mean of their four adjacent pixels, of three at the border."""
    padded = F.pad(x, (1, 1, 1, 1))
    h, w = x.shape[-2:]
    total = padded[..., :h, 1:-1] + padded[..., 2:, 1:-1] + padded[..., 1:-1, :w] + padded[..., 1:-1, 2:]
    rows, columns = (torch.arange(n, device=x.device) for n in (h, w))
    border = ((rows == 0) | (rows == h - 1))[:, None] | (columns == 0) | (columns == w - 1)
    new = (rows % 2)[:, None] != columns % 2
    return torch.where(new, total / torch.where(border, 3, 4), x)


def _reference(images: Tensor, noise: Tensor, weights: Tensor) -> Tensor:
    """One step of (N, 1, H, W), with noise (N, 1, 2 H - 1, 2 W - 1), whose weight (N, 1, 1, 1) is that in the mean with it."""
    # At odd indices, whose values follow, there may be anything.
    x = images.repeat_interleave(2, 2).repeat_interleave(2, 3)[..., :-1, :-1]
    rows, columns = (torch.arange(n, device=x.device) % 2 for n in x.shape[-2:])
    x = torch.where((rows[:, None] * columns).bool(), torch.lerp(_diamonds(x), noise, weights), x)
    return torch.where(rows[:, None] != columns, torch.lerp(_squares(x), noise, weights), x)


refine_fractal = register(
    "refine_fractal",
    _reference,
    fake=lambda images, noise, weights: noise.shape,
)
