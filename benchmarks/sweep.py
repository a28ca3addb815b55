"""`python -m benchmarks.sweep`: what Kornia has as well, function by function, against Kornia's, at two sizes.

Forward without a gradient, and forward + backward to all floating-point arguments, where both libraries have a gradient.
The arguments are those of benchmarks/sample_calls.py; those of features and augmentations, modules among them, are in
benchmarks/sample_modules.py. A function is slower where it takes more than 5% and 5 microseconds
longer than Kornia's twice: what is slower at first is measured again, for longer. The exit status is 1 where one is.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import kvision as K
from benchmarks import machine
from benchmarks.peers import set_threads
from benchmarks.sample_calls import SampleCall, Size, sample_calls
from benchmarks.sample_modules import ModuleCall, sample_modules
from benchmarks.timing import Clock, clock

SIZES = (Size(4, 3, 256, 256), Size(1, 3, 375, 500))
MARGIN, MARGIN_SECONDS = 1.05, 5e-6
OBVIOUS, OBVIOUS_SECONDS = 3.0, 0.05  # far behind: this many times as long, and at least so long
AGAIN = 5  # times as long, for what is slower at first


@dataclass(frozen=True)
class Row:
    """Seconds of one function at one size."""

    name: str
    size: str
    stage: str
    kvision: float
    kornia: float

    @property
    def ratio(self) -> float:
        """Kornia's time over kvision's: above 1 where kvision is faster."""
        return self.kornia / self.kvision

    @property
    def slower(self) -> bool:
        return self.kvision > MARGIN * self.kornia and self.kvision > self.kornia + MARGIN_SECONDS


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.sweep", description=__doc__)
    parse.add_argument("names", nargs="*", metavar="NAME", help="parts of the names to run; default: all")
    parse.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parse.add_argument("--threads", type=int, default=1, help="of torch on the CPU (default 1)")
    parse.add_argument("--seconds", type=float, default=0.06, help="time for one figure (default 0.06)")
    parse.add_argument("--json", type=Path, metavar="FILE", help="write everything there too")
    options = parse.parse_args(arguments)
    kornia = importlib.import_module("kornia")
    warnings.simplefilter("ignore")
    set_threads(options.threads)
    device = torch.device(options.device)
    about = machine.describe(device, ["kornia"])
    print(f"{about['hardware']}  threads {about['threads']}  {about['date']}")
    print(
        f"kvision {about['kvision']} ({about['commit']}, kernels: {about['kernels']})  torch {about['torch']}  kornia",
        end=" ",
    )
    print(f"{about['peers']['kornia']}\n$ {about['command']}")
    print("ms of the fastest call (GPU: of the median one); x: Kornia's time over kvision's\n")
    print(f"{'function':45}{'size':15}{'stage':10}{'kvision':>10}{'kornia':>10}{'x':>8}")
    quick, thorough = clock(device, options.seconds), clock(device, AGAIN * options.seconds)
    rows, refused = [], []
    for call in (*sample_calls(), *sample_modules()):
        if call.function(kornia) is None or not (any(n in call.name for n in options.names) or not options.names):
            continue
        for size in SIZES:
            try:
                for stage, ours, theirs in stages(call, size, device, kornia):
                    row = measured(call.name, size, stage, ours, theirs, quick)
                    if row.slower:
                        row = measured(call.name, size, stage, ours, theirs, thorough)
                    rows.append(row)
                    print(line(row), flush=True)
            except Exception as error:  # of Kornia, for some devices and sizes
                refused.append(
                    f"{call.name} at {'x'.join(map(str, size))}: {type(error).__name__}: {str(error).splitlines()[0]}"
                )
    slower = [row for row in rows if row.slower]
    ratios = sorted(row.ratio for row in rows)
    functions = len({row.name for row in rows})
    print(
        f"\n{functions} functions, {len(rows)} figures: median {ratios[len(ratios) // 2]:.2f} times as fast as Kornia"
    )
    print(f"not measured: {len(refused)}", *refused, sep="\n    ")
    print(f"slower than Kornia: {len(slower)}", *map(line, sorted(slower, key=lambda row: row.ratio)), sep="\n")
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        report = {"machine": about, "rows": [asdict(row) for row in rows], "not measured": refused}
        options.json.write_text(json.dumps(report, indent=1) + "\n")
    return 1 if slower else 0


def stages(
    call: SampleCall | ModuleCall, size: Size, device: torch.device, kornia: Any
) -> Iterator[tuple[str, Callable[[], Any], Callable[[], Any]]]:
    """The calls of both libraries, forward, then forward + backward where both have a gradient."""
    tensors = call.tensors(size, device)
    yield "forward", *((lambda library=library: call.call(library, tensors)) for library in (K, kornia))
    leaves = {k: v.detach().requires_grad_(v.is_floating_point()) for k, v in tensors.items()}
    inputs = [leaf for leaf in leaves.values() if leaf.requires_grad]

    def both(library: Any) -> Any:
        outputs = [y for y in flat(call.call(library, leaves)) if y.requires_grad]
        if not outputs:
            raise NoGradientError
        return torch.autograd.grad(outputs, inputs, [torch.ones_like(y) for y in outputs], allow_unused=True)

    with contextlib.suppress(NoGradientError, RuntimeError):
        both(K), both(kornia)
        yield "both", lambda: both(K), lambda: both(kornia)


class NoGradientError(Exception):
    """No result depends differentiably on an argument."""


def flat(value: Any) -> list[Tensor]:
    """The floating-point tensors of a result."""
    if isinstance(value, Tensor):
        return [value] if value.is_floating_point() else []
    return [tensor for part in value for tensor in flat(part)] if isinstance(value, (list, tuple)) else []


def measured(name: str, size: Size, stage: str, ours: Any, theirs: Any, stopwatch: Clock) -> Row:
    """Both times of a stage; those of the second call alone where Kornia's is far behind."""
    ours(), theirs()
    kvision, kornia = wall(ours), wall(theirs)
    if kornia < OBVIOUS_SECONDS or kornia < OBVIOUS * kvision:
        kvision, kornia = (stopwatch.value(timing) for timing in stopwatch.race([ours, theirs]))
    return Row(name, "x".join(map(str, size)), stage, kvision, kornia)


def wall(call: Callable[[], Any]) -> float:
    start = time.perf_counter()
    call()
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return time.perf_counter() - start


def line(row: Row) -> str:
    times = "".join(f"{1e3 * seconds:10.4g}" for seconds in (row.kvision, row.kornia))
    return f"{row.name:45}{row.size:15}{row.stage:10}{times}{row.ratio:8.2f}{'  slower' if row.slower else ''}"


if __name__ == "__main__":
    sys.exit(main())
