"""`python -m benchmarks.augmentation`: pipelines and single augmentations against Kornia and torchvision.

Milliseconds of the device for a batch, forward and forward + backward. On a GPU also microseconds of the host for one image,
parameters included. torchvision draws one set of parameters for the batch. The floor reads the images and writes the results
once.
"""

from __future__ import annotations

import argparse
import importlib
import math
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any

import torch
from torch import Tensor

import kvision.augmentation as A
from benchmarks import machine
from benchmarks.case import photographs
from benchmarks.host_time import microseconds
from benchmarks.peers import set_threads
from benchmarks.timing import clock

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
JITTER = (0.2, 0.2, 0.2, 0.1)
Make = Callable[[], Callable[[Tensor], Tensor]]


def kornia_pipeline(K: Any) -> dict[str, Make]:
    mean, std = torch.tensor(MEAN), torch.tensor(STD)
    return {
        "A: crop, flip, jitter, normalize": lambda: K.AugmentationSequential(
            K.RandomResizedCrop((224, 224)),
            K.RandomHorizontalFlip(),
            K.ColorJitter(*JITTER, p=1.0),
            K.Normalize(mean, std),
        ),
        "C: affine": lambda: K.RandomAffine(30.0, (0.1, 0.1), (0.8, 1.2), 10.0, p=1.0),
        "D: color jitter": lambda: K.ColorJitter(*JITTER, p=1.0),
        "horizontal flip": lambda: K.RandomHorizontalFlip(p=0.5),
        "rotation": lambda: K.RandomRotation(30.0, p=1.0),
        "perspective": lambda: K.RandomPerspective(0.5, p=1.0),
        "crop": lambda: K.RandomCrop((192, 192)),
        "resized crop": lambda: K.RandomResizedCrop((224, 224)),
        "gaussian blur": lambda: K.RandomGaussianBlur((5, 5), (0.1, 2.0), p=1.0),
        "grayscale": lambda: K.RandomGrayscale(p=1.0),
        "equalize": lambda: K.RandomEqualize(p=1.0),
        "solarize": lambda: K.RandomSolarize(0.1, 0.1, p=1.0),
        "posterize": lambda: K.RandomPosterize(3, p=1.0),
    }


def torchvision_pipeline(T: Any) -> dict[str, Make]:
    return {
        "A: crop, flip, jitter, normalize": lambda: T.Compose(
            [
                T.RandomResizedCrop(224, antialias=False),
                T.RandomHorizontalFlip(),
                T.ColorJitter(*JITTER),
                T.Normalize(MEAN, STD),
            ]
        ),
        "C: affine": lambda: T.RandomAffine(30.0, (0.1, 0.1), (0.8, 1.2), 10.0),
        "D: color jitter": lambda: T.ColorJitter(*JITTER),
        "horizontal flip": lambda: T.RandomHorizontalFlip(),
        "rotation": lambda: T.RandomRotation(30.0),
        "perspective": lambda: T.RandomPerspective(0.5, p=1.0),
        "crop": lambda: T.RandomCrop(192),
        "resized crop": lambda: T.RandomResizedCrop(224, antialias=False),
        "gaussian blur": lambda: T.GaussianBlur(5, (0.1, 2.0)),
        "grayscale": lambda: T.Grayscale(3),
        "equalize": lambda: T.RandomEqualize(p=1.0),
        "solarize": lambda: T.RandomSolarize(0.5, p=1.0),
        "posterize": lambda: T.RandomPosterize(4, p=1.0),
    }


def has_gradient(augment: Callable[[Tensor], Tensor], leaf: Tensor) -> bool:
    try:
        result = augment(leaf)
        if result.requires_grad:
            torch.autograd.grad(result.sum(), leaf)
        return result.requires_grad
    except RuntimeError as error:
        if "inplace" in str(error):  # torchvision's hue and perspective write to tensors that autograd needs
            return False
        raise


def libraries() -> dict[str, dict[str, Make]]:
    found = {"kvision": kornia_pipeline(A)}
    for name, module, pipelines in (
        ("kornia", "kornia.augmentation", kornia_pipeline),
        ("torchvision", "torchvision.transforms.v2", torchvision_pipeline),
    ):
        try:
            found[name] = pipelines(importlib.import_module(module))
        except (ImportError, RuntimeError) as error:
            print(f"{name} is not measured: {str(error).splitlines()[0]}")
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.augmentation", description=__doc__)
    parse.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parse.add_argument("--batch", type=int, default=128)
    parse.add_argument("--size", type=int, default=256)
    parse.add_argument("--threads", type=int, default=1, help="of torch on the CPU (default 1)")
    parse.add_argument("--seconds", type=float, default=0.3, help="time for one figure (default 0.3)")
    options = parse.parse_args(arguments)
    warnings.simplefilter("ignore")
    set_threads(options.threads)
    device = torch.device(options.device)
    about = machine.describe(device, [name for name in ("kornia", "torchvision") if find_spec(name)])
    print(f"{about['hardware']}  threads {about['threads']}  {about['date']}  kvision {about['commit']}", end="  ")
    print(f"torch {about['torch']}  {about['peers']}\n$ {about['command']}")
    print(
        f"float32 {options.batch}x3x{options.size}x{options.size}; host: microseconds of a call on one image, on a GPU\n"
    )
    (images,) = photographs((options.batch, 3, options.size, options.size), torch.float32, device)
    leaf, one = images.clone().requires_grad_(), images[:1].contiguous()
    stopwatch = clock(device, options.seconds)
    bandwidth = stopwatch.copy_bandwidth()
    found = libraries()
    head = "".join(f"{name:>14}{'f+b':>9}{'host':>8}" for name in found)
    print(f"{'ms':34}{'floor':>8}{head}")
    for name in found["kvision"]:
        line = f"{name:34}"
        for library, pipelines in found.items():
            augment = pipelines[name]()
            result = augment(images)
            if library == "kvision":
                line += f"{1e3 * (images.nbytes + result.nbytes) / bandwidth:8.3f}"

            def both(augment: Any = augment) -> Any:
                return torch.autograd.grad(augment(leaf).sum(), leaf)

            forward = 1e3 * stopwatch.time(lambda augment=augment: augment(images)).median
            with torch.enable_grad():
                backward = 1e3 * stopwatch.time(both).median if has_gradient(augment, leaf) else math.nan
            host = math.nan if device.type == "cpu" else microseconds(lambda augment=augment: augment(one))
            line += f"{forward:14.3f}{backward:9.3f}{host:8.0f}"
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
