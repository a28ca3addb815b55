"""`python -m benchmarks.augmentation_bars [NAMES]`: the pipelines of augmentation next to their bars, on one GPU.

Milliseconds of the device for a batch, forward and forward + backward of a `sum()`. Microseconds of the host for one image and for
the batch, parameters included. Launches, and kilobytes of memory beyond the results, of a forward call. Bars are for an NVIDIA
H200; those of choices (`OneOf`) follow from the times of their children in the same run. What misses its bar has an exclamation
mark.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

import kvision.augmentation as A
from benchmarks import kernels, machine
from benchmarks.augmentation import JITTER, MEAN, STD, pipeline_b
from benchmarks.case import photographs
from benchmarks.host_time import microseconds
from benchmarks.timing import Clock, clock, extra_bytes, launches
from kvision._modes import INTERPOLATION
from kvision.geometry.transform.resize_windows import resized_windows

MOST_LAUNCHES = 4
CROP = 7 / 8  # of a side


class Pipeline(NamedTuple):
    """A pipeline, the size of its images, and its bars, None for none; host times are those of one image and of the batch."""

    name: str
    make: Callable[[int], Callable[..., Any]]  # of the side of the images
    size: tuple[int, ...]
    forward: float | None = None
    both: float | None = None
    host: float | None = None
    stored: torch.dtype = torch.float32
    has_masks: bool = False
    differentiable: bool = True
    # Of a choice: its children. The bar is `factor` times the mean of their times for the batch, or the sum for their shares of it.
    children: Callable[[], Sequence[torch.nn.Module]] | None = None
    factor: float = 1.0
    of_shares: bool = False


def pipeline_a(side: int, *color: torch.nn.Module, antialias: bool = False, **options: Any) -> A.ImageSequential:
    crop = round(CROP * side)
    return A.ImageSequential(
        A.RandomResizedCrop((crop, crop), antialias=antialias),
        A.RandomHorizontalFlip(),
        *(color or (A.ColorJitter(*JITTER),)),
        A.Normalize(MEAN, STD),
        **options,
    )


def without_contrast(side: int) -> A.ImageSequential:
    brightness, _, saturation, hue = JITTER
    return pipeline_a(
        side,
        A.RandomBrightness((1 - brightness, 1 + brightness), p=1.0),
        A.RandomSaturation((1 - saturation, 1 + saturation), p=1.0),
        A.RandomHue((-hue, hue), p=1.0),
    )


def to_halves(side: int) -> A.ImageSequential:
    return pipeline_a(side, output_dtype=torch.float16, memory_format=torch.channels_last)


def of_videos(side: int) -> A.VideoSequential:
    return A.VideoSequential(*pipeline_a(side).children(), same_on_frame=True)


class AntialiasedCrop:
    """The resampling of pipeline A's crop, antialiased, without its draws: the windows of a batch are drawn once."""

    def __init__(self, side: int) -> None:
        self.size = round(CROP * side)
        self.crop = A.RandomResizedCrop((self.size, self.size), antialias=True)
        self.matrices: dict[int, Tensor] = {}

    def __call__(self, x: Tensor) -> Tensor:
        if len(x) not in self.matrices:
            self.crop(x.detach())
            self.matrices[len(x)] = self.crop.transform_matrix.to(x.device, torch.float32)
        size, filter = [self.size, self.size], INTERPOLATION["bilinear"]
        resized: Tensor = resized_windows(x, self.matrices[len(x)], size, filter, True)
        return resized


def color_children() -> list[torch.nn.Module]:
    return [
        A.RandomBrightness((0.8, 1.2), p=1.0),
        A.RandomSaturation((0.8, 1.2), p=1.0),
        A.RandomHue((-0.1, 0.1), p=1.0),
        A.RandomGamma((0.8, 1.2), p=1.0),
        A.RandomInvert(p=1.0),
    ]


def warp_children() -> list[torch.nn.Module]:
    return [
        A.RandomHorizontalFlip(p=1.0),
        A.RandomAffine(30.0, (0.1, 0.1), (0.8, 1.2), 10.0, p=1.0),
        A.RandomPerspective(0.5, p=1.0),
    ]


