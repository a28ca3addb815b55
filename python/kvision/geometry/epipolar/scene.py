"""Random scenes, for tests and examples."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kvision import _check
from kvision.geometry.epipolar.projection import cross_product_matrix, projection_from_KRt, random_intrinsics

__all__ = ["generate_scene"]


def generate_scene(num_views: int, num_points: int) -> dict[str, Tensor]:
    """Draw points in the unit cube and cameras that have all of them in front.

    Args:
        num_views: how many cameras, V.
        num_points: how many points, N.

    Returns:
        "K", the camera matrix (1, 3, 3) of all views; "R", rotations (V, 3, 3), and "t", translations (V, 3, 1), from
        the world to the cameras; "P", projections (V, 3, 4); "points3d", (1, N, 3); "points2d", their projections
        (V, N, 2).

    Raises:
        TypeCheckError: no ints.
        ValueCheckError: less than 1.

    Example:
        >>> import kvision as K
        >>> scene = K.geometry.generate_scene(2, 10)
        >>> scene["points2d"].shape
        torch.Size([2, 10, 2])
    """
    _check.ints("generate_scene", "num_views", num_views, 1)
    _check.ints("generate_scene", "num_points", num_points, 1)
    points = torch.rand(1, num_points, 3)
    K = random_intrinsics(0.0, 100.0)
    axis = torch.nn.functional.normalize(torch.rand(num_views, 3), dim=-1)
    angle = (2 * math.pi * torch.rand(num_views))[:, None, None]
    cross = cross_product_matrix(axis)
    R = torch.eye(3) + angle.sin() * cross + (1 - angle.cos()) * (cross @ cross)
    t = torch.rand(num_views, 3, 1) * torch.tensor([[1.0], [1.0], [3.0]]) - torch.tensor([[0.5], [0.5], [1.0]])
    nearest = (R @ points.mT + t)[:, 2].amin(-1)
    t[:, 2, 0] += torch.where(nearest < 0, 1 - nearest, 0)
    P = projection_from_KRt(K.expand_as(R), R, t)
    x = points @ P[..., :3].mT + P[:, None, :, 3]
    return {"K": K, "R": R, "t": t, "P": P, "points3d": points, "points2d": x[..., :2] / x[..., 2:]}
