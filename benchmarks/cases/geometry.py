"""Warps, resizes, crops and pyramids. Bars are the module's targets; benchmarks/results shows which are met."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

import kvision
from benchmarks.case import Bars, Case, Size, nbytes, photographs
from benchmarks.peers import optional

cv2 = optional("cv2")
kornia = optional("kornia")

Inputs = Callable[[Size, torch.dtype, torch.device], tuple[Tensor, ...]]


def case(name: str, call: Callable[..., Any], bars: Bars, opencv: Callable[..., Any] | None, **more: Any) -> Case:
    """A case whose `call(geometry, input)` is the same for kvision and Kornia."""
    peers = {"kornia": partial(call, kornia.geometry if kornia else None)}
    if opencv:
        peers["opencv"] = opencv
    return Case(name, partial(call, kvision.geometry), peers, bars, **more)


def turns(images: Size, dtype: torch.dtype, device: torch.device) -> Tensor:
    """An affine map (2, 3) for each sample: a rotation by 5 to 30 degrees and a small scale, about the center."""
    batch, _, h, w = images
    angle = torch.linspace(5, 30, batch)
    center = torch.tensor([[(w - 1) / 2, (h - 1) / 2]]).expand(batch, 2)
    matrix = kvision.geometry.get_rotation_matrix2d(center, angle, torch.full((batch, 2), 1.05))
    return matrix.to(device, torch.float64 if dtype == torch.float64 else torch.float32)


def with_affine(images: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    return *photographs(images, dtype, device), turns(images, dtype, device)


def with_homography(images: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    matrix = turns(images, dtype, device)
    last = matrix.new_tensor([0.1 / images[3], 0.05 / images[2], 1]).expand(len(matrix), 1, 3)
    return *photographs(images, dtype, device), torch.cat([matrix, last], 1)


def with_map(images: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    m = turns(images, dtype, device)[..., None, None]
    x = torch.arange(images[3], device=device, dtype=m.dtype)
    y = torch.arange(images[2], device=device, dtype=m.dtype)[:, None]
    maps = (m[:, i, 0] * x + m[:, i, 1] * y + m[:, i, 2] for i in (0, 1))
    return *photographs(images, dtype, device), *maps


def with_shared_map(images: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    """One map for all images."""
    x, u, v = with_map(images, dtype, device)
    return x, u[:1].clone(), v[:1].clone()


def with_boxes(images: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    batch, _, h, w = images
    unit = torch.tensor([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    shift = torch.linspace(0, 0.25, batch)[:, None, None]
    boxes = (0.6 * unit + shift) * torch.tensor([w - 1, h - 1])
    return *photographs(images, dtype, device), boxes.to(device, dtype)


def with_many_boxes(images: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    """16 boxes of about 64 x 64 pixels anywhere in each image, and the image of each."""
    batch, _, h, w = images
    random = torch.Generator().manual_seed(0)
    first = torch.rand(16 * batch, 1, 2, generator=random) * torch.tensor([max(w - 65.0, 0), max(h - 65.0, 0)])
    boxes = first + 63.4 * torch.tensor([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    index = torch.arange(16 * batch, device=device) % batch
    compute = torch.float64 if dtype == torch.float64 else torch.float32
    return *photographs(images, dtype, device), boxes.to(device, compute), index


def size_of(x: Any) -> tuple[int, int]:
    """The height and width of a tensor (B, C, H, W) or an array (H, W, C)."""
    return tuple(x.shape[-2:]) if isinstance(x, Tensor) else tuple(x.shape[:2])


def warp_opencv(name: str, flags: str) -> Callable[..., Any]:
    return lambda x, m, out=None: getattr(cv2, name)(x, m, size_of(x)[::-1], out, getattr(cv2, flags))


def resized(name: str, factor: float, mode: str, opencv: str | None, bars: Bars, **options: Any) -> Case:
    def scaled(x: Any) -> tuple[int, int]:
        h, w = size_of(x)
        return int(h * factor), int(w * factor)

    peer = opencv and (lambda x, out=None: cv2.resize(x, scaled(x)[::-1], out, interpolation=getattr(cv2, opencv)))
    return case(name, lambda G, x: G.resize(x, scaled(x), mode, **options), bars, peer or None)


def warped_smaller(shrink: int, x: Tensor, m: Tensor) -> Tensor:
    """The warp of `warp_affine`, reduced, with antialiasing."""
    h, w = size_of(x)
    return kvision.geometry.warp_affine(x, m / shrink, (h // shrink, w // shrink), antialias=True)


def antialiased(factor: float, x: Tensor) -> Tensor:
    h, w = size_of(x)
    return kvision.geometry.resize(x, (int(h * factor), int(w * factor)), antialias=True)


CASES = [
    case(
        "warp_affine",
        lambda G, x, m: G.warp_affine(x, m, size_of(x)),
        Bars(floor=1.3, both=2.0, half=1.6, opencv=1.0),
        warp_opencv("warpAffine", "INTER_LINEAR"),
        inputs=with_affine,
    ),
    case(
        "warp_perspective",
        lambda G, x, m: G.warp_perspective(x, m, size_of(x)),
        Bars(floor=1.3, both=2.0, half=1.6, opencv=1.0),
        warp_opencv("warpPerspective", "INTER_LINEAR"),
        inputs=with_homography,
    ),
    case(
        "warp_bicubic",
        lambda G, x, m: G.warp_affine(x, m, size_of(x), mode="bicubic"),
        Bars(floor=2.0, opencv=1.0),
        warp_opencv("warpAffine", "INTER_CUBIC"),
        inputs=with_affine,
    ),
    Case("warp_antialiased_half", partial(warped_smaller, 2), {}, Bars(floor=1.8, both=3.5), inputs=with_affine),
    Case("warp_antialiased_quarter", partial(warped_smaller, 4), {}, Bars(floor=2.5, both=3.5), inputs=with_affine),
    case(
        "remap",
        lambda G, x, u, v: G.remap(x, u, v, align_corners=True),
        Bars(floor=1.4, opencv=1.0),
        lambda x, u, v, out=None: cv2.remap(x, u, v, cv2.INTER_LINEAR, out),
        inputs=with_map,
    ),
    case("remap_shared", lambda G, x, u, v: G.remap(x, u, v, align_corners=True), Bars(), None, inputs=with_shared_map),
    resized("resize", 0.5, "bilinear", "INTER_LINEAR", Bars(floor=1.15, opencv=1.0)),
    resized("resize_up", 1.5, "bilinear", "INTER_LINEAR", Bars(floor=1.15, opencv=1.0)),
    resized("resize_bicubic", 0.5, "bicubic", "INTER_CUBIC", Bars(opencv=1.0)),
    # Kornia blurs instead.
    Case("resize_antialias", partial(antialiased, 0.5), {}, Bars(floor=1.3)),
    Case("thumbnail", partial(antialiased, 0.22), {}, Bars()),
    case("hflip", lambda G, x: G.hflip(x), Bars(floor=1.08, opencv=1.0), lambda x, out=None: cv2.flip(x, 1, out)),
    case("center_crop", lambda G, x: G.center_crop(x, (200, 200)), Bars(floor=1.2), None),
    case(
        "crop_and_resize",
        lambda G, x, boxes: G.crop_and_resize(x, boxes, (128, 128)),
        Bars(floor=1.5),
        None,
        inputs=with_boxes,
    ),
    # What is read is the boxes; the gradient has the size of the images.
    Case(
        "crop_many",
        lambda x, boxes, index: kvision.geometry.crop_and_resize(x, boxes, (32, 32), box_indices=index),
        bars=Bars(launches=2),
        inputs=with_many_boxes,
        forward=lambda inputs, outputs: 5 * nbytes(outputs),
    ),
    case("pyrdown", lambda G, x: G.pyrdown(x), Bars(floor=1.3), None),
    case("pyrup", lambda G, x: G.pyrup(x), Bars(floor=1.3), None),
]