def mixed_children() -> list[torch.nn.Module]:
    return [
        A.RandomGaussianBlur((5, 5), (0.5, 2.0), p=1.0),
        A.RandomElasticTransform((63, 63), (16.0, 16.0), p=1.0),
        A.RandomEqualize(p=1.0),
        A.RandomJPEG((20.0, 60.0), p=1.0),
    ]


def mosaic_of_detection(side: int) -> A.ImageSequential:
    return A.ImageSequential(
        A.RandomMosaic(p=1.0), A.RandomPerspective(0.5, p=1.0), A.ColorJiggle(0.0, 0.0, 0.5, 0.1, p=1.0)
    )


MIXES = (A.RandomCutMixV2, A.RandomMixUpV2, A.RandomJigsaw, A.RandomMosaic)
LARGE, USUAL = (128, 3, 256, 256), (128, 3, 224, 224)
PIPELINES = [
    Pipeline("A", pipeline_a, LARGE, 0.10, 0.25, 60),
    Pipeline("A without contrast", without_contrast, LARGE, 0.06),
    Pipeline("A antialiased", lambda side: pipeline_a(side, antialias=True), LARGE, 0.13),
    # Of floors of 0.031, 0.015 and 0.008 ms: the windows, 0.53 of the images on average, and the results; 0.072 with backward.
    Pipeline("crop antialiased", AntialiasedCrop, LARGE, 0.049, 0.144),
    Pipeline("crop antialiased f16", AntialiasedCrop, LARGE, 0.031, stored=torch.float16),
    Pipeline("crop antialiased u8", AntialiasedCrop, LARGE, 0.023, stored=torch.uint8, differentiable=False),
    Pipeline("A uint8 to half", to_halves, LARGE, 0.075, stored=torch.uint8, differentiable=False),
    Pipeline(
        "B once", lambda side: pipeline_b(A, side, resample="once"), (32, 3, 512, 512), 0.45, host=120, has_masks=True
    ),
    Pipeline("B each", lambda side: pipeline_b(A, side), (32, 3, 512, 512), has_masks=True),
    Pipeline("C", lambda side: A.RandomAffine(30.0, (0.1, 0.1), (0.8, 1.2), 10.0, p=1.0), USUAL, 0.065, host=35),
    Pipeline("D", lambda side: A.ColorJitter(*JITTER), USUAL, 0.085, host=35),
    Pipeline("AutoAugment", lambda side: A.auto.AutoAugment(), USUAL, 0.5),
    Pipeline("RandAugment(2, 9)", lambda side: A.auto.RandAugment(2, 9), USUAL, 0.5),
    Pipeline("OneOf 5 colors", lambda side: A.OneOf(color_children()), USUAL, children=color_children, factor=1.3),
    Pipeline("OneOf 3 warps", lambda side: A.OneOf(warp_children()), USUAL, 0.12, children=warp_children),
    Pipeline(
        "OneOf 4 others",
        lambda side: A.OneOf(mixed_children()),
        USUAL,
        children=mixed_children,
        factor=1.2,
        of_shares=True,
    ),
    Pipeline("mosaic, warp, HSV", mosaic_of_detection, (32, 3, 640, 640), 0.25),
    *(Pipeline(mix.__name__, lambda side, mix=mix: mix(p=1.0), LARGE, 0.12, host=80) for mix in MIXES),
    # Of a floor of 0.091 ms: the images and the views.
    Pipeline("MultiCrop", lambda side: A.MultiCrop(), LARGE, 0.137, differentiable=False),
    Pipeline("video", of_videos, (8, 16, 3, 256, 256), 0.25),
]


def inputs_of(pipeline: Pipeline, device: torch.device) -> list[Tensor]:
    (images,) = photographs((pipeline.size[0], *pipeline.size[-3:]), torch.float32, device)
    if len(pipeline.size) == 5:
        images = images[:, None].expand(pipeline.size).contiguous()
    images = (255 * images).to(torch.uint8) if pipeline.stored == torch.uint8 else images.to(pipeline.stored)
    return [images, (images[:, :1] > 0.5).float()] if pipeline.has_masks else [images]


def checked(measured: float, bar: float | None, digits: int) -> str:
    """A figure and its bar."""
    if bar is None:
        return f"{measured:.{digits}f}"
    return f"{measured:.{digits}f}{'!' if measured > bar else ''} ({bar:g})"


