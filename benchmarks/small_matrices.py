"""Rotations, poses and transform matrices against Kornia, for one sample and many: one CPU thread, or a GPU.

python -m benchmarks.small_matrices [--device cuda]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import kornia.geometry as kornia
import torch
from torch import Tensor

import kvision.geometry as G
from benchmarks.few_points import minimum_times

MANY = 100_000
Call = Callable[[], Any]


def of_rows(count: int, device: str) -> dict[str, tuple[Tensor, ...]]:
    """Arguments of functions that both libraries have, by name."""
    random = torch.Generator().manual_seed(0)
    v, q = (torch.randn(count, n, generator=random).to(device) for n in (3, 4))
    R = G.axis_angle_to_rotation_matrix(v)
    T = torch.eye(4, device=device).repeat(count, 1, 1)
    T[:, :3, :3], T[:, :3, 3] = R, v
    quad = torch.tensor([[0.0, 0], [4, 0], [4, 3], [0, 3]]) + 0.3 * torch.rand(count, 4, 2, generator=random)
    angle = 30 * v[:, 0]
    return {
        "axis_angle_to_rotation_matrix": (v,),
        "axis_angle_to_quaternion": (v,),
        "quaternion_to_axis_angle": (q,),
        "quaternion_to_rotation_matrix": (q,),
        "quaternion_exp_to_log": (q,),
        "rotation_matrix_to_quaternion": (R,),
        "rotation_matrix_to_axis_angle": (R,),
        "angle_to_rotation_matrix": (angle,),
        "inverse_transformation": (T,),
        "compose_transformations": (T, T),
        "relative_transformation": (T, T),
        "get_affine_matrix2d": (v[:, :2], v[:, 1:], q[:, :2], angle),
        "get_affine_matrix3d": (v, v, v, 30 * v),
        "get_perspective_transform": (quad.to(device), quad.flip(0).to(device)),
    }


def of_images(device: str) -> dict[str, tuple[Any, ...]]:
    x, volume = torch.rand(1, 3, 32, 32, device=device), torch.rand(1, 1, 8, 8, 8, device=device)
    angle, pair = torch.tensor([25.0], device=device), torch.tensor([[1.5, 2.5]], device=device)
    box = torch.tensor([[[1.0, 1], [8, 1], [8, 8], [1, 8]]], device=device)
    return {
        "affine": (x, torch.eye(2, 3, device=device)[None]),
        "rotate": (x, angle),
        "translate": (x, pair),
        "scale": (x, pair),
        "shear": (x, 0.1 * pair),
        "rotate3d": (volume, angle, angle, angle),
        "crop_by_boxes": (x, box, box - 1),
        "crop_and_resize": (x, box, (8, 8)),
    }


def forward(f: Callable[..., Tensor], args: tuple[Any, ...]) -> Call:
    return lambda: f(*args)


def with_gradient(f: Callable[..., Tensor], args: tuple[Any, ...]) -> Call:
    leaf = args[0].clone().requires_grad_()

    def call() -> Any:
        y = f(leaf, *args[1:])
        return torch.autograd.grad(y, leaf, torch.ones_like(y))

    return call


def waiting(call: Call, device: str) -> Call:
    """Run `call` and wait for the device."""

    def finished() -> None:
        call()
        torch.cuda.synchronize()

    return finished if device == "cuda" else call


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    device = parser.parse_args().device
    torch.set_num_threads(1)
    kinds = {"": forward, "with gradient": with_gradient}
    print(f"{'rows':>8} {'':44} {'kvision us':>12} {'Kornia us':>12}")
    cases = [(1, "image", of_images(device)), *((n, "rows", of_rows(n, device)) for n in (1, MANY))]
    for count, of, arguments in cases:
        for name, args in arguments.items():
            for kind, made in kinds.items() if of == "rows" else [("", forward)]:
                pair = [made(getattr(library, name), args) for library in (G, kornia)]
                pair = [waiting(call, device) for call in pair]
                for call in pair:  # warm-up: modules, allocator
                    call()
                ours, theirs = minimum_times(tuple(pair), 0.2)
                print(f"{count:8} {name + ' ' + kind:44} {ours:12.1f} {theirs:12.1f}", flush=True)


if __name__ == "__main__":
    main()
