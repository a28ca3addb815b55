"""Rotations, poses and transform matrices against Kornia, for one sample and many: one CPU thread, or a GPU.

python -m benchmarks.small_matrices [--device cuda]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import kornia
import torch
from torch import Tensor

import kvision
from benchmarks.few_points import minimum_times
from benchmarks.sample_calls import Size, geometry

MANY, SECONDS = 100_000, 0.2
Call = Callable[[], Any]


ROWS = """axis_angle_to_rotation_matrix axis_angle_to_quaternion quaternion_to_axis_angle quaternion_to_rotation_matrix
quaternion_exp_to_log rotation_matrix_to_quaternion rotation_matrix_to_axis_angle angle_to_rotation_matrix inverse_transformation
compose_transformations relative_transformation get_affine_matrix2d get_affine_matrix3d get_perspective_transform""".split()
IMAGES = "affine rotate translate scale shear rotate3d crop_by_boxes crop_and_resize".split()


def forward(f: Callable[..., Tensor], args: dict[str, Any]) -> Call:
    return lambda: f(**args)


def with_gradient(f: Callable[..., Tensor], args: dict[str, Any]) -> Call:
    first = next(iter(args))
    leaf = args[first].clone().requires_grad_()
    args = {**args, first: leaf}

    def call() -> Any:
        y = f(**args)
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
    entries = {call.function(): call for call in geometry.CALLS}
    of_rows = [(Size(count, 3, 1, count), ROWS, kinds) for count in (1, MANY)]
    for size, names, stages in [(Size(1, 3, 32, 32), IMAGES, {"": forward}), *of_rows]:
        for name in names:
            entry = entries[getattr(kvision.geometry, name)]
            for kind, made in stages.items():
                pair = [
                    made(getattr(library.geometry, name), entry.arguments(library, entry.tensors(size, device)))
                    for library in (kvision, kornia)
                ]
                pair = [waiting(call, device) for call in pair]
                for call in pair:  # warm-up: modules, allocator
                    call()
                ours, theirs = minimum_times(tuple(pair), SECONDS)
                print(f"{size.b:8} {name + ' ' + kind:44} {ours:12.1f} {theirs:12.1f}", flush=True)


if __name__ == "__main__":
    main()
