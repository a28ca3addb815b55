"""`python -m benchmarks.overhead`: the overhead of public calls, measured on tiny inputs.

Public calls of filters, at 16 elements on one CPU thread: forward without a gradient, forward
that records one, and forward + backward, in microseconds, next to aten's mul in the same run.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from torch import Tensor

from benchmarks import machine
from benchmarks.sample_calls import Size, filters
from benchmarks.timing import Call
from kvision import _ops
from kvision._trace import native_operators

BARS = {"forward": 12.0, "with gradient": 20.0, "forward+backward": 60.0}  # us

SIZE = Size(1, 1, 4, 4)  # of images; volumes have 36 voxels
# Between them they run the kernels of filters.
NAMES = (
    *("filter2d", "filter2d_separable", "filter3d", "gaussian_blur2d", "box_blur", "median_blur", "sobel"),
    *("spatial_gradient", "spatial_gradient3d", "laplacian", "unsharp_mask", "bilateral_blur", "joint_bilateral_blur"),
    *("guided_blur", "motion_blur", "canny", "blur_pool2d"),
)
CALLS = {call.name.partition(".")[2]: call for call in filters.CALLS}


def of_input(name: str) -> tuple[Callable[[Tensor], Tensor], Tensor]:
    """The first result of a function of filters, of its input alone, and an input."""
    call = CALLS[name]
    function, tensors = call.function(), call.tensors(SIZE)
    arguments = {**tensors, **call.others}
    x = arguments.pop("input")
    if name == "canny":
        return lambda x: function(x, **arguments)[0], x
    return lambda x: function(input=x, **arguments), x


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


def overhead(call: Callable[[Tensor], Tensor], plain: Tensor, calls: int, blocks: int) -> dict[str, float]:
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

    factor = torch.rand(SIZE)
    rows, ran = [], set()
    for name in ("aten mul", *NAMES):
        call, x = of_input(name) if name in NAMES else (lambda x: x * factor, torch.rand(SIZE))
        leaf = x.clone().requires_grad_()
        native = native_operators(lambda leaf=leaf, call=call: call(leaf).sum().backward())
        backend = "native" if native else "reference" if name in NAMES else "torch"
        figures = overhead(call, x, options.calls, options.blocks)
        missed = [stage for stage, bar in BARS.items() if figures[stage] > bar] if native else []
        rows.append({"call": name, "backend": backend, **figures, "missed": missed})
        ran.update(native)
        cells = (f"{figures[stage]:.1f}{'!' if stage in missed else ' '}" for stage in BARS)
        print(f"{name:22}{backend:11}" + "".join(f"{cell:>18}" for cell in cells), flush=True)
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
