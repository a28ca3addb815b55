"""Scenes and correspondences for the tests of several views, in float64."""

from __future__ import annotations

import torch
from torch import Tensor

import kvision as K

CAMERA = torch.tensor([[80.0, 0, 50], [0, 85, 40], [0, 0, 1]]).double()
LENS = torch.tensor([0.1, -0.05, 0.01, 0.02, 0.03, 0.02, 0.01, 0.005, 0.01, 0.02, -0.01, 0.03, 0.05, -0.04]).double()


def rand(*shape: int, low: float = 0.0, high: float = 1.0, seed: int = 0) -> Tensor:
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) * (high - low) + low


def rotation(*angles: float) -> Tensor:
    """(3, 3), by an axis-angle vector."""
    return torch.linalg.matrix_exp(K.geometry.cross_product_matrix(torch.tensor(angles).double()))


def homographies(batch: int, seed: int = 1) -> Tensor:
    noise = rand(batch, 3, 3, low=-1, seed=seed)
    return torch.eye(3).double() + noise * torch.tensor([[0.2, 0.2, 15], [0.2, 0.2, 15], [1e-3, 1e-3, 0]]).double()


def moved(points: Tensor, H: Tensor) -> Tensor:
    p = points @ H[..., :2].mT + H[..., None, :, 2]
    return p[..., :2] / p[..., 2:]


def on_planes(batch: int, count: int, noise: float = 0.0, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Points of two images of planes (B, N, 2), and the homographies between them."""
    points, H = rand(batch, count, 2, high=100, seed=seed), homographies(batch)
    return points, moved(points, H) + noise * rand(batch, count, 2, low=-1, seed=seed + 1), H


class Scene:
    """Points (B, N, 3) before two cameras, in both images (B, N, 2)."""

    def __init__(self, batch: int, count: int, noise: float = 0.0, seed: int = 0) -> None:
        self.points = rand(batch, count, 3, seed=seed) * torch.tensor([4.0, 3.0, 4.0]) + torch.tensor([-2.0, -1.5, 4.0])
        self.R, self.t = rotation(0.1, -0.2, 0.05), torch.tensor([[1.0], [0.1], [0.2]]).double()
        self.P1 = K.geometry.projection_from_KRt(CAMERA, torch.eye(3).double(), torch.zeros(3, 1).double())
        self.P2 = K.geometry.projection_from_KRt(CAMERA, self.R, self.t)
        eye, zero = torch.eye(3).double(), torch.zeros(3, 1).double()
        self.E = K.geometry.essential_from_Rt(eye, zero, self.R, self.t)
        self.F = K.geometry.fundamental_from_essential(self.E, CAMERA, CAMERA)
        shift = noise * rand(2, batch, count, 2, low=-1, seed=seed + 1)
        self.x1, self.x2 = (moved_by(P, self.points) + s for P, s in zip((self.P1, self.P2), shift))

    def normalized(self) -> tuple[Tensor, Tensor]:
        """Both images in the cameras' coordinates."""
        inverse = torch.linalg.inv(CAMERA)
        return moved(self.x1, inverse), moved(self.x2, inverse)


def moved_by(P: Tensor, points: Tensor) -> Tensor:
    p = points @ P[:, :3].T + P[:, 3]
    return p[..., :2] / p[..., 2:]
