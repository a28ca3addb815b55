"""`python -m benchmarks.patch_kornia`: a program written for Kornia, before and after `kvision.patch_kornia()`.

Ten calls of Kornia's functions, and a pipeline of its augmentations (random resized crop, flip, color jitter, normalize),
forward and forward + backward. Both run the same lines; the second time inside of the patch.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

import kvision as K
from benchmarks import machine
from benchmarks.case import photographs
from benchmarks.peers import set_threads
from benchmarks.timing import clock

CALLS = {
    "filters.gaussian_blur2d": lambda kornia, x: kornia.filters.gaussian_blur2d(x, (5, 5), (1.5, 1.5)),
    "filters.median_blur": lambda kornia, x: kornia.filters.median_blur(x, (3, 3)),
    "filters.sobel": lambda kornia, x: kornia.filters.sobel(x),
    "filters.canny": lambda kornia, x: kornia.filters.canny(x)[0],
    "color.rgb_to_lab": lambda kornia, x: kornia.color.rgb_to_lab(x),
    "enhance.equalize_clahe": lambda kornia, x: kornia.enhance.equalize_clahe(x),
    "geometry.resize": lambda kornia, x: kornia.geometry.resize(x, (192, 192)),
    "geometry.rotate": lambda kornia, x: kornia.geometry.rotate(x, torch.full((len(x),), 20.0, device=x.device)),
    "losses.ssim_loss": lambda kornia, x: kornia.losses.ssim_loss(x, x.flip(0), 11),
    "morphology.dilation": lambda kornia, x: kornia.morphology.dilation(x, torch.ones(5, 5, device=x.device)),
}


def pipeline(kornia: Any, device: torch.device) -> Callable[[Any, Tensor], Tensor]:
    augment = kornia.augmentation.AugmentationSequential(
        kornia.augmentation.RandomResizedCrop((224, 224)),
        kornia.augmentation.RandomHorizontalFlip(),
        kornia.augmentation.ColorJitter(0.2, 0.2, 0.2, 0.1, p=1.0),
        kornia.augmentation.Normalize(torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])),
    ).to(device)

    def run(_: Any, x: Tensor) -> Tensor:
        torch.manual_seed(0)
        return augment(x)

    return run


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.patch_kornia", description=__doc__)
    parse.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parse.add_argument("--batch", type=int, default=16)
    parse.add_argument("--threads", type=int, default=1, help="of torch on the CPU (default 1)")
    parse.add_argument("--seconds", type=float, default=0.5, help="time for one figure (default 0.5)")
    options = parse.parse_args(arguments)
    warnings.simplefilter("ignore")
    kornia = importlib.import_module("kornia")
    set_threads(options.threads)
    device = torch.device(options.device)
    about = machine.describe(device, ["kornia"])
    print(f"{about['hardware']}  threads {about['threads']}  {about['date']}  kvision {about['commit']}", end="  ")
    print(f"torch {about['torch']}  kornia {about['peers']['kornia']}\n$ {about['command']}")
    print(f"ms of the median call of {options.batch}x3x256x256; x: how many times as fast\n")
    print(f"{'call':26}{'stage':10}{'Kornia':>10}{'patched':>10}{'x':>8}")
    (images,) = photographs((options.batch, 3, 256, 256), torch.float32, device)
    leaf = images.clone().requires_grad_()
    stopwatch = clock(device, options.seconds)
    for name, call in {**CALLS, "pipeline of augmentations": pipeline(kornia, device)}.items():

        def both(call: Callable[[Any, Tensor], Tensor] = call) -> Any:
            return torch.autograd.grad(call(kornia, leaf).sum(), leaf)

        stages = {"forward": lambda call=call: call(kornia, images), "both": both}
        if not call(kornia, leaf).requires_grad:
            del stages["both"]
        times: dict[str, list[float]] = {}
        for context in (contextlib.nullcontext, K.patch_kornia):
            with context():
                for stage, run in stages.items():
                    times.setdefault(stage, []).append(stopwatch.time(run).median)
        for stage, (before, after) in times.items():
            print(f"{name:26}{stage:10}{1e3 * before:10.3g}{1e3 * after:10.3g}{before / after:8.1f}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
