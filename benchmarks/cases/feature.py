"""Local features. An image of a case's size, in gray, has 2000 frames; patches are 2000 of 32 x 32, whatever the size."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import torch
from torch import Tensor

import kvision
from benchmarks.case import Bars, Case, Size, nbytes, nonlinear_backward, photographs
from benchmarks.peers import optional

kornia = optional("kornia")

COUNT, SIDE = 2000, 32


def frames(size: Size, device: torch.device) -> Tensor:
    """Frames of 6 to 48 pixels, most of them small, in any orientation."""
    b, _, h, w = size
    random = torch.Generator().manual_seed(0)
    center = torch.rand(b, COUNT, 2, generator=random) * torch.tensor([w, h])
    scale = 6 * 8 ** torch.rand(b, COUNT, 1, 1, generator=random).square()
    angle = 360 * torch.rand(b, COUNT, 1, generator=random)
    return kvision.feature.laf_from_center_scale_ori(center, scale, angle).to(device)


def images_and_frames(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    gray = (size[0], 1, *size[2:])
    return *photographs(gray, dtype, device), frames(gray, device)


def patches(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    """Patches of one image."""
    image, laf = images_and_frames((1, 1, 480, 640), torch.float32, device)
    return (kvision.feature.extract_patches_from_pyramid(image, laf, SIDE)[0].to(dtype),)


@lru_cache
def module(library: Any, name: str, device: torch.device, dtype: torch.dtype) -> torch.nn.Module:
    made: torch.nn.Module = getattr(library.feature, name)(SIDE).to(device, dtype)
    return made


def without_negative_b(shape: Any) -> Any:
    """Ellipses (B, 1, 3), those with b below 0 as circles, which Kornia makes of them (docs/differences.md)."""
    circle = shape.new_tensor([1.0, 0.0, 1.0])
    return torch.where(shape[..., 1:2] < 0, circle, shape)


def of_patches(name: str, title: str, bars: Bars, **more: Any) -> Case:
    def call(library: Any, x: Tensor) -> Tensor:
        result: Tensor = module(library, name, x.device, x.dtype)(x)
        return result

    return case(title, call, patches, bars, backward=nonlinear_backward, border=0, **more)


def case(name: str, call: Callable[..., Any], inputs: Callable[..., Any], bars: Bars, **more: Any) -> Case:
    return Case(name, partial(call, kvision), {"kornia": partial(call, kornia)}, bars, inputs, **more)


def of_frames(inputs: Any, outputs: Any) -> int:
    """Bytes of the backward of patches: their gradient is read and that of the image is written."""
    return nbytes(outputs) + nbytes(inputs[:1])


def descriptors(count: int) -> Callable[..., tuple[Tensor, ...]]:
    """Two sets of unit vectors of 128, of which three in four have a counterpart, whatever the size."""

    def inputs(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
        random = torch.Generator().manual_seed(0)
        first, noise, other = (
            torch.nn.functional.normalize(torch.randn(count, 128, generator=random), dim=1) for _ in range(3)
        )
        second = torch.where(torch.arange(count)[:, None] % 4 > 0, first + 0.5 * noise, other)
        return first.to(device, dtype), second[torch.randperm(count, generator=random)].to(device, dtype)

    return inputs


def of_pairs(name: str, count: int, call: Callable[..., Any], bars: Bars) -> Case:
    return case(name, call, descriptors(count), bars, backward=nonlinear_backward, result=lambda y: y[0], border=0)


def of_image(name: str, bars: Bars, **more: Any) -> Case:
    return case(name, lambda K, x: getattr(K.feature, name)(x), photographs, bars, border=0, **more)


CASES = [
    of_image("harris_response", Bars(floor=2.5, both=4), backward=nonlinear_backward),
    of_image("gftt_response", Bars(floor=2.5, both=4), backward=nonlinear_backward),
    of_image("hessian_response", Bars(floor=1.5, both=2), backward=nonlinear_backward),
    of_image("dog_response_single", Bars(floor=1.5, both=2)),
    case(
        "extract_patches",
        lambda K, x, laf: K.feature.extract_patches_from_pyramid(x, laf, SIDE),
        images_and_frames,
        Bars(launches=None),
        backward=of_frames,
    ),
    # 0.06 ms on an H200, and 0.2 with the backward; 0.04; 0.08.
    of_patches("SIFTDescriptor", "sift_descriptor", Bars(floor=28, both=32)),
    of_patches("PatchDominantGradientOrientation", "dominant_orientation", Bars(floor=20)),
    of_patches("PatchAffineShapeEstimator", "affine_shape", Bars(floor=40), result=without_negative_b),
    # The list of matches in 0.08 ms on an H200, and that of 10,000 in 0.6.
    of_pairs("match_smnn", 2000, lambda K, x, y: K.feature.match_smnn(x, y), Bars(floor=165, launches=None)),
    of_pairs("match_smnn10000", 10_000, lambda K, x, y: K.feature.match_smnn(x, y), Bars(floor=245, launches=None)),
    of_pairs("match_nn", 2000, lambda K, x, y: K.feature.match_nn(x, y), Bars(launches=None)),
]
