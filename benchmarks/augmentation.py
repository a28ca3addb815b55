"""`python -m benchmarks.augmentation`: pipelines and single augmentations against Kornia and torchvision.

Milliseconds of the device for a batch, forward and forward + backward. On a GPU also microseconds of the host for one image,
parameters included. torchvision draws one set of parameters for the batch. The floor reads the images and writes the results
once. `--pipeline B` is affine + perspective + elastic + crop with a mask, on batches of 32 images of 512 x 512 unless told
otherwise, interpolated in each and once.
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
from benchmarks.timing import Clock, clock, extra_bytes, launches

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


def pipeline_b(K: Any, size: int, **options: Any) -> Callable[[Tensor, Tensor], Any]:
    """Affine + perspective + elastic + crop to 7/8 of images with a mask, by Kornia's names."""
    augment: Callable[[Tensor, Tensor], Any] = K.AugmentationSequential(
        K.RandomAffine(30.0, (0.1, 0.1), (0.8, 1.2), 10.0, p=1.0),
        K.RandomPerspective(0.3, p=1.0),
        K.RandomElasticTransform((63, 63), (16.0, 16.0), (1.0, 1.0), p=1.0),
        K.RandomCrop((7 * size // 8, 7 * size // 8)),
        data_keys=["input", "mask"],
        **options,
    )
    return augment


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


def imported_libraries() -> dict[str, Any]:
    """The modules of augmentations of other libraries that can be imported."""
    modules = {}
    for name, module in (("kornia", "kornia.augmentation"), ("torchvision", "torchvision.transforms.v2")):
        try:
            modules[name] = importlib.import_module(module)
        except (ImportError, RuntimeError) as error:
            print(f"{name} is not measured: {str(error).splitlines()[0]}")
    return modules


def libraries() -> dict[str, dict[str, Make]]:
    pipelines_of = {"kvision": kornia_pipeline(A)}
    for name, module in imported_libraries().items():
        pipelines_of[name] = torchvision_pipeline(module) if name == "torchvision" else kornia_pipeline(module)
    return pipelines_of


def measure_pipeline_b(images: Tensor, stopwatch: Clock, bandwidth: float) -> None:
    masks = (images[:, :1] > 0.5).float()  # Kornia's masks
    one = images[:1].contiguous(), masks[:1].contiguous()
    leaf = images.clone().requires_grad_()
    contestants = {
        "kvision, once": pipeline_b(A, images.shape[-1], resample="once"),
        "kvision, each": pipeline_b(A, images.shape[-1]),
    }
    if find_spec("kornia"):
        contestants["kornia"] = pipeline_b(importlib.import_module("kornia.augmentation"), images.shape[-1])
    results = next(iter(contestants.values()))(images, masks)
    floor = 1e3 * sum(x.nbytes for x in (images, masks, *results)) / bandwidth
    print(f"B: affine, perspective, elastic, crop with a mask; floor {floor:.3f} ms")
    print(f"{'ms':16}{'forward':>10}{'f+b':>10}{'host':>8}{'launches':>10}{'extra MB':>10}")
    for name, augment in contestants.items():

        def forward(augment: Any = augment) -> Any:
            return augment(images, masks)

        def both(augment: Any = augment) -> Any:
            return torch.autograd.grad(augment(leaf, masks)[0].sum(), leaf)

        line = f"{name:16}{1e3 * stopwatch.time(forward).median:10.3f}"
        with torch.enable_grad():
            line += f"{1e3 * stopwatch.time(both).median:10.3f}"
        if images.is_cuda:
            host = microseconds(lambda augment=augment: augment(*one))
            line += f"{host:8.0f}{launches(forward):10}{extra_bytes(forward) / 1e6:10.0f}"
        print(line, flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.augmentation", description=__doc__)
    parse.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parse.add_argument("--pipeline", choices=("all", "B"), default="all")
    parse.add_argument("--batch", type=int, help="default 128; of pipeline B 32")
    parse.add_argument("--size", type=int, help="default 256; of pipeline B 512")
    parse.add_argument("--threads", type=int, default=1, help="of torch on the CPU (default 1)")
    parse.add_argument("--seconds", type=float, default=0.3, help="time for one figure (default 0.3)")
    options = parse.parse_args(arguments)
    if options.batch is None:
        options.batch = 32 if options.pipeline == "B" else 128
    if options.size is None:
        options.size = 512 if options.pipeline == "B" else 256
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
    stopwatch = clock(device, options.seconds)
    bandwidth = stopwatch.copy_bandwidth()
    if options.pipeline == "B":
        measure_pipeline_b(images, stopwatch, bandwidth)
        return 0
    leaf, one = images.clone().requires_grad_(), images[:1].contiguous()
    pipelines_of = libraries()
    head = "".join(f"{name:>14}{'f+b':>9}{'host':>8}" for name in pipelines_of)
    print(f"{'ms':34}{'floor':>8}{head}")
    for name in pipelines_of["kvision"]:
        line = f"{name:34}"
        for library, pipelines in pipelines_of.items():
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
