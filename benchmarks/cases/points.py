"""Transforms of points by matrices. A sample has as many points as an image has pixels: a million for 1x3x1024x1024."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

import kvision
from benchmarks.case import Bars, Case, Size, nonlinear_backward
from benchmarks.peers import optional

kornia = optional("kornia")


def points(images: Size, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Points in front of a camera."""
    count = images[2] * images[3]
    random = torch.Generator().manual_seed(0)
    one = torch.rand(count, 3, generator=random) + torch.tensor([-0.5, -0.5, 1.0])
    return one.to(device, dtype).repeat(images[0], 1, 1)


def cameras(images: Size, dtype: torch.dtype, device: torch.device) -> Tensor:
    one = torch.tensor([[500.0, 0, images[3] / 2], [0, 500, images[2] / 2], [0, 0, 1]])
    return one.to(device, dtype).repeat(images[0], 1, 1)


def of_space(*args: Any) -> tuple[Tensor, ...]:
    return points(*args), cameras(*args)


def of_pixels(*args: Any) -> tuple[Tensor, ...]:
    p = points(*args)
    return p[..., :2].contiguous(), p[..., 2:].contiguous(), cameras(*args)


def with_pose(*args: Any) -> tuple[Tensor, ...]:
    p = points(*args)
    rotation = kvision.geometry.axis_angle_to_rotation_matrix(p.new_tensor([[0.1, 0.2, 0.3]]))
    return p, kvision.geometry.Rt_to_matrix4x4(rotation, p.new_ones(1, 3, 1)).repeat(len(p), 1, 1)


def case(name: str, call: Callable[..., Any], inputs: Callable[..., Any]) -> Case:
    peers = {"kornia": partial(call, kornia.geometry if kornia else None)}
    traffic = {"backward": nonlinear_backward}
    return Case(name, partial(call, kvision.geometry), peers, Bars(floor=1.3), inputs, **traffic)


CASES = [
    case("project_points", lambda G, p, k: G.project_points(p, k), of_space),
    case("unproject_points", lambda G, uv, d, k: G.unproject_points(uv, d, k), of_pixels),
    case("transform_points", lambda G, p, M: G.transform_points(M, p), with_pose),
]
