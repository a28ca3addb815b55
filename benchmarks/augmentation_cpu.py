"""`python -m benchmarks.augmentation_cpu`: images a second of uint8 images on one CPU thread, against Albumentations.

Single augmentations, each of which always acts, and the pipeline of crop, flip, jitter and normalization to float32. kvision
gets a batch, and the same images one by one, as a worker of a data loader has them. Albumentations gets them one by one, as
(H, W, C) arrays. All three take turns; the figures are those of the quickest of many calls. Albumentations (AlbumentationsX) is
not among the dependencies of kvision: pip install albumentationsx.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

import kvision.augmentation as A
from benchmarks import machine
from benchmarks.case import photographs
from benchmarks.peers import set_threads
from benchmarks.timing import clock
from kvision import enhance

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class Pair(NamedTuple):
    """The same work in kvision, on a batch, and in Albumentations, on an array."""

    name: str
    ours: Callable[[int], Callable[[Tensor], Tensor]]  # of the size of the images
    theirs: Callable[[Any, int], Any]


def normalized(augment: Callable[[Tensor], Tensor]) -> Callable[[Tensor], Tensor]:
    """The same with normalized float32 results."""
    mean, std = (255 * torch.tensor(values) for values in (MEAN, STD))
    return lambda x: enhance.normalize(augment(x).float(), mean, std)


JITTER = {"brightness_range": (0.8, 1.2), "contrast_range": (0.8, 1.2), "saturation_range": (0.8, 1.2)}
PIPELINE = Pair(
    "A: crop, flip, jitter, normalize",
    lambda n: normalized(
        A.ImageSequential(A.RandomResizedCrop((n, n)), A.RandomHorizontalFlip(), A.ColorJitter(0.2, 0.2, 0.2, 0.1))
    ),
    lambda B, n: B.Compose(
        [
            B.RandomResizedCrop((n, n)),
            B.HorizontalFlip(),
            B.ColorJitter(**JITTER, hue_range=(-0.1, 0.1), p=1),
            B.Normalize(MEAN, STD),
        ]
    ),
)
PAIRS = [
    Pair("horizontal flip", lambda n: A.RandomHorizontalFlip(p=1.0), lambda B, n: B.HorizontalFlip(p=1)),
    Pair("rotation", lambda n: A.RandomRotation(30.0, p=1.0), lambda B, n: B.Rotate(angle_range=(-30, 30), p=1)),
    Pair(
        "affine",
        lambda n: A.RandomAffine(30.0, (0.1, 0.1), (0.8, 1.2), 10.0, p=1.0),
        lambda B, n: B.Affine(scale=(0.8, 1.2), translate_percent=(-0.1, 0.1), rotate=(-30, 30), shear=(-10, 10), p=1),
    ),
    Pair("perspective", lambda n: A.RandomPerspective(0.2, p=1.0), lambda B, n: B.Perspective((0.05, 0.1), p=1)),
    Pair(
        "crop",
        lambda n: A.RandomCrop((7 * n // 8, 7 * n // 8)),
        lambda B, n: B.RandomCrop(7 * n // 8, 7 * n // 8),
    ),
    Pair("resized crop", lambda n: A.RandomResizedCrop((n, n)), lambda B, n: B.RandomResizedCrop((n, n))),
    Pair("resize", lambda n: A.Resize((5 * n // 7, 5 * n // 7)), lambda B, n: B.Resize(5 * n // 7, 5 * n // 7)),
    Pair(
        "color jitter",
        lambda n: A.ColorJitter(0.2, 0.2, 0.2, 0.1),
        lambda B, n: B.ColorJitter(**JITTER, hue_range=(-0.1, 0.1), p=1),
    ),
    Pair(
        "gaussian blur 5x5",
        lambda n: A.RandomGaussianBlur((5, 5), (0.1, 2.0), p=1.0),
        lambda B, n: B.GaussianBlur(blur_range=(5, 5), sigma_range=(0.1, 2.0), p=1),
    ),
    Pair("grayscale", lambda n: A.RandomGrayscale(p=1.0), lambda B, n: B.ToGray(p=1)),
    Pair("normalize", lambda n: A.Normalize(MEAN, STD), lambda B, n: B.Normalize(MEAN, STD)),
    Pair("equalize", lambda n: A.RandomEqualize(p=1.0), lambda B, n: B.Equalize(p=1)),
    Pair("solarize", lambda n: A.RandomSolarize(0.1, 0.0, p=1.0), lambda B, n: B.Solarize((0.4, 0.6), p=1)),
    PIPELINE,
]


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.augmentation_cpu", description=__doc__)
    parse.add_argument("--batch", type=int, default=32)
    parse.add_argument("--size", type=int, default=224)
    parse.add_argument("--seconds", type=float, default=3.0, help="time for one figure (default 3)")
    options = parse.parse_args(arguments)
    warnings.simplefilter("ignore")
    os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")
    try:
        import albumentations
    except ImportError:
        print("benchmarks.augmentation_cpu needs Albumentations: pip install albumentationsx", file=sys.stderr)
        return 1
    set_threads(1)
    about = machine.describe(torch.device("cpu"), ["opencv"])
    print(f"{about['hardware']}  threads {about['threads']}  {about['date']}  kvision {about['commit']}", end="  ")
    print(
        f"torch {about['torch']}  albumentations {albumentations.__version__}  {about['peers']}\n$ {about['command']}"
    )
    print(f"uint8 {options.batch}x3x{options.size}x{options.size}, images a second\n")
    (unit,) = photographs((options.batch, 3, options.size, options.size), torch.float32, torch.device("cpu"))
    images = (255 * unit).round().byte()
    singles = [image[None] for image in images]
    arrays = [np.ascontiguousarray(image.permute(1, 2, 0).numpy()) for image in images]
    stopwatch = clock(torch.device("cpu"), options.seconds)
    print(f"{'':34}{'kvision':>10}{'one by one':>12}{'Albumentations':>16}{'batch':>8}{'one':>7}  times as fast")
    faster = []
    for pair in PAIRS:
        batched, single, theirs = (
            pair.ours(options.size),
            pair.ours(options.size),
            pair.theirs(albumentations, options.size),
        )

        def one_by_one(single: Any = single) -> None:
            for image in singles:
                single(image)

        def peer(theirs: Any = theirs) -> None:
            for array in arrays:
                theirs(image=array)

        with torch.no_grad():
            timings = stopwatch.race([lambda batched=batched: batched(images), one_by_one, peer])
        rates = [options.batch / stopwatch.value(timing) for timing in timings]
        ratios = [rate / rates[2] for rate in rates[:2]]
        faster.append(ratios[0] >= 1)
        print(
            f"{pair.name:34}{rates[0]:10.0f}{rates[1]:12.0f}{rates[2]:16.0f}{ratios[0]:8.2f}{ratios[1]:7.2f}",
            flush=True,
        )
    print(f"\nbatches are at least as fast on {sum(faster[:-1])} of {len(faster) - 1} single augmentations")
    return 0


if __name__ == "__main__":
    sys.exit(main())
