"""`python -m benchmarks.torchvision_v2`: kvision.tv beside torchvision.transforms.v2, one image on one CPU thread.

The first table has the times of both, in turns in one process: medians of the quickest calls of some rounds. `--pil` prints how
far v2's own PIL path is from its tensor path, and kvision.tv from the same. Needs torchvision.
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
from torch import Tensor
from torchvision.transforms import v2

from benchmarks.case import photographs
from kvision import tv

MEAN, STD = [0.485, 0.456, 0.406], [0.229, 0.224, 0.225]
CORNERS = [[0, 0], [499, 0], [499, 374], [0, 374]], [[20, 12], [460, 8], [480, 350], [5, 360]]
FLOAT = (torch.float32, True)


def transforms(m: Any) -> dict[str, Any]:
    """Transforms of a module, kvision.tv or v2."""
    classification = [m.RandomResizedCrop(224), m.RandomHorizontalFlip(), m.ToDtype(*FLOAT), m.Normalize(MEAN, STD)]
    return {
        "RandomHorizontalFlip": m.RandomHorizontalFlip(1.0),
        "RandomCrop": m.RandomCrop(224),
        "CenterCrop": m.CenterCrop(224),
        "Resize": m.Resize(256),
        "RandomResizedCrop": m.RandomResizedCrop(224),
        "ColorJitter": m.ColorJitter(0.4, 0.4, 0.4, 0.1),
        "RandomGrayscale": m.RandomGrayscale(1.0),
        "GaussianBlur": m.GaussianBlur(5),
        "RandomAffine": m.RandomAffine(10, (0.1, 0.1), interpolation="bilinear"),
        "RandomPerspective": m.RandomPerspective(p=1.0),
        "RandomErasing": m.RandomErasing(1.0),
        "RandAugment": m.RandAugment(),
        "classification": m.Compose(classification),
        "classification, evaluation": m.Compose([m.Resize(256), m.CenterCrop(224), *classification[2:]]),
        "segmentation": m.Compose(
            [m.RandomResize(190, 750), m.RandomHorizontalFlip(), m.RandomCrop(180), *classification[2:]]
        ),
        "detection": m.Compose([m.RandomPhotometricDistort(), m.RandomHorizontalFlip(), m.ToDtype(*FLOAT)]),
    }


FUNCTIONS: dict[str, Callable[[Any, Any], Any]] = {
    "horizontal_flip, vertical_flip, crop, pad": lambda f, x: f.pad(f.crop(f.horizontal_flip(x), 3, 4, 50, 60), 4),
    "resize to half, bilinear": lambda f, x: f.resize(x, [187, 250]),
    "resize to half, bicubic": lambda f, x: f.resize(x, [187, 250], "bicubic"),
    "resize to half, nearest": lambda f, x: f.resize(x, [187, 250], "nearest"),
    "rotate by 30, nearest": lambda f, x: f.rotate(x, 30, fill=0),
    "rotate by 30, bilinear": lambda f, x: f.rotate(x, 30, "bilinear", fill=0),
    "affine, bilinear": lambda f, x: f.affine(x, 10, [3, 4], 1.1, [2.0, 3.0], "bilinear", fill=0),
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
    parser.add_argument("--pil", action="store_true", help="distances, not times")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--calls", type=int, default=20)
    args = parser.parse_args()
    torch.set_num_threads(1)
    image = (photographs((1, 3, 375, 500), torch.float32, torch.device("cpu"))[0][0] * 255).round().to(torch.uint8)
    print_distances(image) if args.pil else print_times(image, args.rounds, args.calls)


if __name__ == "__main__":
    main()
