"""`python -m benchmarks.size_bars [NAMES]`: bars of all sizes and types on a GPU, each with its measurement.

Every case is measured at both round sizes, at a size whose rows are not aligned and at the next aligned size, in float32 and
float16. The table has times over floors. The bars follow: of single cases, of unaligned rows, of float16.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator, Sequence

import torch

from benchmarks import awkward, machine
from benchmarks.bars import CheckedBar
from benchmarks.case import Case, Size
from benchmarks.cases import ALL, color, enhance
from benchmarks.measure import BACKWARD, BOTH, FORWARD, Step, size_name, tensors_of
from benchmarks.timing import CudaClock

SMALL, LARGE, ODD = (128, 3, 256, 256), (32, 3, 1080, 1920), (49, 3, 335, 513)
NEIGHBOR = awkward.aligned(ODD)
TYPES = {"float32": torch.float32, "float16": torch.float16}

# time over floor, 128x3x256x256 in float32
FLOOR = {
    (FORWARD, "ssim_loss11"): 2.8, (BOTH, "ssim_loss11"): 6.5,
    (FORWARD, "remap"): 1.5, (FORWARD, "remap_shared"): 1.5, (FORWARD, "warp_perspective"): 1.5,
    (FORWARD, "equalize"): 1.2, (FORWARD, "contrast_mean"): 1.6, (FORWARD, "clahe"): 2.2, (FORWARD, "canny"): 5,
    (FORWARD, "total_variation"): 1.2, (BOTH, "total_variation"): 1.6, (FORWARD, "psnr"): 1.2, (BOTH, "psnr"): 1.6,
    (FORWARD, "histogram_gray"): 6, (BOTH, "histogram_gray"): 12, (FORWARD, "gauss31"): 2.2,
    (BOTH, "bilateral5"): 6, (BOTH, "median5"): 7, (BOTH, "dilation15"): 3, (BOTH, "crop_and_resize"): 2.5,
    (BOTH, "rgb_to_lab"): 1.9, (BOTH, "hsv_to_rgb"): 1.9,
}  # fmt: skip
MEANS = {(FORWARD, SMALL): 1.4, (BOTH, SMALL): 1.8, (FORWARD, ODD): 1.6, (BOTH, ODD): 2.1}  # geometric, float32

# time over floor at unaligned rows, divided by that at the next aligned size
POINTWISE, STENCIL = 1.15, 1.25
STENCILS = {"sharpness", "clahe", "clahe_opencv", "equalize", "equalize_opencv", "histogram", "histogram_gaussian"}
PIXELWISE = {case.name for case in (*color.CASES, *enhance.CASES)} - STENCILS | {"hflip", "center_crop"}

# speed-up of float16 over float32, of cases that take at most FAST floors in float32
FAST, WARPS, REST = 1.4, 1.2, 1.1
SPEED_UPS = {SMALL: 1.4, LARGE: 1.7}

Key = tuple[str, Size, str, str]  # case, size, type, stage
Ratios = dict[Key, float]


def times(
    case: Case, size: Size, dtype: torch.dtype, stages: Sequence[str], clock: CudaClock, bandwidth: float
) -> Iterator[tuple[str, float, float]]:
    """Each stage with its time and its time over floor."""
    inputs = case.inputs(size, dtype, torch.device("cuda"))
    outputs = tensors_of(case.call(*inputs))
    floors = {FORWARD: case.forward(inputs, outputs), BACKWARD: case.backward(inputs, outputs)}
    floors[BOTH] = floors[FORWARD] + floors[BACKWARD]
    del outputs
    for stage in stages:
        call = (lambda: case.call(*inputs)) if stage == FORWARD else Step(case.call, inputs)
        seconds = clock.value(clock.time(call))
        yield stage, seconds, seconds / (floors[stage] / bandwidth)


def bars(floors: Ratios, seconds: Ratios, names: Sequence[str]) -> list[CheckedBar]:
    checked = []
    for (stage, name), limit in FLOOR.items():
        if (key := (name, SMALL, "float32", stage)) in floors:
            checked.append(CheckedBar(name, size_name(SMALL), "float32", f"{stage} floor", floors[key], limit))
    for name in names:
        limit = POINTWISE if name in PIXELWISE else STENCIL
        for dtype in TYPES:
            for stage in (FORWARD, BOTH):
                odd, even = (floors.get((name, size, dtype, stage)) for size in (ODD, NEIGHBOR))
                if odd and even:
                    checked.append(CheckedBar(name, size_name(ODD), dtype, f"{stage} unaligned", odd / even, limit))
        for size, fast in SPEED_UPS.items():
            full, half = (seconds.get((name, size, dtype, FORWARD)) for dtype in TYPES)
            if full and half:
                at_floor = floors[name, size, "float32", FORWARD] <= FAST
                limit = fast if at_floor else WARPS if name.startswith(("warp", "remap")) else REST
                checked.append(
                    CheckedBar(name, size_name(size), "float16", "speed-up", full / half, limit, is_lower_limit=True)
                )
    return checked


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.size_bars", description=__doc__)
    parse.add_argument("names", nargs="*", metavar="NAME", help="cases, all by default")
    parse.add_argument("--seconds", type=float, default=0.002, help="time for one figure")
    parse.add_argument("--limit", type=float, default=math.inf, help="stop after that many seconds")
    parse.add_argument("--large", action=argparse.BooleanOptionalAction, default=True, help="measure 1080x1920")
    options = parse.parse_args(arguments)
    start = time.perf_counter()
    names = options.names or list(ALL)
    clock = CudaClock(options.seconds)
    bandwidth = clock.copy_bandwidth()
    about = machine.describe(torch.device("cuda"), ())
    print(f"{about['hardware']}  copy {bandwidth / 1e9:.4g} GB/s  torch {about['torch']}  {about['date']}")
    print(f"$ {about['command']}\ntime over floor; f+b: forward + backward\n")
    both = (FORWARD, BOTH)
    plan = [(SMALL, both), (ODD, both), (NEIGHBOR, both)] + [(LARGE, (FORWARD,))] * options.large
    labels = [f"{size[-2]}x{size[-1]}{' f+b' * (stage == BOTH)}" for size, stages in plan for stage in stages]
    print(f"{'case':19}" + "".join(f"{label:>14}" for label in labels) + "   (float32 float16)")

    floors, seconds = {}, {}
    for name in names:
        cells = []
        for size, stages in plan:
            for dtype in TYPES:
                try:
                    for stage, took, ratio in times(ALL[name], size, TYPES[dtype], stages, clock, bandwidth):
                        floors[name, size, dtype, stage], seconds[name, size, dtype, stage] = ratio, took
                except (ValueError, TypeError, RuntimeError):
                    pass  # no gradient, or a type or a size that the case does not serve
            for stage in stages:
                pair = (floors.get((name, size, dtype, stage)) for dtype in TYPES)
                cells.append(" ".join("    -" if x is None else f"{x:5.2f}" for x in pair))
        torch.cuda.empty_cache()
        print(f"{name:19}" + "".join(f"{cell:>14}" for cell in cells), flush=True)
        if time.perf_counter() - start > options.limit:
            print("(stopped by --limit)")
            break

    checked = bars(floors, seconds, names)
    print(f"\n{sum(bar.met for bar in checked)} bars met, {sum(not bar.met for bar in checked)} missed")
    for bar in checked:
        if not bar.met or bar.what.endswith("floor"):
            mark = "met" if bar.met else "MISSED"
            print(f"{mark:8}{bar.case:19}{bar.size:17}{bar.dtype:9}{bar.what:28}{bar.measured:6.2f}{bar.limit:6.2f}")
    for (stage, size), limit in MEANS.items():
        found = [r for (_, s, dtype, of), r in floors.items() if (s, dtype, of) == (size, "float32", stage)]
        if found:
            mean = awkward.geometric_mean(found)
            print(f"geometric mean of {len(found)}, {size_name(size)} {stage}: {mean:.2f}, bar {limit}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
