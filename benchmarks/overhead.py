"""`python -m benchmarks.overhead`: the overhead of public calls, measured on tiny inputs.

Public calls that between them run every operator, at 16 elements on one CPU thread: forward without a gradient, forward
that records one, and forward + backward, in microseconds, next to aten's mul in the same run.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from benchmarks import machine
from benchmarks.timing import Call
from kvision import _ops, filters
from kvision._trace import native_operators

BARS = {"forward": 12.0, "with gradient": 20.0, "forward+backward": 60.0}  # us

IMAGE, VOLUME = (1, 1, 4, 4), (1, 1, 2, 2, 4)


@dataclass(frozen=True)
class Public:
    """A public call on one tensor."""

    name: str
    call: Callable[[Tensor], Tensor]
    size: tuple[int, ...] = IMAGE


KERNEL, KERNEL3D, LINE = torch.rand(1, 3, 3), torch.rand(1, 3, 3, 3), torch.rand(1, 3)

CALLS = [
    Public("filter2d", lambda x: filters.filter2d(x, KERNEL)),
    Public("filter2d_separable", lambda x: filters.filter2d_separable(x, LINE, LINE)),
    Public("filter3d", lambda x: filters.filter3d(x, KERNEL3D), VOLUME),
    Public("gaussian_blur2d", lambda x: filters.gaussian_blur2d(x, (3, 3), (1.0, 1.0))),
    Public("box_blur", lambda x: filters.box_blur(x, 3)),
    Public("median_blur", lambda x: filters.median_blur(x, 3)),
    Public("sobel", lambda x: filters.sobel(x)),
    Public("spatial_gradient", lambda x: filters.spatial_gradient(x)),
    Public("spatial_gradient3d", lambda x: filters.spatial_gradient3d(x), VOLUME),
    Public("laplacian", lambda x: filters.laplacian(x, 3)),
    Public("unsharp_mask", lambda x: filters.unsharp_mask(x, (3, 3), (1.0, 1.0))),
    Public("bilateral_blur", lambda x: filters.bilateral_blur(x, 3, 0.1, (1.0, 1.0))),
    Public("joint_bilateral_blur", lambda x: filters.joint_bilateral_blur(x, x.detach(), 3, 0.1, (1.0, 1.0))),
    Public("guided_blur", lambda x: filters.guided_blur(x.detach(), x, 3, 0.1)),
    Public("motion_blur", lambda x: filters.motion_blur(x, 3, 35.0, 0.5)),
    Public("canny", lambda x: filters.canny(x)[0]),
    Public("blur_pool2d", lambda x: filters.blur_pool2d(x, 3)),
]


def microseconds(call: Call, calls: int, blocks: int) -> float:
    """Mean time of `calls` calls in the fastest of `blocks` blocks, because other load only adds time."""
    call()
    seconds = []
    for _ in range(blocks):
        start = time.perf_counter()
        for _ in range(calls):
            call()
        seconds.append((time.perf_counter() - start) / calls)
    return min(seconds) * 1e6


def overhead(call: Callable[[Tensor], Tensor], size: Sequence[int], calls: int, blocks: int) -> dict[str, float]:
    plain = torch.rand(size)
    leaf = plain.clone().requires_grad_()
    upstream = torch.rand_like(call(plain))
    return {
        "forward": microseconds(lambda: call(plain), calls, blocks),
        "with gradient": microseconds(lambda: call(leaf), calls, blocks),
        "forward+backward": microseconds(lambda: torch.autograd.grad(call(leaf), leaf, upstream), calls, blocks),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.overhead", description=__doc__)
    parse.add_argument("--calls", type=int, default=300, help="calls a block")
    parse.add_argument("--blocks", type=int, default=30, help="blocks, of which the quickest counts")
    parse.add_argument("--json", type=Path, metavar="FILE")
    options = parse.parse_args(arguments)
    torch.set_num_threads(1)
    about = machine.describe(torch.device("cpu"), ())
    print(f"{about['hardware']}  torch {about['torch']}  {about['date']}\n$ {about['command']}")
    print(f"us a call, at 16 elements; bars: {', '.join(f'{stage} {bar:g}' for stage, bar in BARS.items())}\n")
    print(f"{'call':22}{'backend':11}" + "".join(f"{stage:>18}" for stage in BARS))

    factor = torch.rand(IMAGE)
    rows, ran = [], set()
    for public in [Public("aten mul", lambda x: x * factor), *CALLS]:
        x = torch.rand(public.size, requires_grad=True)
        native = native_operators(lambda x=x, call=public.call: call(x).sum().backward())
        backend = "native" if native else "reference" if public in CALLS else "torch"
        figures = overhead(public.call, public.size, options.calls, options.blocks)
        missed = [stage for stage, bar in BARS.items() if figures[stage] > bar] if native else []
        rows.append({"call": public.name, "backend": backend, **figures, "missed": missed})
        ran.update(native)
        cells = (f"{figures[stage]:.1f}{'!' if stage in missed else ' '}" for stage in BARS)
        print(f"{public.name:22}{backend:11}" + "".join(f"{cell:>18}" for cell in cells), flush=True)
    over = [f"{row['call']} ({', '.join(row['missed'])})" for row in rows if row["missed"]]
    print("\n" + (f"over a bar: {', '.join(over)}" if over else "every native call meets its bars"))
    unseen = sorted(_ops.operators.keys() - ran)
    print(f"operators that none of these ran: {', '.join(unseen) or 'none'}")
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps({"machine": about, "bars": BARS, "rows": rows}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
