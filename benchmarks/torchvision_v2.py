"""`python -m benchmarks.torchvision_v2`: kvision.tv beside torchvision.transforms.v2, one image on one CPU thread.

The first table has the times of both, in turns in one process: medians of the quickest calls of some rounds. `--device cuda`
prints rows of a batch of uint8 images in GPU memory instead: kvision.tv, which draws for each sample; v2 image by image, which
is how v2 draws for each sample, and the stack of its results; and v2 on the batch, which draws once. Wall times of a call until
the GPU has done it, medians of calls in turns. `--pil` prints how far v2's own PIL path is from its tensor path, and kvision.tv
from the same. Needs torchvision.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import PIL.Image
import torch
import torchvision
from torch import Tensor
from torchvision.transforms import InterpolationMode, v2

from benchmarks import machine
from benchmarks.case import photographs
from benchmarks.timing import launches
from kvision import tv

MEAN, STD = [0.485, 0.456, 0.406], [0.229, 0.224, 0.225]
CORNERS = [[0, 0], [499, 0], [499, 374], [0, 374]], [[20, 12], [460, 8], [480, 350], [5, 360]]
FLOAT = (torch.float32, True)
BILINEAR = InterpolationMode.BILINEAR  # torchvision 0.26 takes no names, kvision.tv both
BATCH = (128, 3, 256, 256)
BAR = 10.0  # v2 image by image over kvision.tv, on a GPU


def transforms(m: Any, side: int = 256) -> dict[str, Any]:
    """Transforms of a module, kvision.tv or v2; `side` is what `Resize` makes of the shorter one."""
    classification = [m.RandomResizedCrop(224), m.RandomHorizontalFlip(), m.ToDtype(*FLOAT), m.Normalize(MEAN, STD)]
    return {
        "RandomHorizontalFlip": m.RandomHorizontalFlip(1.0),
        "RandomCrop": m.RandomCrop(224),
        "CenterCrop": m.CenterCrop(224),
        "Resize": m.Resize(side),
        "RandomResizedCrop": m.RandomResizedCrop(224),
        "ColorJitter": m.ColorJitter(0.4, 0.4, 0.4, 0.1),
        "RandomGrayscale": m.RandomGrayscale(1.0),
        "GaussianBlur": m.GaussianBlur(5),
        "RandomAffine": m.RandomAffine(10, (0.1, 0.1), interpolation=BILINEAR),
        "RandomPerspective": m.RandomPerspective(p=1.0),
        "RandomErasing": m.RandomErasing(1.0),
        "RandAugment": m.RandAugment(),
        "classification": m.Compose(classification),
        "classification, policy, erasing": m.Compose(
            [*classification[:2], m.RandAugment(), *classification[2:], m.RandomErasing(0.1)]
        ),
        "classification, evaluation": m.Compose([m.Resize(side), m.CenterCrop(224), *classification[2:]]),
        "segmentation": m.Compose(
            [m.RandomResize(190, 750), m.RandomHorizontalFlip(), m.RandomCrop(180), *classification[2:]]
        ),
        "detection": m.Compose([m.RandomPhotometricDistort(), m.RandomHorizontalFlip(), m.ToDtype(*FLOAT)]),
    }


FUNCTIONS: dict[str, Callable[[Any, Any], Any]] = {
    "horizontal_flip, vertical_flip, crop, pad": lambda f, x: f.pad(f.crop(f.horizontal_flip(x), 3, 4, 50, 60), 4),
    "resize to half, bilinear": lambda f, x: f.resize(x, [187, 250]),
    "resize to half, bicubic": lambda f, x: f.resize(x, [187, 250], InterpolationMode.BICUBIC),
    "resize to half, nearest": lambda f, x: f.resize(x, [187, 250], InterpolationMode.NEAREST),
    "rotate by 30, nearest": lambda f, x: f.rotate(x, 30, fill=0),
    "rotate by 30, bilinear": lambda f, x: f.rotate(x, 30, BILINEAR, fill=0),
    "affine, bilinear": lambda f, x: f.affine(x, 10, [3, 4], 1.1, [2.0, 3.0], BILINEAR, fill=0),
    "perspective, bilinear": lambda f, x: f.perspective(x, *CORNERS, fill=0),
    "rgb_to_grayscale": lambda f, x: f.rgb_to_grayscale(x, 3),
    "adjust_brightness": lambda f, x: f.adjust_brightness(x, 1.3),
    "adjust_contrast": lambda f, x: f.adjust_contrast(x, 1.3),
    "adjust_saturation": lambda f, x: f.adjust_saturation(x, 1.3),
    "adjust_hue": lambda f, x: f.adjust_hue(x, 0.2),
    "adjust_sharpness": lambda f, x: f.adjust_sharpness(x, 2.0),
    "gaussian_blur": lambda f, x: f.gaussian_blur(x, [5, 5], [1.0, 1.0]),
    "posterize, solarize, invert": lambda f, x: f.posterize(f.solarize(f.invert(x), 100), 4),
    "autocontrast": lambda f, x: f.autocontrast(x),
    "equalize": lambda f, x: f.equalize(x),
}


def quickest(call: Callable[[], Any], calls: int) -> float:
    best = float("inf")
    for _ in range(calls):
        start = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - start)
    return best


def print_times(image: Tensor, rounds: int, calls: int) -> None:
    print("| transform | v2, ms | kvision.tv, ms | v2 / kvision.tv |\n| --- | --- | --- | --- |")
    theirs, ours = transforms(v2), transforms(tv)
    for name in ours:
        times: list[tuple[float, ...]] = []
        for i in range(rounds):
            pair = []
            for t in (theirs[name], ours[name]):
                torch.manual_seed(i)
                pair.append(quickest(lambda t=t: t(image), calls))  # type: ignore[misc]
            times.append(tuple(pair))
        a, b = (statistics.median(column) * 1e3 for column in zip(*times))
        print(f"| {name} | {a:.3f} | {b:.3f} | {a / b:.1f} |", flush=True)


def seconds_of(call: Callable[[], Any], device: torch.device) -> float:
    """Of one call, until its results are there."""
    start = time.perf_counter()
    call()
    if device.type == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter() - start


def print_batches(batch: Tensor, rounds: int, calls: int) -> None:
    device = batch.device
    print(f"# {machine.hardware(device)}, torch {torch.__version__}, torchvision {torchvision.__version__}")
    print(f"# uint8 {'x'.join(map(str, batch.shape))}, ms, wall times; v2 on a batch draws once a call")
    print("transform,kvision.tv,launches,v2 image by image,v2 on the batch,image by image / kvision.tv,bar")
    theirs, ours = transforms(v2, 232), transforms(tv, 232)
    for name in ours:
        v2_transform, transform = theirs[name], ours[name]
        contestants = (
            (calls, lambda t=transform: t(batch)),
            (1, lambda t=v2_transform: torch.stack([t(image) for image in batch])),
            (calls, lambda t=v2_transform: t(batch)),
        )
        seconds: list[list[float]] = [[] for _ in contestants]
        for i in range(rounds + 1):  # the first one warms up
            torch.manual_seed(i)
            for (repeats, call), own in zip(contestants, seconds):
                times = [seconds_of(call, device) for _ in range(repeats)]
                own.extend(times if i else ())
        ms = [statistics.median(own) * 1e3 for own in seconds]
        cell = f'"{name}"' if "," in name else name
        count = launches(contestants[0][1]) if device.type == "cuda" else ""
        print(f"{cell},{ms[0]:.3f},{count},{ms[1]:.1f},{ms[2]:.3f},{ms[1] / ms[0]:.1f},{BAR:.0f}", flush=True)


def as_tensor(x: Any) -> Tensor:
    if isinstance(x, Tensor):
        return x
    array = np.array(x)
    return torch.from_numpy(array[..., None] if array.ndim == 2 else array).permute(2, 0, 1)


def print_distances(image: Tensor) -> None:
    pil = PIL.Image.fromarray(image.permute(1, 2, 0).numpy())
    print("| function | v2 with PIL: share, most | kvision.tv: share, most |\n| --- | --- | --- |")
    for name, function in FUNCTIONS.items():
        expected = function(v2.functional, image).int()
        cells = []
        for result in (function(v2.functional, pil), function(tv.functional, image)):
            distance = (as_tensor(result).int() - expected).abs()
            cells.append(f"{(distance > 1).double().mean():.2%}, {distance.max()}")
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="cuda: a batch, not an image")
    parser.add_argument("--pil", action="store_true", help="distances, not times")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--calls", type=int, default=20)
    args = parser.parse_args()
    if args.device == "cuda":
        (batch,) = photographs(BATCH, torch.float32, torch.device("cuda"))
        return print_batches((255 * batch).round().to(torch.uint8), args.rounds, args.calls)
    torch.set_num_threads(1)
    image = (photographs((1, 3, 375, 500), torch.float32, torch.device("cpu"))[0][0] * 255).round().to(torch.uint8)
    print_distances(image) if args.pil else print_times(image, args.rounds, args.calls)


if __name__ == "__main__":
    main()