def bar_of_children(pipeline: Pipeline, images: Tensor, stopwatch: Clock) -> float:
    """The bar of a choice in ms, by the times of its children in the same run."""
    assert pipeline.children is not None
    children = pipeline.children()
    part = images[: len(images) // len(children)] if pipeline.of_shares else images
    total = sum(1e3 * stopwatch.time(lambda child=child: child(part)).median for child in children)  # type: ignore[misc]
    return pipeline.factor * (total if pipeline.of_shares else total / len(children))


def row(pipeline: Pipeline, device: torch.device, seconds: float) -> str:
    augment, inputs = pipeline.make(pipeline.size[-1]), inputs_of(pipeline, device)
    one = [x[:1].contiguous() for x in inputs]
    leaf = inputs[0].clone().requires_grad_() if pipeline.differentiable else None

    def forward() -> Any:
        return augment(*inputs)

    def both() -> Any:
        result = augment(leaf, *inputs[1:])
        return torch.autograd.grad((result[0] if pipeline.has_masks else result).sum(), leaf)

    stopwatch = clock(device, seconds)
    bar = pipeline.forward
    if bar is None and pipeline.children is not None:
        bar = bar_of_children(pipeline, inputs[0], stopwatch)
    cells = [checked(1e3 * stopwatch.time(forward).median, bar, 3)]
    with torch.enable_grad():
        cells.append("-" if leaf is None else checked(1e3 * stopwatch.time(both).median, pipeline.both, 3))
    if device.type == "cuda":
        hosts = (microseconds(lambda: augment(*one)), microseconds(forward))
        cells += [checked(host, pipeline.host, 0) for host in hosts]
        cells += [checked(launches(forward), MOST_LAUNCHES if pipeline.name == "A" else None, 0)]
        cells += [f"{extra_bytes(forward) / 1e3:.0f}"]
    else:
        cells += ["-"] * 4
    size = "x".join(map(str, pipeline.size))
    return f"{pipeline.name:20}{size:>16}" + "".join(f"{cell:>16}" for cell in cells)


def call_watched(pipeline: Pipeline, device: torch.device) -> None:
    """Call under the profiler, with the gradient of a `sum()`."""
    augment, (images, *masks) = pipeline.make(pipeline.size[-1]), inputs_of(pipeline, device)

    def call(x: Tensor) -> Tensor:
        result = augment(x, *masks)
        moved: Tensor = result[0] if masks else result
        return moved.sum() if x.requires_grad else moved

    kernels.call_watched(pipeline.name, call, images)


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.augmentation_bars", description=__doc__)
    parse.add_argument("names", nargs="*", metavar="NAME", help="parts of the names to run; default: all")
    parse.add_argument("--device", choices=("cpu", "cuda"), default="cuda", help="the CPU is for a first look only")
    parse.add_argument("--seconds", type=float, default=0.1, help="time for one figure (default 0.1)")
    parse.add_argument(
        "--kernels", action="store_true", help="their kernels by Nsight Compute instead, as benchmarks.kernels"
    )
    options = parse.parse_args(arguments)
    chosen = [p for p in PIPELINES if not options.names or any(name in p.name for name in options.names)]
    device = torch.device(options.device)
    if kernels.is_watched():
        for pipeline in chosen:
            call_watched(pipeline, device)
        return 0
    if device.type == "cuda" and not torch.cuda.is_available():
        parse.error("this needs a GPU; --device cpu is for a first look")
    if options.kernels:
        try:
            kernels.print_kernels("benchmarks.augmentation_bars", [pipeline.name for pipeline in chosen])
        except FileNotFoundError as error:
            parse.error(str(error))
        return 0
    about = machine.describe(device, [])
    print(
        f"{about['hardware']}  {about['date']}  kvision {about['commit']}  torch {about['torch']}\n$ {about['command']}"
    )
    print("measured, ! where it misses the bar (in parentheses)\n")
    names = ("ms", "f+b", "host, one", "host, batch", "launches", "extra KB")
    print(f"{'':20}{'images':>16}" + "".join(f"{name:>16}" for name in names))
    for pipeline in chosen:
        print(row(pipeline, device, options.seconds), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
