"""Geometry of few points, whose cost is launches and synchronization, not bytes. Bars are relative to the peers."""

from __future__ import annotations

from functools import partial
from typing import Any

import torch
from torch import Tensor

import kvision
from benchmarks.case import Bars, Case, Size
from benchmarks.peers import optional

cv2 = optional("cv2")
kornia = optional("kornia")


def planes(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """Correspondences of planes with noise: a problem of eight points for each row of each image."""
    count = size[0] * size[1]
    random = torch.Generator().manual_seed(0)
    points = torch.rand(count, 8, 2, generator=random) * 100
    tilt = torch.rand(count, 1, 2, generator=random) * 2e-3
    moved = (points * 1.1 + 5) / (1 + (points * tilt).sum(-1, keepdim=True))
    moved = moved + torch.randn(points.shape, generator=random) * 0.1
    return points.to(device, dtype), moved.to(device, dtype)


def matches(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """2000 matches of one plane, half of them outliers."""
    random = torch.Generator().manual_seed(0)
    points = torch.rand(2000, 2, generator=random) * 500
    moved = (points * 1.1 + 5) / (1 + points @ torch.tensor([[2e-4], [1e-4]]))
    moved = moved + torch.randn(points.shape, generator=random) * 0.3
    moved[:1000] = torch.rand(1000, 2, generator=random) * 500
    return points.to(device, dtype), moved.to(device, dtype)


def views(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    """100 000 points in front of two cameras, and the cameras."""
    random = torch.Generator().manual_seed(0)
    X = torch.rand(100_000, 3, generator=random) * 2 + torch.tensor([-1.0, -1.0, 4.0])
    P1, P2 = torch.eye(3, 4), torch.eye(3, 4)
    P2[0, 3] = -1.0
    pictures = [x[:, :2] / x[:, 2:] for x in (X @ P[:, :3].T + P[:, 3] for P in (P1, P2))]
    return tuple(x.to(device, dtype) for x in (*pictures, P1, P2))


def corners(homography: Tensor) -> Tensor:
    """Map the corners of a square of 500 pixels. They compare homographies better than matrix entries do."""
    square = homography.new_tensor([[0, 0, 1], [500, 0, 1], [0, 500, 1], [500, 500, 1]])
    moved = square @ homography.mT
    return moved[..., :2] / moved[..., 2:]


def lens(size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    """100 000 points, a camera and five coefficients of its lens."""
    points = torch.rand(1, 100_000, 2, generator=torch.Generator().manual_seed(0)) * 640
    camera = torch.tensor([[[500.0, 0, 320], [0, 500, 320], [0, 0, 1]]])
    return tuple(x.to(device, dtype) for x in (points, camera, torch.tensor([[0.1, -0.05, 0.01, 0.02, 0.03]])))


def case(name: str, call: Any, bars: Bars, **more: Any) -> Case:
    """A case whose `call(geometry, input, ...)` is the same for kvision and Kornia."""
    peers = {"kornia": partial(call, kornia.geometry if kornia else None)}
    return Case(name, partial(call, kvision.geometry), peers, bars, **more)


CASES = [
    case(
        "find_homography_dlt",
        lambda G, x, y: G.find_homography_dlt(x, y, solver="svd"),
        Bars(launches=1, kornia=0.1),
        inputs=planes,
    ),
    case(
        "ransac",
        lambda G, x, y: G.ransac.RANSAC("homography", 2.0, seed=0)(x, y)[0],
        Bars(launches=None),
        inputs=matches,
        result=corners,
    ),
    case(
        "triangulate_points",
        lambda G, x, y, P, Q: G.triangulate_points(P, Q, x, y),
        Bars(launches=1),
        inputs=views,
    ),
    case(
        "undistort_points",
        lambda G, x, K, d: G.undistort_points(x, K, d),
        Bars(launches=None),
        inputs=lens,
    ),
]
