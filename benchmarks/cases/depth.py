"""Peaks and depth. Bars are the modules' targets, for images of one channel, for example 16x1x480x640."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

import kvision
from benchmarks.case import Bars, Case, Size, nonlinear_backward, photographs
from benchmarks.peers import optional

kornia = optional("kornia")


def case(name: str, call: Callable[..., Any], bars: Bars, **more: Any) -> Case:
    """A case whose `call(geometry, input)` is the same for kvision and Kornia."""
    return Case(
        name,
        partial(call, kvision.geometry),
        {"kornia": partial(call, kornia.geometry if kornia else None)},
        bars,
        **more,
    )


def volumes(images: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    """Five scales of a smooth channel, with few and unique maxima."""
    batch, _, h, w = images
    smooth = kvision.filters.gaussian_blur2d(photographs((batch, 1, h, w), dtype, device)[0], (13, 13), (2.0, 2.0))
    return (torch.stack([scale * smooth for scale in (0.5, 0.8, 1.0, 0.85, 0.4)], 2),)


def camera_of(images: Size, dtype: torch.dtype, device: torch.device) -> Tensor:
    _, _, h, w = images
    camera = torch.tensor([[[0.8 * w, 0, w / 2], [0, 0.8 * w, h / 2], [0, 0, 1]]])
    return camera.to(device, torch.float64 if dtype == torch.float64 else torch.float32)


def depths(images: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    batch, _, h, w = images
    (depth,) = photographs((batch, 1, h, w), dtype, device)
    return 1 + depth, camera_of(images, dtype, device).expand(batch, 3, 3)


def with_depth(images: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    depth, camera = depths(images, camera_of(images, dtype, device).dtype, device)
    motion = torch.eye(4, dtype=camera.dtype, device=device).repeat(len(depth), 1, 1)
    motion[:, :3, 3] += 0.02
    return *photographs(images, dtype, device), depth, motion, camera


CASES = [
    case("nms2d", lambda G, x: G.nms2d(x, (5, 5)), Bars(floor=1.5), backward=nonlinear_backward),
    case("nms3d", lambda G, x: G.nms3d(x, (3, 3, 3)), Bars(), inputs=volumes, backward=nonlinear_backward),
    case(
        "conv_soft_argmax2d",
        lambda G, x: G.conv_soft_argmax2d(x, (5, 5), (1, 1), (2, 2)),
        Bars(floor=1.5),
        backward=nonlinear_backward,
        result=lambda coords: coords[:, :, 0],
    ),
    case(
        "conv_quad_interp3d",
        lambda G, x: G.conv_quad_interp3d(x),
        Bars(),
        inputs=volumes,
        backward=nonlinear_backward,
        result=lambda found: found[1],
    ),
    case("depth_to_3d", lambda G, d, k: G.depth_to_3d(d, k), Bars(floor=1.3), inputs=depths),
    case(
        "depth_to_normals",
        lambda G, d, k: G.depth_to_normals(d, k),
        Bars(floor=1.3),
        inputs=depths,
        backward=nonlinear_backward,
    ),
    case(
        "warp_frame_depth",
        lambda G, x, d, m, k: G.warp_frame_depth(x, d, m, k),
        Bars(),
        inputs=with_depth,
        backward=nonlinear_backward,
    ),
]
