"""Displacements of elastic transforms: noise after a Gaussian blur, by one kernel that also draws the noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision import _check
from kvision._modes import BORDER
from kvision._ops import register
from kvision.augmentation.keys import flatten_draws
from kvision.augmentation.lists.pixels import PixelRow, given_maps
from kvision.augmentation.lists.sides import rows_on_device
from kvision.augmentation.maps import vector
from kvision.augmentation.noise import NO_KEY, PixelNoise, uniform_noise
from kvision.filters.filter2d import _filter2d as filter2d
from kvision.filters.kernels import sigmas
from kvision.filters.smoothing import gaussian
from kvision.geometry.transform.lists.arguments import like_batch, row
from kvision.geometry.transform.lists.kept_sizes import Operation
from kvision.geometry.transform.lists.remap_list import packed, packed_size, unpacked

# Arguments of the operator: noise (B, 2, H, W) in [-1, 1]; keys, seeds and plan of noise.py, or None, None and an empty list;
# height and width of the window of the blur; its standard deviations along y and x; the scales of x and y. With keys the noise is
# drawn, and only the size and the type of `noise` are read.


def _reference(
    noise: Tensor, keys: Tensor | None, seeds: Tensor | None, plan: Sequence[int], *blur_and_scale: Any
) -> Tensor:
    *blur, scale_x, scale_y = blur_and_scale
    if keys is not None:
        zeros = noise.new_zeros(noise.shape, dtype=torch.float32)
        standard = torch.stack([zeros.new_zeros(1), zeros.new_ones(1)], 1)
        noise = uniform_noise.definition(zeros, standard, keys, seeds, None, plan).to(noise.dtype)
    smooth: Tensor = gaussian._gaussian_blur2d.definition(noise, None, *blur, BORDER["constant"])
    return smooth * vector(noise, scale_x, scale_y)[:, None, None]


def _backward(needs: Sequence[bool], grad: Tensor, noise: Tensor, keys: Any, seeds: Any, plan: Any, *rest: Any) -> Any:
    if keys is not None:
        return [None, None, None]
    *blur, scale_x, scale_y = rest
    scaled = grad * vector(grad, scale_x, scale_y)[:, None, None]
    return [gaussian._transposed(scaled, None, *blur, BORDER["constant"]), None, None]


_elastic_displacements = register(
    "elastic_displacements", _reference, backward=_backward, flatten=flatten_draws(keys=1)
)


# Arguments of the operator on lists: the type and the device (B, 0); packed noise, or None if it is drawn; keys; seeds; (B,)
# float32 that is 0 for maps of 0, or None; the plan; the window and its deviations; alpha of x and y; whether half the sides are
# those between the centers of pixels; the side of the images that the window is for, or 0 for all images; height and width of
# each image.


def _list_reference(
    like: Tensor,
    noise: Tensor | None,
    keys: Tensor,
    seeds: Tensor | None,
    chosen: Tensor | None,
    plan: Sequence[int],
    *rest: Any,
) -> Tensor:
    ky, kx, sigma_y, sigma_x, *alpha, align_corners, unit, sides = rest
    given, each = None if noise is None else unpacked(noise, sides), []
    for b, (h, w) in enumerate(zip(sides[::2], sides[1::2])):
        blur, scale = blur_and_scale((ky, kx, sigma_y, sigma_x), alpha, align_corners, unit, h, w)
        if given is None:
            source = keys, row(seeds, b), [*plan[:4], 0, [*plan, 0, 0][5] + b]
            own = _reference(like.new_empty(1, 2, h, w), *source, *blur, *scale)[0]
        else:
            own = _reference(given[b][None], None, None, [], *blur, *scale)[0]
        each.append(own if chosen is None else torch.where(chosen[b if len(chosen) > 1 else 0] != 0, own, 0.0))
    return packed(each)


_elastic_displacements_list = register(
    "elastic_displacements_list",
    _list_reference,
    fake=lambda like, *args: (packed_size(args[-1]),),
    flatten=lambda *_: None,  # of a list there is no vmap
)


def blur_settings(kernel_size: Any, sigma: Any) -> tuple[int, int, Any, Any]:
    """Height and width of the window, then the standard deviations along y and x, or a tensor of them and None."""
    op = "RandomElasticTransform"
    ky, kx = _check.pair(op, "kernel_size", kernel_size)
    _check.odd(op, "kernel_size", (ky, kx))
    checked = sigmas(op, "sigma", sigma, 2)
    if isinstance(checked, Tensor):
        return ky, kx, checked, None
    sigma_y, sigma_x = checked
    return ky, kx, sigma_y, sigma_x


def scaled_blur(blur: tuple[int, int, Any, Any], scale_y: float, scale_x: float) -> tuple[int, int, Any, Any]:
    """Blur settings for an image that is so many times as high and as wide."""
    ky, kx, sigma_y, sigma_x = blur
    ky, kx = (2 * max(round(k // 2 * scale), 1 if k > 1 else 0) + 1 for k, scale in ((ky, scale_y), (kx, scale_x)))
    if sigma_x is None:
        return ky, kx, sigma_y * vector(sigma_y, scale_y, scale_x), None
    return ky, kx, sigma_y * scale_y, sigma_x * scale_x


def blur_and_scale(
    blur: tuple[int, int, Any, Any], alpha: Sequence[float], align_corners: bool, unit: int, height: int, width: int
) -> tuple[tuple[int, int, Any, Any], tuple[float, float]]:
    """Blur settings for an image, which are those of images of `unit` pixels along each side or, with 0, of all, and the scales."""
    scale_x, scale_y = (a * (n - (1 if align_corners else 0)) / 2 for a, n in zip(alpha, (width, height)))
    if unit:
        down, across = height / unit, width / unit
        blur = scaled_blur(blur, down, across)
        more = math.sqrt(down * across)  # the mean of more noise is that much smaller
        scale_x, scale_y = scale_x * more, scale_y * more
    return blur, (scale_x, scale_y)


class NoiseField(NamedTuple):
    """Displacements that follow from the keys of a call: what a kernel needs to draw and to blur their noise."""

    size: tuple[int, int]
    noise: tuple[int, int, int, int]  # noise_plan
    blur: tuple[int, int, float, float]
    scale: tuple[float, float]  # of x and y


def elastic_displacements(
    noise: Tensor, source: PixelNoise | None, blur: tuple[int, int, Any, Any], scale: tuple[float, float]
) -> Tensor:
    """Displacements (B, 2, H, W) of `noise`. With `source` the noise is drawn, in the size and type of `noise`."""
    if blur[3] is None:  # a tensor of standard deviations, which may need a gradient
        if source is not None:
            noise = source.symmetric(noise.shape).to(noise)
        smooth = gaussian.gaussian_blur2d(noise, blur[:2], blur[2], "constant")
        return smooth * vector(noise, *scale)[:, None, None]
    if source is None:
        y: Tensor = _elastic_displacements(noise, None, None, [], *blur, *scale)
        return y
    keys, seeds, _, plan = source.arguments()
    y = _elastic_displacements(noise, keys, seeds, list(plan), *blur, *scale)
    return y


def elastic_displacements_of_list(
    source: PixelNoise | Sequence[Tensor],
    blur: tuple[int, int, Any, Any],
    alpha: tuple[float, float],
    align_corners: bool,
    unit: int,
    sides: Sequence[int],
    like: Tensor,
    chosen: Tensor | None,
) -> Tensor:
    """The maps of a list of noise, for height and width of each image, in the type of `like` (B, 0); 0 where not `chosen`.

    The noise is drawn, or given, (2, H, W) of each image, 0 where these are not chosen. `unit` is that of blur_and_scale.
    """
    if blur[3] is None:
        return _blurred_by_tensor(source, blur, alpha, align_corners, unit, sides, like, chosen)
    settings = (*blur, *alpha, align_corners, unit, list(sides))
    if isinstance(source, PixelNoise):
        keys, seeds, _, plan = source.arguments()
        y: Tensor = _elastic_displacements_list(like, None, keys, seeds, chosen, list(plan), *settings)
    else:
        y = _elastic_displacements_list(like, packed(source), NO_KEY, None, None, [], *settings)
    return y


def _blurred_by_tensor(
    source: PixelNoise | Sequence[Tensor],
    blur: tuple[int, int, Any, Any],
    alpha: tuple[float, float],
    align_corners: bool,
    unit: int,
    sides: Sequence[int],
    like: Tensor,
    chosen: Tensor | None,
) -> Tensor:
    """The same of standard deviations in a tensor, which may need a gradient."""
    sizes = list(zip(sides[::2], sides[1::2]))
    if isinstance(source, PixelNoise):
        source = source.symmetric_list([(2, *size) for size in sizes], [1.0] * len(sizes))
    noise = given_maps(source, like.device, like.dtype, chosen)
    each = [blur_and_scale((*blur[:2], 0.0, 0.0), alpha, align_corners, unit, *size) for size in sizes]
    if unit:
        smooth = _blurred_by_sides(noise, [own[:2] for own, _ in each], blur[2], unit, sizes)
    else:
        arguments = gaussian.blur_arguments("RandomElasticTransform", like_batch(noise), blur[:2], blur[2], "constant")
        smooth = Operation(gaussian._gaussian_blur2d, arguments[1:]).on_list(noise)
    rows = torch.tensor([scales for _, scales in each], dtype=torch.float64, device="cpu")
    row = PixelRow(smooth)
    return packed(row.split(row.of(smooth) * row.of_channels(rows_on_device(rows, like, like.dtype))))


def _blurred_by_sides(
    noise: list[Tensor], windows: Sequence[Sequence[int]], sigma: Tensor, unit: int, sizes: Sequence[tuple[int, int]]
) -> list[Tensor]:
    """Noise of a list, blurred by windows of each image and deviations for images of `unit` pixels, along x and then y.

    The kernels of all images are as long as the longest one, with zeros around their windows.
    """
    like = like_batch(noise)
    scales = rows_on_device(torch.tensor(sizes, dtype=torch.float64, device="cpu") / unit, like, like.dtype)
    for axis in (1, 0):
        own = [window[axis] for window in windows]
        half = rows_on_device(torch.tensor(own, device="cpu")[:, None] // 2, like, torch.int64)
        kernels = gaussian.windowed(max(own), half, sigma.to(like)[:, axis, None] * scales[:, axis, None])
        arguments = kernels.unsqueeze(2 - axis), BORDER["constant"], True
        noise = Operation(filter2d, arguments).on_list(noise)
    return noise
