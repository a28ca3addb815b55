"""`python -m benchmarks.uint8_cpu`: uint8 images on one CPU thread, against OpenCV, and torch where OpenCV lacks the function.

One color image, planar and in channels_last; OpenCV's are interleaved, and it writes into memory allocated beforehand. Both
take turns in one process. The figures are the quickest of many calls, which other work on the machine disturbs least.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

import kvision as K
from benchmarks import machine
from benchmarks.case import photographs
from benchmarks.peers import set_threads

SIZE = (480, 640)
HALF_A_DISK = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
MATRIX = torch.tensor([[[0.9, 0.1, 10.0], [-0.1, 0.95, 20.0]]])
LEVELS = np.arange(256, dtype=np.uint8)


class Pair(NamedTuple):
    """The same work in kvision, on an image (1, C, H, W), and by the peer on an array (H, W, C), into another array.

    Without `array` the peer takes the tensor, in the layout that kvision gets.
    """

    name: str
    ours: Callable[[Tensor], Any]
    theirs: Callable[..., Any]
    gray: bool = False
    result: tuple[int, ...] = (*SIZE, 3)
    array: bool = True


PAIRS = [
    Pair("gray", K.color.rgb_to_grayscale, lambda a, y: cv2.cvtColor(a, cv2.COLOR_RGB2GRAY, y), result=SIZE),
    Pair("hsv", lambda x: K.color.rgb_to_hsv(x, opencv=True), lambda a, y: cv2.cvtColor(a, cv2.COLOR_RGB2HSV, y)),
    Pair("box 5x5", lambda x: K.filters.box_blur(x, 5), lambda a, y: cv2.blur(a, (5, 5), y)),
    Pair("median 3x3", lambda x: K.filters.median_blur(x, 3), lambda a, y: cv2.medianBlur(a, 3, y)),
    Pair(
        "resize to 224",
        lambda x: K.geometry.resize(x, (224, 224)),
        lambda a, y: cv2.resize(a, (224, 224), y),
        result=(224, 224, 3),
    ),
    Pair(
        "warp_affine",
        lambda x: K.geometry.warp_affine(x, MATRIX, SIZE),
        lambda a, y: cv2.warpAffine(a, MATRIX[0].numpy(), SIZE[::-1], y),
    ),
    Pair("hflip", K.geometry.hflip, lambda a, y: cv2.flip(a, 1, y)),
    Pair("dilation 3x3", lambda x: K.morphology.dilation(x, ones(3)), lambda a, y: cv2.dilate(a, array(3), y)),
    Pair("dilation 15x15", lambda x: K.morphology.dilation(x, ones(15)), lambda a, y: cv2.dilate(a, array(15), y)),
    Pair(
        "erosion, ellipse 7x7",
        lambda x: K.morphology.erosion(x, torch.from_numpy(HALF_A_DISK)),
        lambda a, y: cv2.erode(a, HALF_A_DISK, y),
    ),
    Pair(
        "gradient 3x3",
        lambda x: K.morphology.gradient(x, ones(3)),
        lambda a, y: cv2.morphologyEx(a, cv2.MORPH_GRADIENT, array(3), y),
    ),
    Pair(
        "equalize, one channel",
        lambda x: K.enhance.equalize(x, opencv=True),
        lambda a, y: cv2.equalizeHist(a, y),
        gray=True,
        result=SIZE,
    ),
    Pair(
        "CLAHE 8x8, one channel",
        lambda x: K.enhance.equalize_clahe(x, 2.0, opencv=True),
        lambda a, y: cv2.createCLAHE(2.0, (8, 8)).apply(a, y),
        gray=True,
        result=SIZE,
    ),
    Pair("contrast", lambda x: K.enhance.adjust_contrast(x, 1.2), lambda a, y: cv2.convertScaleAbs(a, y, 1.2)),
    Pair("gamma", lambda x: K.enhance.adjust_gamma(x, 0.7), lambda a, y: cv2.LUT(a, LEVELS, y)),
    Pair(
        "antialiased to 224 (torch)",
        lambda x: K.geometry.resize(x, (224, 224), antialias=True),
        lambda x: torch.nn.functional.interpolate(x, (224, 224), mode="bilinear", antialias=True),
        array=False,
    ),
]


def ones(n: int) -> Tensor:
    return torch.ones(n, n)


def array(n: int) -> np.ndarray:
    return np.ones((n, n), np.uint8)


def quickest(calls: Sequence[Callable[[], Any]], seconds: float) -> list[float]:
    """The minimum time of each call, in milliseconds, while they take turns."""
    minima = [float("inf")] * len(calls)
    end, turns = time.perf_counter() + seconds, 0
    while (start := time.perf_counter()) < end or turns < 10:
        turns += 1
        for i, call in enumerate(calls):
            call()
            now = time.perf_counter()
            minima[i], start = min(minima[i], 1e3 * (now - start)), now
    return minima


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.uint8_cpu", description=__doc__)
    parse.add_argument("--seconds", type=float, default=1.0, help="time for one row and layout (default 1)")
    options = parse.parse_args(arguments)
    set_threads(1)
    about = machine.describe(torch.device("cpu"), ["opencv"])
    print(f"{about['hardware']}  threads {about['threads']}  {about['date']}  kvision {about['commit']}", end="  ")
    print(f"torch {about['torch']}  {about['peers']}\n$ {about['command']}")
    print(f"uint8 1x3x{SIZE[0]}x{SIZE[1]}, milliseconds (minimum), and kvision's time over the peer's\n")
    (unit,) = photographs((1, 3, *SIZE), torch.float32, torch.device("cpu"))
    image = (255 * unit).round().byte()
    print(f"{'':28}{'planar':>9}{'peer':>9}{'ratio':>7}{'channels_last':>16}{'peer':>9}{'ratio':>7}")
    for pair in PAIRS:
        line = f"{pair.name:28}"
        for layout in (torch.contiguous_format, torch.channels_last):
            x = (image[:, :1] if pair.gray else image).contiguous(memory_format=layout)
            a = np.ascontiguousarray(x[0].permute(1, 2, 0).squeeze(-1).numpy())
            y = np.empty(pair.result, np.uint8)
            peer = partial(pair.theirs, a, y) if pair.array else partial(pair.theirs, x)
            ours, theirs = quickest([partial(pair.ours, x), peer], options.seconds)
            width = 9 if layout == torch.contiguous_format else 16
            line += f"{ours:{width}.4f}{theirs:9.4f}{ours / theirs:7.2f}"
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
