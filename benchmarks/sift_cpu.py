"""`python -m benchmarks.sift_cpu`: SIFTFeature on the CPU, against cv2.SIFT on one thread, and batches on several.

Photographs of scikit-image, and with --data FOLDER those of FOLDER/homography/*/img1.png, gray and of 640x480. OpenCV leaves
out key points of little contrast and describes fewer than SIFTFeature, which fills its slots. Calls take turns; the figures are
the quickest, which other work on the machine disturbs least.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

import kvision as K
from benchmarks import machine
from benchmarks.features import PHOTOGRAPHS, SEQUENCES
from benchmarks.peers import set_threads
from benchmarks.uint8_cpu import quickest
from kvision import _C

SIZE = (480, 640)
BATCHES = (1, 2, 4, 8)


def pictures(folder: Path | None) -> Iterator[tuple[str, np.ndarray]]:
    """Names, and gray images of SIZE and uint8."""
    from skimage import data

    for name in (*PHOTOGRAPHS, "camera"):
        yield name, resized(getattr(data, name)())
    if folder is None:
        return
    for name, _ in SEQUENCES:
        image = cv2.imread(str(folder / "homography" / name / "img1.png"), cv2.IMREAD_GRAYSCALE)
        if image is not None:
            yield name, resized(image)


def resized(image: np.ndarray) -> np.ndarray:
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return cv2.resize(gray, SIZE[::-1], interpolation=cv2.INTER_AREA)


def tensor(image: np.ndarray) -> Tensor:
    return torch.from_numpy(image)[None, None].float() / 255


def on_threads(threads: int, feature: torch.nn.Module, x: Tensor) -> None:
    torch.set_num_threads(threads)
    feature(x)


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.sift_cpu", description=__doc__)
    parse.add_argument("--data", type=Path, help="folder with homography/")
    parse.add_argument("--features", type=int, default=2000, help="of each image (default 2000)")
    parse.add_argument("--threads", type=int, default=2, help="of the batches (default 2)")
    parse.add_argument("--seconds", type=float, default=2.0, help="time for one row (default 2)")
    options = parse.parse_args(arguments)
    set_threads(1)
    about = machine.describe(torch.device("cpu"), ["opencv"])
    print(f"{about['hardware']}  {about['date']}  kvision {about['commit']}  torch {about['torch']}  {about['peers']}")
    print(
        f"$ {about['command']}\n{_C.active_isa()}, ms (minimum), {options.features} features of {SIZE[1]}x{SIZE[0]}\n"
    )
    feature, peer = K.feature.SIFTFeature(options.features), cv2.SIFT_create(options.features)
    images = dict(pictures(options.data))
    with torch.no_grad():
        print(f"{'one thread':12}{'kvision':>10}{'features':>10}{'OpenCV':>10}{'features':>10}{'ratio':>8}")
        for name, image in images.items():
            x = tensor(image)
            calls = [partial(feature, x), partial(peer.detectAndCompute, image, None)]
            ours, theirs = quickest(calls, options.seconds)
            counts = int((feature(x)[1] > 0).sum()), len(peer.detect(image, None))
            print(f"{name:12}{ours:10.1f}{counts[0]:10}{theirs:10.1f}{counts[1]:10}{ours / theirs:8.2f}", flush=True)
        print(f"\n{'batch':12}{'1 thread':>10}{f'{options.threads} threads':>12}{'speed-up':>10}")
        all_images = torch.cat([tensor(image) for image in images.values()])
        for batch in BATCHES:
            x = all_images[torch.arange(batch) % len(all_images)]
            one, many = quickest([partial(on_threads, n, feature, x) for n in (1, options.threads)], options.seconds)
            print(f"{batch:<12}{one:10.1f}{many:12.1f}{one / many:10.2f}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
