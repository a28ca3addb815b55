"""Projection and distortion of points against OpenCV on one thread, for few points to many.

With few points the overhead of a call dominates.

python -m benchmarks.few_points
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import torch

import kvision.geometry as G

COUNTS = (8, 100, 1000, 100_000)
Calls = dict[str, tuple[Callable[[], Any], Callable[[], Any]]]


def calls(count: int) -> Calls:
    """The calls of kvision and OpenCV by name, each on arrays of its library."""
    random = torch.Generator().manual_seed(0)
    X = torch.rand(count, 3, generator=random) * 2 + torch.tensor([-1.0, -1, 4])
    camera = torch.tensor([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    lens = torch.tensor([0.1, -0.05, 0.01, 0.02, 0.03])
    pixels = 640 * torch.rand(count, 2, generator=random)
    P, Q = torch.eye(3, 4), torch.eye(3, 4)
    Q[0, 3] = -1
    x, y = ((p[:, :2] / p[:, 2:]) for p in (X, X + Q[:, 3]))
    K, k, zero = camera.double().numpy(), lens.double().numpy(), np.zeros(3)
    X_, pixels_, views = X.numpy()[:, None], pixels.numpy()[:, None], [np.ascontiguousarray(v.T) for v in (x, y)]
    return {
        "project": (lambda: G.project_points(X, camera), lambda: cv2.projectPoints(X_, zero, zero, K, None)),
        "project, distort": (
            lambda: G.distort_points(G.project_points(X, camera), camera, lens),
            lambda: cv2.projectPoints(X_, zero, zero, K, k),
        ),
        "undistort": (
            lambda: G.undistort_points(pixels, camera, lens),
            lambda: cv2.undistortPoints(pixels_, K, k, P=K),
        ),
        "triangulate": (
            lambda: G.triangulate_points(P, Q, x, y),
            lambda: cv2.triangulatePoints(P.numpy(), Q.numpy(), *views),
        ),
    }


def minimum_times(contestants: tuple[Callable[[], Any], ...], seconds: float = 0.5) -> list[float]:
    """The minimum time of each call in microseconds; calls alternate."""
    best = [float("inf")] * len(contestants)
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or best[0] == float("inf"):
        for i, call in enumerate(contestants):
            start = time.perf_counter()
            call()
            best[i] = min(best[i], 1e6 * (time.perf_counter() - start))
    return best


def main() -> None:
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    print(f"{'points':>8} {'':18} {'kvision us':>12} {'OpenCV us':>12}")
    for count in COUNTS:
        for name, pair in calls(count).items():
            ours, theirs = minimum_times(pair)
            print(f"{count:8} {name:18} {ours:12.1f} {theirs:12.1f}")


if __name__ == "__main__":
    main()
