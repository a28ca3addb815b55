"""`python -m benchmarks.sweep`: every function that Kornia has too, against Kornia's, at two sizes.

Forward without a gradient, and forward + backward to all floating-point arguments, where both libraries have a gradient.
The arguments are those of benchmarks/sample_calls. A function is slower where it takes more than 5% and 5 microseconds
longer than Kornia's three times: a glance decides what is far faster, what is near is measured for longer, and what is
slower then for longer still. The exit status is 1 where one is. `--shard 1/3` measures every third name, `--join FILES`
makes one table of the JSON files of several runs; of a function that was measured twice it has the later figures.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
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
from benchmarks.sample_calls import WITHOUT_SAMPLE, SampleCall, Size, public_functions, sample_calls, sample_modules
from benchmarks.timing import Clock, clock

SIZES = (Size(4, 3, 256, 256), Size(1, 3, 375, 500))
MARGIN, MARGIN_SECONDS = 1.05, 5e-6
FAR = 1.5  # times as fast at a glance
SLOW = 0.05  # seconds: a call of Kornia's that takes so long is timed once
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
    parse.add_argument("--shard", default="1/1", metavar="I/N", help="every Nth name from the Ith on")
    parse.add_argument("--json", type=Path, metavar="FILE", help="write everything there too")
    parse.add_argument("--join", type=Path, nargs="+", metavar="FILE", help="print the table of these JSON files")
    options = parse.parse_args(arguments)
    if options.join:
        reports = [json.loads(file.read_text()) for file in options.join]
    else:
        reports = [measure(options)]
        if options.json:
            options.json.parent.mkdir(parents=True, exist_ok=True)
            options.json.write_text(json.dumps(reports[0], indent=1) + "\n")
    rows = list({(row["name"], row["size"], row["stage"]): Row(**row) for r in reports for row in r["rows"]}.values())
    if options.join:
        order = {name: i for i, name in enumerate(dict.fromkeys(call.name for call in all_calls()))}
        rows.sort(key=lambda row: order[row.name])  # stable
        print_heading([report["machine"] for report in reports])
        print(*map(line, rows), sep="\n")
    return summarize(rows, [text for report in reports for text in report["not measured"]])


def all_calls() -> list[SampleCall]:
    return [*sample_calls(), *sample_modules()]


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure and print rows; the machine, all rows, and what could not be measured."""
    kornia = importlib.import_module("kornia")
    warnings.simplefilter("ignore")
    set_threads(options.threads)
    device = torch.device(options.device)
    about = machine.describe(device, ["kornia"])
    print_heading([about])
    glance = clock(device, 0, rounds=1)
    quick, thorough = clock(device, options.seconds), clock(device, AGAIN * options.seconds)
    shard, shards = map(int, options.shard.split("/"))
    calls = [call for call in all_calls() if not options.names or any(n in call.name for n in options.names)]
    rows, refused = [], []
    gc.collect()
    gc.freeze()  # what is alive now needs no look at for every figure
    for call in [call for call in calls if call.function(kornia) is not None][shard - 1 :: shards]:
        for size in SIZES:
            try:
                for stage, ours, theirs in stages(call, size, device, kornia):
                    row = measured(call.name, size, stage, ours, theirs, [glance, quick, thorough])
                    rows.append(row)
                    print(line(row), flush=True)
            except Exception as error:  # of Kornia, for some devices and sizes
                refused.append(
                    f"{call.name} at {'x'.join(map(str, size))}: {type(error).__name__}: {str(error).splitlines()[0]}"
                )
    return {"machine": about, "rows": [asdict(row) for row in rows], "not measured": refused}


def print_heading(machines: Sequence[dict[str, Any]]) -> None:
    about = machines[0]
    print(f"{about['hardware']}  threads {about['threads']}  {about['date']}")
    print(
        f"kvision {about['kvision']} ({about['commit']}, kernels: {about['kernels']})  torch {about['torch']}  kornia",
        about["peers"]["kornia"],
    )
    print(*(f"$ {machine['command']}" for machine in machines), sep="\n")
    print("ms of the fastest call (GPU: of the median one); x: Kornia's time over kvision's\n")
    print(f"{'function':48}{'size':15}{'stage':10}{'kvision':>10}{'kornia':>10}{'x':>8}")


def summarize(rows: Sequence[Row], refused: Sequence[str]) -> int:
    """Print what is slower, what is missing and why; 1 if a function is slower for no reason."""
    slower = sorted((row for row in rows if row.slower), key=lambda row: row.ratio)
    ratios = sorted(row.ratio for row in rows)
    functions = len({row.name for row in rows})
    kornia = importlib.import_module("kornia")
    alone = [call.name for call in all_calls() if call.function(kornia) is None]
    without = set(public_functions()) - {call.name for call in all_calls()}
    print(
        f"\n{functions} functions, {len(rows)} figures: median {ratios[len(ratios) // 2]:.2f} times as fast as Kornia"
    )
    print(f"slower than Kornia: {len(slower)}", *map(line, slower), sep="\n")
    print(f"not measured: {len(refused)}", *refused, sep="\n    ")
    print(f"not in Kornia: {len(alone)}", *alone, sep="\n    ")
    print(
        f"without a sample call: {len(without)}", *(f"{n}: {WITHOUT_SAMPLE[n]}" for n in sorted(without)), sep="\n    "
    )
    return 1 if slower else 0


def stages(
    call: SampleCall, size: Size, device: torch.device, kornia: Any
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


def measured(name: str, size: Size, stage: str, ours: Any, theirs: Any, stopwatches: Sequence[Clock]) -> Row:
    """Both times of a stage, by one stopwatch after the other until kvision is faster; far faster for the first one."""
    ours(), theirs()
    row = Row(name, "x".join(map(str, size)), stage, wall(ours), wall(theirs))
    if row.kornia > SLOW and row.ratio > 2 * FAR:
        return row
    for i, stopwatch in enumerate(stopwatches):
        times = (stopwatch.value(timing) for timing in stopwatch.race([ours, theirs]))
        row = Row(row.name, row.size, stage, *times)
        if row.ratio > FAR if i == 0 else not row.slower:
            break
    return row


def wall(call: Callable[[], Any]) -> float:
    start = time.perf_counter()
    call()
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return time.perf_counter() - start


def line(row: Row) -> str:
    times = "".join(f"{1e3 * seconds:10.4g}" for seconds in (row.kvision, row.kornia))
    return f"{row.name:48}{row.size:15}{row.stage:10}{times}{row.ratio:8.2f}{'  slower' if row.slower else ''}"


if __name__ == "__main__":
    sys.exit(main())
