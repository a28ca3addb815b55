"""`python -m benchmarks.robust_batches`: robust fits of 256 pairs of 2,000 matches in one call on a GPU, half of them wrong.

The bars are 5 ms for homographies and fundamental matrices and 15 ms for essential matrices. Errors are those of
`benchmarks.robust_fits`, over the pairs.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np
import torch

import kvision as K
from benchmarks.robust_fits import (
    CAMERA,
    CONFIDENCE,
    LIMIT,
    SIZE,
    Pair,
    error,
    grid,
    moved,
    projected,
    rotation,
    threshold_of,
    with_wrong,
)


def pair(kind: str, count: int, share: float, seed: int) -> Pair:
    """As many matches as asked for: points that leave the second image are drawn again."""
    rng = np.random.default_rng(seed)
    if kind == "homography":
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * SIZE
        A = np.zeros((8, 9))
        to = corners + rng.uniform(-80, 80, (4, 2))
        for i, ((x, y), (u, v)) in enumerate(zip(corners, to)):
            A[2 * i] = [x, y, 1, 0, 0, 0, -u * x, -u * y, -u]
            A[2 * i + 1] = [0, 0, 0, x, y, 1, -v * x, -v * y, -v]
        truth = np.linalg.svd(A)[2][-1].reshape(3, 3)
        x = rng.random((count, 2)) * SIZE
        y, probes = moved(truth, x), (grid(SIZE), moved(truth, grid(SIZE)))
    else:
        t = rng.normal(size=3)
        truth = np.concatenate([rotation(rng, 15), t[:, None] / np.linalg.norm(t)], 1)
        depth, x = rng.uniform(4, 12, (8 * count, 1)), rng.random((8 * count, 2)) * SIZE
        X = np.concatenate([(x - CAMERA[:2, 2]) / CAMERA[0, 0], np.ones((len(x), 1))], 1) * depth
        y = projected(CAMERA @ truth, X)
        keep = np.flatnonzero(((y > 0) & (y < SIZE)).all(1))
        keep = np.resize(keep, count)
        x, y = x[keep], y[keep]
        probes = x.copy(), y.copy()
    noise = 0.7 * rng.normal(size=(2, count, 2))
    return Pair(*with_wrong(x + noise[0], y + noise[1], share, SIZE, rng), truth, CAMERA, probes)


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.robust_batches", description=__doc__)
    parse.add_argument("--pairs", type=int, default=256)
    parse.add_argument("--matches", type=int, default=2000)
    parse.add_argument("--wrong", nargs="+", type=float, default=[0.3, 0.5, 0.7], help="shares of wrong matches")
    parse.add_argument("--repeats", type=int, default=10)
    parse.add_argument("--device", default="cuda")
    parse.add_argument("--kinds", nargs="+", default=["homography", "fundamental", "essential"])
    options = parse.parse_args(arguments)
    device = torch.device(options.device)
    wait = torch.cuda.synchronize if device.type == "cuda" else (lambda: None)
    for kind, share in ((kind, share) for kind in options.kinds for share in options.wrong):
        pairs = [pair(kind, options.matches, share, seed) for seed in range(options.pairs)]
        x, y = (torch.from_numpy(np.stack([getattr(p, name) for p in pairs])).to(device) for name in "xy")
        threshold = threshold_of(kind)
        if kind == "essential":
            center = torch.tensor(CAMERA[:2, 2], dtype=torch.float32, device=device)
            x, y, threshold = (x - center) / CAMERA[0, 0], (y - center) / CAMERA[0, 0], threshold / CAMERA[0, 0]
        times = []
        for seed in range(options.repeats + 2):
            ransac = K.geometry.RANSAC(kind, threshold, confidence=CONFIDENCE, max_samples=LIMIT, seed=seed)
            wait()
            start = time.perf_counter()
            models = ransac(x, y)[0]
            wait()
            times.append(1e3 * (time.perf_counter() - start))
        errors = [error(kind, M.double().cpu().numpy(), p) for M, p in zip(models, pairs)]
        half, tail = np.percentile(errors, 50), np.percentile(errors, 90)
        print(
            f"{kind:12} {options.pairs} pairs x {options.matches}, {share:.0%} wrong: {min(times[2:]):8.3f} ms at least, "
            f"{np.median(times[2:]):8.3f} median; errors: median {half:.4f}, 90th percentile {tail:.4f}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
