"""`python -m benchmarks.least_squares`: least squares on manifolds, poses and bundles, against PyPose, on one CPU thread.

    pip install --no-deps --target FOLDER pypose==0.9.5
    python -m benchmarks.least_squares --peers FOLDER
    python -m benchmarks.least_squares --device cuda     1,000 poses, bundles of 31,843 observations, 1,000 poses by RANSAC

All solvers start alike and take ten steps of Levenberg and Marquardt's method. PyPose's has one damping for everything that it is
given and a dense Jacobian of all parameters, so it solves poses one after another. Costs are half the sum of squared errors in
pixels, the mean over the problems. Times are minima of CPU time.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks import machine
from benchmarks.peers import set_threads
from kvision.geometry import solve_pnp_ransac
from kvision.geometry.liegroup import Se3
from kvision.geometry.optim import ReprojectionError, least_squares

STEPS = 10
CAMERA = torch.tensor([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]], dtype=torch.float64)
Fit = Callable[[], float]  # the mean cost of the problems


def motions(*shape: int, scale: float, seed: int) -> Se3:
    generator = torch.Generator().manual_seed(seed)
    return Se3.exp(scale * torch.randn(*shape, 6, generator=generator, dtype=torch.float64)).requires_grad_(False)


def projected(poses: Any, X: Tensor, seed: int) -> Tensor:
    """Pixels with noise of half a pixel."""
    h = (poses * X) @ CAMERA.T
    noise = torch.randn(h[..., :2].shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return h[..., :2] / h[..., 2:] + 0.5 * noise


def points(*shape: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, 3, generator=generator, dtype=torch.float64) + torch.tensor([0.0, 0.0, 8.0])


class Poses:
    """Cameras that see 50 known points each."""

    def __init__(self, count: int) -> None:
        self.name, self.count = f"{count} poses of 50 points", count
        truth, self.X = motions(count, scale=0.2, seed=0), points(count, 50, seed=1)
        self.pixels = projected(truth[:, None], self.X, 2)
        self.start = (motions(count, scale=0.03, seed=3) * truth).requires_grad_(False)

    def ours(self, closed_form: bool) -> Fit:
        error = ReprojectionError(self.pixels, CAMERA, self.X)
        residuals = error if closed_form else error.__call__

        def fit() -> float:
            options: dict[str, Any] = {"max_iterations": STEPS, "gradient": "none"}
            return float(least_squares(residuals, {"pose": self.start}, **options).cost.mean())

        return fit

    def pypose(self, pp: Any) -> Fit:
        start = torch.cat([self.start.t, self.start.quaternion.data[:, [1, 2, 3, 0]]], 1)

        class Error(torch.nn.Module):
            def __init__(self, pose: Tensor, X: Tensor, pixels: Tensor) -> None:
                super().__init__()
                self.pose, self.X, self.pixels = pp.Parameter(pp.SE3(pose)), X, pixels

            def forward(self, inputs: None) -> Tensor:
                h = self.pose.Act(self.X) @ CAMERA.T
                return h[..., :2] / h[..., 2:] - self.pixels

        def fit() -> float:
            total = 0.0
            for i in range(self.count):
                model = Error(start[i], self.X[i], self.pixels[i])
                optimizer = pp.optim.LM(model, strategy=pp.optim.strategy.TrustRegion())
                for _ in range(STEPS):
                    optimizer.step(None)
                total += 0.5 * model(None).detach().square().sum().item()
            return total / self.count

        return fit


class Bundle:
    """Cameras that all see all points, both unknown."""

    def __init__(self, cameras: int, count: int) -> None:
        self.name = f"bundle of {cameras} cameras, {count} points"
        self.camera, self.point = torch.cartesian_prod(torch.arange(cameras), torch.arange(count)).unbind(-1)
        truth, X = motions(1, cameras, scale=0.2, seed=0), points(1, count, seed=1)
        self.pixels = projected(truth[:, self.camera], X[:, self.point], 2)
        shift = 0.02 * torch.randn(X.shape, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
        self.poses, self.X = (motions(1, cameras, scale=0.01, seed=3) * truth).requires_grad_(False), X + shift

    def ours(self, closed_form: bool) -> Fit:
        error = ReprojectionError(self.pixels, CAMERA)
        residuals = error if closed_form else error.__call__

        def fit() -> float:
            index = {"pose": self.camera, "points": self.point}
            options: dict[str, Any] = {"max_iterations": STEPS, "gradient": "none", "eliminate": "points"}
            start = {"pose": self.poses, "points": self.X}
            return float(least_squares(residuals, start, index=index, **options).cost.mean())

        return fit

    def pypose(self, pp: Any) -> Fit:
        start = torch.cat([self.poses.t[0], self.poses.quaternion.data[0][:, [1, 2, 3, 0]]], 1)
        camera, point, pixels, X = self.camera, self.point, self.pixels[0], self.X[0]

        class Error(torch.nn.Module):
            def __init__(self) -> None:
                super().__init__()
                self.pose, self.X = pp.Parameter(pp.SE3(start)), torch.nn.Parameter(X)

            def forward(self, inputs: None) -> Tensor:
                h = self.pose[camera].Act(self.X[point]) @ CAMERA.T
                return h[..., :2] / h[..., 2:] - pixels

        def fit() -> float:
            model = Error()
            optimizer = pp.optim.LM(model, strategy=pp.optim.strategy.TrustRegion())
            for _ in range(STEPS):
                optimizer.step(None)
            return 0.5 * model(None).detach().square().sum().item()

        return fit


# --- large problems --------------------------------------------------------------------------------------------------


def milliseconds(call: Callable[[], Any], device: torch.device) -> float:
    """The median of five calls, each to its end."""

    def timed() -> float:
        start = time.perf_counter()
        call()
        if device.type == "cuda":
            torch.cuda.synchronize()
        return 1e3 * (time.perf_counter() - start)

    timed()
    return sorted(timed() for _ in range(5))[2]


def bundle_of(cameras: int, count: int, observations: int, like: Tensor) -> tuple[ReprojectionError, dict[str, Any]]:
    """The error of a bundle, and the other arguments; each of `count` points is seen from some neighboring cameras."""
    point = torch.arange(observations) * count // observations
    camera = (point * cameras // count + torch.arange(observations)) % cameras
    truth, X = motions(1, cameras, scale=0.2, seed=0), points(1, count, seed=1)
    pixels = projected(truth[:, camera], X[:, point], 2)
    start = (motions(1, cameras, scale=0.01, seed=3) * truth).requires_grad_(False)
    options: dict[str, Any] = {
        "variables": {"pose": start.to(like), "points": X.to(like)},
        "index": {"pose": camera.to(like.device), "points": point.to(like.device)},
        "eliminate": "points",
    }
    return ReprojectionError(pixels.to(like), CAMERA.to(like)), options


def large(device: torch.device) -> None:
    """Times of problems whose bars are for one GPU, without their first call."""
    like = torch.empty(0, device=device)
    endless: dict[str, Any] = {"gradient": "none", **dict.fromkeys(("ftol", "xtol", "gtol"), 0.0)}
    truth, X = motions(1000, scale=0.2, seed=0), points(1000, 50, seed=1)
    error = ReprojectionError(projected(truth[:, None], X, 2).to(like), CAMERA.to(like), X.to(like))
    start = {"pose": (motions(1000, scale=0.03, seed=3) * truth).requires_grad_(False).to(like)}
    for name, residuals in (("ReprojectionError", error), ("torch.func", error.__call__)):
        ms = milliseconds(partial(least_squares, residuals, start, max_iterations=STEPS, **endless), device)
        print(f"1000 poses of 50 points, {STEPS} steps, {name}: {ms:.2f} ms", flush=True)
    for count in (7776, 650):
        for dtype in (torch.float64, torch.float32):
            residuals, options = bundle_of(49, count, 31843, like.to(dtype))
            fit = partial(least_squares, residuals, **options, **endless)
            one, more = (milliseconds(partial(fit, max_iterations=n), device) for n in (1, 1 + STEPS))
            line = f"bundle of 49 cameras, {count} points, 31843 observations, {dtype}: {(more - one) / STEPS:.3f} ms a step"
            if device.type == "cuda":
                torch.cuda.reset_peak_memory_stats()
                before = torch.cuda.memory_allocated()
                fit(max_iterations=STEPS)
                peak = torch.cuda.max_memory_allocated() - before
                line += f", peak {peak / (31843 * 2 * 9 * dtype.itemsize):.2f} times the Jacobians"
            print(line, flush=True)
    X = points(1000, 100, seed=1)
    pixels = projected(truth[:, None], X, 2)
    pixels[:, :30] = 500 * torch.rand(1000, 30, 2, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    problems = [x.to(like) for x in (X, pixels, CAMERA.expand(1000, 3, 3))]
    ms = milliseconds(lambda: solve_pnp_ransac(problems[0], problems[1], problems[2], seed=0), device)
    print(f"1000 poses of 100 points, 30% wrong, solve_pnp_ransac: {ms:.2f} ms")


def quickest(fit: Fit, repeats: int) -> tuple[float, float]:
    """The least CPU time in ms, which other work on the machine does not lengthen, and the cost."""
    best, cost = float("inf"), 0.0
    for _ in range(repeats):
        start = time.thread_time()
        cost = fit()
        best = min(best, time.thread_time() - start)
    return 1e3 * best, cost


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.least_squares", description=__doc__)
    parse.add_argument("--peers", type=Path, help="folder into which PyPose was installed")
    parse.add_argument("--poses", type=int, default=20, help="problems of one camera (default 20)")
    parse.add_argument("--repeats", type=int, default=3, help="of timed calls (default 3)")
    parse.add_argument("--device", type=torch.device, help="times large problems on this device instead")
    options = parse.parse_args(arguments)
    if options.device is not None:
        large(options.device)
        return 0
    set_threads(1)
    about = machine.describe(torch.device("cpu"), ["scipy"])
    print(f"{about['hardware']}  {about['date']}  kvision {about['commit']}  torch {about['torch']}")
    print(f"$ {about['command']}\n\n{'problem':36}{'solver':34}{'ms':>10}{'times':>8}{'cost':>12}")
    pp = None
    if options.peers is not None:
        sys.path.append(str(options.peers))
        import pypose as pp  # type: ignore[import-not-found, no-redef]
    for problem in (Poses(options.poses), Poses(1), Bundle(6, 60)):
        solvers = {"kvision, ReprojectionError": problem.ours(True), "kvision, torch.func": problem.ours(False)}
        if pp is not None:
            solvers[f"PyPose {pp.__version__}"] = problem.pypose(pp)
        first = None
        for name, fit in solvers.items():
            ms, cost = quickest(fit, options.repeats)
            first = ms if first is None else first
            print(f"{problem.name:36}{name:34}{ms:10.2f}{ms / first:8.1f}{cost:12.4f}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
