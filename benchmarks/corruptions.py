"""`python -m benchmarks.corruptions [NAMES]`: sizes, crops, occlusion, corruption and distortion of batches, next to their floors.

Milliseconds of a batch of 3 x 224 x 224 pixels, float32 and uint8, and in floors: as many pixels of the images read once as the
results have, or all, and the results written once. The bar on an NVIDIA H200 is 2.5 floors; more has an exclamation mark, or the
reason why it needs more. On a GPU launches are counted, too. `--csv FILE` also writes the rows there.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import kvision.augmentation as A
from benchmarks import machine, results
from benchmarks.case import photographs
from benchmarks.peers import set_threads
from benchmarks.sample_calls.augmentations import CORRUPTION, DISTORTION, OCCLUSION
from benchmarks.timing import clock, launches

BAR = 2.5  # floors
SIDE = 224
CPU_BATCH, GPU_BATCH = 4, 128
# Why a class needs more than the bar.
BLOCKS = "a warp sums the pixels of a row of blocks, and shows it"
GLASS = "two blurs, and a gather by moves that are drawn for each pixel"
SPATTER = "a blur of drawn noise, distances to outlines, a histogram, a relief and its maximum"
DRAWS = "bytes: draws are a launch of their own"
NOISE = "bytes: a random number a value, as for floats"
FROST = "bytes: the window of a sample takes eight launches"
FOG = "a fractal map in float64, step by step, its range and the brightest value"
REASONS = {
    "CoarseDropout": DRAWS,
    "FrequencyMasking": DRAWS,
    "GridMask": "bytes: lines in float64 at each pixel",
    "PixelDropout": NOISE,
    "TimeMasking": DRAWS,
    "XYMasking": DRAWS,
    "MultiplicativeNoise": NOISE,
    "RandomFrost": FROST,
    "SpeckleNoise": NOISE,
    "ChromaticAberration": "maps of three planes are written and read again, and planes sampled one by one",
    "Defocus": "a window of 21 x 21 taps",
    "Downscale": BLOCKS,
    "GlassBlur": GLASS,
    "GridDistortion": "a map is written and read again",
    "GridDropout": "thousands of holes a sample are placed, and looked at by each tile",
    "ISONoise": "lightness is measured first; HLS and back, a Poisson quantile and a normal number a pixel",
    "OpticalDistortion": "a map is written and read again",
    "PiecewiseAffine": "a map is written and read again",
    "RandomFog": FOG,
    "RandomRain": "1000 to 2000 lines a sample, pixel by pixel, make a mask that is read again",
    "RingingOvershoot": "a window of 15 x 15 taps",
    "ShotNoise": "a Poisson quantile a value",
    "MaskDropout": "connected components, and a search for the ranks that are dropped",
    "Spatter": SPATTER,
    "Swirl": "a map is written and read again",
    "ZoomBlur": "up to 30 reads a pixel",
    "gaussian_noise": NOISE,
    "impulse_noise": NOISE,
    "speckle_noise": NOISE,
    "frost": FROST,
    "contrast": "bytes: means are measured before",
    "gaussian_blur": "a window of 25 + 25 taps",
    "shot_noise": "a Poisson quantile a value",
    "defocus_blur": "a window of 13 x 13 taps",
    "glass_blur": GLASS,
    "motion_blur": "31 reads a pixel",
    "zoom_blur": "10 reads a pixel",
    "snow": "25 reads a pixel; a map of noise is enlarged",
    "spatter": SPATTER,
    "fog": FOG,
    "elastic_transform": "a map of blurred noise",
    "jpeg_compression": "a differentiable codec",
    "pixelate": BLOCKS,
    "brightness": "HSV and back",
    "saturate": "HSV and back",
}


def augmentations() -> Iterator[tuple[str, Callable[..., Any]]]:
    """The classes by name, and the common corruptions in severity 3, which all samples get."""
    yield from _sizes(5 * SIDE // 7)
    for case in (*OCCLUSION, *CORRUPTION, *DISTORTION):
        if case.name != "CommonCorruption":
            arguments = case.args if case.large is None else case.large
            augment = getattr(A, case.name)(*arguments, **case.kwargs, p=1.0)
            yield case.name, partial(_with_masks, augment) if case.name == "MaskDropout" else augment
    yield "RandomRain", A.RandomRain(p=1.0)
    for name in A.CommonCorruption.NAMES:
        texture = torch.rand(3, 2 * SIDE, 2 * SIDE) if name == "frost" else None
        yield name, A.CommonCorruption(name, 3, texture)


def _sizes(side: int) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Sizes, crops and symmetries, to a side where that is free."""
    yield "Pad", A.Pad(SIDE // 14, p=1.0)
    yield "PadIfNeeded", A.PadIfNeeded(2 * SIDE - side, 2 * SIDE - side, position="random", p=1.0)
    yield "SmallestMaxSize", A.SmallestMaxSize(side, p=1.0)
    yield "LongestMaxSize", A.LongestMaxSize(side, p=1.0)
    yield "RandomScale", A.RandomScale((0.9, 0.9), p=1.0)
    yield "RandomZoomOut", A.RandomZoomOut(p=1.0)
    yield "D4", A.D4(p=1.0)
    yield "Transpose", A.Transpose(p=1.0)
    yield "RandomIoUCrop", partial(_with_boxes, A.RandomIoUCrop(size=(side, side), p=1.0))
    yield "RandomSizedBBoxSafeCrop", partial(_with_boxes, A.RandomSizedBBoxSafeCrop(side, side, p=1.0))
    yield "AtLeastOneBBoxRandomCrop", partial(_with_boxes, A.AtLeastOneBBoxRandomCrop(side, side, p=1.0))
    yield "RandomCropNearBBox", partial(_with_boxes, A.RandomCropNearBBox(size=(side, side), p=1.0))
    yield "CropNonEmptyMaskIfExists", partial(_with_masks, A.CropNonEmptyMaskIfExists(side, side, p=1.0))


def _with_boxes(augment: Callable[..., Any], images: Tensor) -> Any:
    return augment(images, boxes=_boxes(images.shape[0], images.device))


@cache
def _boxes(batch: int, device: torch.device) -> Tensor:
    """Three boxes of each image."""
    corners = torch.rand(batch, 3, 2, generator=torch.Generator().manual_seed(0)) * 0.6 * SIDE
    return torch.cat([corners, corners + 0.3 * SIDE], -1).to(device)


def _with_masks(augment: Callable[..., Any], images: Tensor) -> Any:
    """A call with masks of 32 squares of two values."""
    return augment(images, masks=_squares(images.shape[0], images.device))


@cache
def _squares(batch: int, device: torch.device) -> Tensor:
    at = torch.arange(SIDE, device=device) // (SIDE // 8)
    squares = (at[:, None] + at) % 2 * (1 + at % 2)
    return squares.expand(batch, 1, -1, -1).contiguous()


def figure(augment: Callable[..., Any], images: Tensor, stopwatch: Any, bandwidth: float) -> tuple[float, float]:
    """Milliseconds of a call, and floors."""
    result = augment(images)
    written = (result[0] if isinstance(result, tuple) else result).nbytes
    timing = stopwatch.time(lambda: augment(images))
    seconds = stopwatch.value(timing)
    return 1e3 * seconds, seconds * bandwidth / (min(images.nbytes, written) + written)


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.corruptions", description=__doc__)
    parse.add_argument("names", nargs="*", metavar="NAME", help="parts of the names to run; default: all")
    parse.add_argument("--device", choices=("cpu", "cuda"), default="cuda" if torch.cuda.is_available() else "cpu")
    parse.add_argument("--seconds", type=float, default=0.1, help="time for one figure (default 0.1)")
    parse.add_argument("--csv", type=Path, help="file for the rows")
    parse.add_argument("--threads", type=int, default=1, help="of torch on the CPU (default 1)")
    options = parse.parse_args(arguments)
    set_threads(options.threads)
    device = torch.device(options.device)
    stopwatch, on_gpu = clock(device, options.seconds), device.type == "cuda"
    (images,) = photographs((GPU_BATCH if on_gpu else CPU_BATCH, 3, SIDE, SIDE), torch.float32, device)
    inputs = images, (255 * images).round().to(torch.uint8)
    bandwidth = stopwatch.copy_bandwidth()
    about = machine.describe(device, [])
    copies = [1e3 * stopwatch.value(stopwatch.time(x.clone)) for x in inputs]
    print(f"{about['hardware']} / {about['cpu']}  threads {about['threads']}  {about['date']}  torch {about['torch']}")
    print(f"{len(images)}x3x{SIDE}x{SIDE}, a copy of float32 {copies[0]:.3f} ms, of uint8 {copies[1]:.3f} ms")
    print(f"{'':26}{'float32 ms':>12}{'floors':>9}{'uint8 ms':>12}{'floors':>9}{'launches':>10}")
    rows: list[dict[str, str]] = []
    for name, augment in augmentations():
        if options.names and not any(part in name for part in options.names):
            continue
        row, is_missed = {"augmentation": name}, False
        for x in inputs:
            milliseconds, floors = figure(augment, x, stopwatch, bandwidth)
            is_missed = is_missed or floors > BAR
            dtype = str(x.dtype).removeprefix("torch.")
            row |= {f"{dtype} ms": f"{milliseconds:.3f}", f"{dtype} floors": f"{floors:.1f}"}
        row["launches"] = f"{launches(lambda augment=augment: augment(images)):.0f}" if on_gpu else "-"
        row["why more than 2.5"] = REASONS.get(name, "!") if is_missed else ""
        rows.append(row)
        first, *cells, reason = row.values()
        line = f"{first:26}{''.join(f'{cell:>{width}}' for cell, width in zip(cells, (12, 9, 12, 9, 10)))}  {reason}"
        print(line.rstrip(), flush=True)
    if options.csv is not None:
        where = f"{about['hardware']}, torch {about['torch']}: `python -m benchmarks.corruptions`"
        size = f"{len(images)}x3x{SIDE}x{SIDE}; floors: pixels read once and results written once"
        results.write(options.csv, [f"# {where}", f"# {size}"], rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
