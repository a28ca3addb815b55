"""The tensors that many calls have: images, points, cameras, poses, boxes and grids."""

from __future__ import annotations

import torch
from torch import Tensor

import kvision as K
from benchmarks.sample_calls.model import Size, made, rand, randint


def camera(s: Size) -> Tensor:
    matrix = [[s.w, 0.0, s.w / 2], [0.0, s.w, s.h / 2], [0.0, 0.0, 1.0]]
    return torch.tensor(matrix).repeat(s.b, 1, 1)


def rotations(count: int) -> Tensor:
    return K.geometry.angle_axis_to_rotation_matrix(torch.rand(count, 3))


def poses(count: int) -> Tensor:
    return K.geometry.Rt_to_matrix4x4(rotations(count), torch.rand(count, 3, 1))


def near_identity(n: int, rows: int, s: Size) -> Tensor:
    return (torch.eye(n) + 0.02 * torch.rand(s.b, n, n))[:, :rows]


def projections(s: Size) -> Tensor:
    return camera(s) @ torch.cat([rotations(s.b), torch.rand(s.b, 3, 1)], 2)


def essentials(s: Size) -> Tensor:
    return K.geometry.cross_product_matrix(torch.rand(s.b, 3)) @ rotations(s.b)


def boxes(s: Size) -> Tensor:
    """Corners of a box inside of each image."""
    left, top, right, bottom = 1.0, 1.0, s.w * 0.7 // 1, s.h * 0.6 // 1
    return torch.tensor([[left, top], [right, top], [right, bottom], [left, bottom]]).repeat(s.b, 1, 1)


def boxes3d(s: Size) -> Tensor:
    x, y = (s.w // 4) * 1.0, (s.h // 4) * 1.0
    face = torch.tensor([[0.0, 0, 0], [x, 0, 0], [x, y, 0], [0, y, 0]])
    return torch.cat([face, face + torch.tensor([0.0, 0, 3])]).repeat(s.b, 1, 1)


def boxes_xyxy(s: Size) -> Tensor:
    corner = torch.rand(s.w, 2)
    return torch.cat([corner, corner + 0.1 + torch.rand(s.w, 2)], 1)


def boxes_rotated(s: Size) -> Tensor:
    return torch.cat([torch.rand(s.w, 2), 0.1 + torch.rand(s.w, 2), 90 * torch.rand(s.w, 1)], 1)


def grid(s: Size) -> Tensor:
    return K.geometry.create_meshgrid(s.h, s.w).repeat(s.b, 1, 1, 1)


def grid3d(s: Size) -> Tensor:
    return K.geometry.create_meshgrid3d(4, s.h, s.w).repeat(s.b, 1, 1, 1, 1)


def corners(s: Size) -> Tensor:
    return torch.tensor([[0.0, 0], [1, 0], [1, 1], [0, 1]]) + 0.1 * torch.rand(s.b, 4, 2)


def corners3d(s: Size) -> Tensor:
    return torch.cartesian_prod(*[torch.tensor([0.0, 1])] * 3) + 0.1 * torch.rand(s.b, 8, 3)


def distribution(s: Size) -> Tensor:
    return torch.rand(s).flatten(2).softmax(2).view(s)


IMAGE, GRAY, DEPTH = rand("B C H W"), rand("B 1 H W"), rand("B 1 H W", 1, 2)
VOLUME = rand("B C 9 H//2 W//2")
LABELS, BINARY = randint("B H W", "C"), randint("B C H W", 2)
DISTRIBUTION = made("B C H W", distribution)

POINTS, POINTS3, VISIBLE = rand("B N 2"), rand("B N 3"), rand("B N 3", 1, 2)  # the last ones are in front of a camera
NUMBERS, VECTORS, QUATERNIONS = rand("M", -0.5, 0.5), rand("M 3", -0.5, 0.5), rand("M 4", -0.5, 0.5)
SEGMENTS, WEIGHTS = rand("B N 2 2"), rand("B N")

CAMERA = made("B 3 3", camera)
CAMERA_OF_POINTS = made("B 1 3 3", lambda s: camera(s)[:, None])
PROJECTION = made("B 3 4", projections)
ROTATION, POSE = made("B 3 3", lambda s: rotations(s.b)), made("B 4 4", lambda s: poses(s.b))
ROTATIONS, POSES = made("M 3 3", lambda s: rotations(s.h * s.w)), made("M 4 4", lambda s: poses(s.h * s.w))
TRANSLATION = rand("B 3 1")
ESSENTIAL = made("B 3 3", essentials)
HOMOGRAPHY, AFFINE = (made(f"B {n} 3", lambda s, n=n: near_identity(3, n, s)) for n in (3, 2))
HOMOGRAPHY3D, AFFINE3D = (made(f"B {n} 4", lambda s, n=n: near_identity(4, n, s)) for n in (4, 3))

BOX, BOX3D, BOXES_XYXY = made("B 4 2", boxes), made("B 8 3", boxes3d), made("N 4", boxes_xyxy)
BOXES_ROTATED = made("N 5", boxes_rotated)
CORNERS, CORNERS3D = made("B 4 2", corners), made("B 8 3", corners3d)
GRID, GRID3D = made("B H W 2", grid), made("B 4 H W 3", grid3d)
