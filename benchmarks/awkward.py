"""`python -m benchmarks.awkward [NAMES]`: time over floor of common operators on a GPU, by type and size, with geometric means.

    python -m benchmarks.awkward                                     every operator, type and size
    python -m benchmarks.awkward sobel gauss5 --types float16 uint8 --sizes 335x513 --limit 30

Most sizes have rows and planes that are not aligned. A floor is the bytes of that type, read and written once, over the copy
bandwidth of the same run. `copy` and `ssim_loss11` are shown, but not part of the means.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from benchmarks import machine
from benchmarks.case import Case, Size
from benchmarks.cases import ALL
from benchmarks.measure import KVISION, Row, name_of, size_name, tensors_of
from benchmarks.timing import Clock, clock

SHAPES = ((336, 514), (335, 513), (375, 500), (427, 640), (321, 481), (299, 299))
RANDOM_SHAPES = 3
ALIGNMENT = 16  # pixels: rows of aligned sizes are multiples of vectors in every type


@dataclass(frozen=True)
class Ratio:
    """Time over floor at an awkward size, over that at the aligned size next to it."""

    case: str
    dtype: str
    stage: str
    size: str
    factor: float


def sizes(round_size: Size, seed: int = 0) -> list[Size]:
    """The awkward sizes with about as many pixels as `round_size`: those of photographs, and random ones."""
    draw = random.Random(seed)
    shapes = [*SHAPES, *((draw.randint(200, 700), draw.randint(200, 700)) for _ in range(RANDOM_SHAPES))]
    batch, channels, height, width = round_size
    return [(max(1, round(batch * height * width / (h * w))), channels, h, w) for h, w in shapes]


def aligned(size: Size) -> Size:
    """The same size with the next width that is a multiple of 16 pixels."""
    return (*size[:-1], -(-size[-1] // ALIGNMENT) * ALIGNMENT)


def worst_ratios(rows: Iterable[Row], awkward: Sequence[Size]) -> list[Ratio]:
    """The worst ratio of each case, type and stage, the worst case first."""
    ours = {
        (row.case, row.dtype, row.stage, row.size): row.value / row.floor
        for row in rows
        if row.library == KVISION and row.value is not None and row.floor
    }
    neighbor = {size_name(size): size_name(aligned(size)) for size in awkward}
    worst: dict[tuple[str, str, str], Ratio] = {}
    for (case, dtype, stage, size), cost in ours.items():
        neighboring = ours.get((case, dtype, stage, neighbor.get(size, size)))
        if size not in neighbor or neighbor[size] == size or neighboring is None:
            continue
        ratio = Ratio(case, dtype, stage, size, cost / neighboring)
        key = (case, dtype, stage)
        if key not in worst or worst[key].factor < ratio.factor:
            worst[key] = ratio
    return sorted(worst.values(), key=lambda ratio: -ratio.factor)


# --- the table of common operators -----------------------------------------------------------------------------------

COMMON = (
    "gray", "rgb_to_hsv", "brightness", "hflip", "center_crop", "sobel", "gauss5", "box5", "median3", "dilation3",
    "resize_antialias", "pyrdown", "warp_affine",
)  # fmt: skip
BESIDE = {"copy": Case("copy", lambda x: x.clone()), "ssim_loss11": ALL["ssim_loss11"]}
TABLE_SHAPES = ((336, 512), (335, 513), (375, 500), (299, 299))
TYPES = {name_of(t): t for t in (torch.float32, torch.float16, torch.bfloat16, torch.uint8)}
PIXELS = 128 * 256 * 256


class Cost(NamedTuple):
    """Time over floor, or why there is none."""

    case: str
    dtype: str
    shape: tuple[int, int]
    floors: float | None
    failure: str = ""


def inputs_of(case: Case, size: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
    """Those of the case; images of bytes have all levels."""
    if dtype.is_floating_point:
        return case.inputs(size, dtype, device)
    images = case.inputs(size, torch.float32, device)
    return tuple(x.mul(255).to(dtype) if x.ndim == 4 else x for x in images)


def costs(
    cases: Iterable[Case],
    dtypes: Iterable[torch.dtype],
    shapes: Iterable[tuple[int, int]],
    pixels: int,
    stopwatch: Clock,
    device: torch.device,
) -> Iterator[Cost]:
    bandwidth = stopwatch.copy_bandwidth()
    for height, width in shapes:
        size = (max(1, round(pixels / (height * width))), 3, height, width)
        for dtype in dtypes:
            for case in cases:
                key = (case.name, name_of(dtype), (height, width))
                try:
                    inputs = inputs_of(case, size, dtype, device)
                    floor = case.forward(inputs, tensors_of(case.call(*inputs))) / bandwidth
                    yield Cost(*key, stopwatch.value(stopwatch.time(partial(case.call, *inputs))) / floor)
                except (TypeError, ValueError, RuntimeError) as error:  # a type that the operator does not take
                    yield Cost(*key, None, str(error).splitlines()[0])


def geometric_mean(numbers: Sequence[float]) -> float:
    return math.exp(math.fsum(map(math.log, numbers)) / len(numbers))


def lines(measured: Sequence[Cost]) -> Iterator[str]:
    """A row for each operator and type, a column for each size; then the means."""
    shapes, dtypes, names = (list(dict.fromkeys(c[i] for c in measured)) for i in (2, 1, 0))
    found = {c[:3]: c.floors for c in measured}

    def line(label: str, dtype: str, cells: Iterable[float | None]) -> str:
        return f"{label:18}{dtype:10}" + "".join(f"{'-' if c is None else f'{c:.2f}':>10}" for c in cells)

    yield f"{'':28}" + "".join(f"{f'{h}x{w}':>10}" for h, w in shapes)
    for name in names:
        for dtype in dtypes:
            yield line(name, dtype, (found.get((name, dtype, shape)) for shape in shapes))
    for dtype in dtypes:
        means = []
        for shape in shapes:
            numbers = [f for name in COMMON if (f := found.get((name, dtype, shape))) is not None]
            means.append(geometric_mean(numbers) if numbers else None)
        yield line("geometric mean", dtype, means)


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.awkward", description=__doc__)
    parse.formatter_class = argparse.RawDescriptionHelpFormatter
    parse.add_argument("names", nargs="*", metavar="NAME", help="cases; default: the common operators, copy and ssim")
    parse.add_argument("--device", choices=("cpu", "cuda"), default="cuda")
    parse.add_argument("--types", nargs="+", choices=TYPES, default=list(TYPES))
    parse.add_argument("--sizes", nargs="+", metavar="HxW", default=[f"{h}x{w}" for h, w in TABLE_SHAPES])
    parse.add_argument("--pixels", type=int, default=PIXELS, help="of a batch, times three channels")
    parse.add_argument("--seconds", type=float, default=0.01, help="time for one figure (default 0.01)")
    parse.add_argument("--limit", type=float, default=math.inf, help="stop after so many seconds, with what there is")
    options = parse.parse_args(arguments)
    every = {**ALL, **BESIDE}
    if unknown := [name for name in options.names if name not in every]:
        parse.error(f"no case called {', '.join(unknown)}")
    cases = [every[name] for name in options.names or (*COMMON, *BESIDE)]
    shapes = [(int(h), int(w)) for h, w in (size.split("x") for size in options.sizes)]
    device, start, measured = torch.device(options.device), time.perf_counter(), []
    about = machine.describe(device, [])
    print(f"{about['hardware']}  torch {about['torch']}  {about['date']}\n$ {about['command']}\ntime over floor\n")
    dtypes = [TYPES[name] for name in options.types]
    for cost in costs(cases, dtypes, shapes, options.pixels, clock(device, options.seconds), device):
        measured.append(cost)
        if cost.failure:
            print(f"{cost.case} {cost.dtype} {cost.shape}: {cost.failure}", flush=True)
        else:  # for runs that do not reach the table
            print(f"{cost.case} {cost.dtype} {cost.shape}: {cost.floors:.2f}", file=sys.stderr, flush=True)
        if time.perf_counter() - start > options.limit:
            print("(stopped by --limit)")
            break
    print(*lines(measured), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
