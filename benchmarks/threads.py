"""`python -m benchmarks.threads [NAMES]`: how much faster kvision is with several CPU threads than with one.

`--busy` keeps one of two cores busy with another process, and compares calls below 1 ms on two threads with one thread
on idle cores.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch

from benchmarks import machine
from benchmarks.__main__ import SIZES, parse_sizes
from benchmarks.cases import ALL
from benchmarks.timing import CpuClock

BAR = 1.8  # of two threads, or what a copy gains if that is less, for images above LARGE pixels
LARGE = 1_000_000
COPY = "(copy)"


def with_threads(threads: int, call: Callable[[], Any]) -> tuple[Callable[[], None], Callable[[Any], Any]]:
    """A contestant for Clock.race that runs `call` on that many threads."""
    return lambda: torch.set_num_threads(threads), lambda _: call()


@contextlib.contextmanager
def busy(core: int) -> Iterator[None]:
    """Another process computes on that core."""
    program = f"import os\nos.sched_setaffinity(0, [{core}])\nprint(flush=True)\nwhile True: pass"
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
        assert process.stdout
        process.stdout.readline()
        try:
            yield
        finally:
            process.kill()


def beside_busy_core(names: Sequence[str], sizes: Sequence[tuple[int, ...]], rounds: int = 4, calls: int = 15) -> None:
    """A line of CSV for each case of less than 1 ms: on one thread of idle cores, and on two with one core busy."""
    cores = sorted(os.sched_getaffinity(0))[:2]
    os.sched_setaffinity(0, cores)

    def times(call: Callable[[], Any]) -> list[float]:
        call()
        ticks = [time.perf_counter()]
        for _ in range(calls):
            call()
            ticks.append(time.perf_counter())
        return [1e3 * (after - before) for before, after in itertools.pairwise(ticks)]

    steps: dict[tuple[str, str], Callable[[], Any]] = {
        (name, "x".join(map(str, size))): partial(
            ALL[name].call, *ALL[name].inputs(size, torch.float32, torch.device("cpu"))
        )
        for size in sizes
        for name in names
    }
    torch.set_num_threads(1)
    steps = {key: step for key, step in steps.items() if statistics.median(times(step)) < 1}
    alone: dict[tuple[str, str], list[float]] = {key: [] for key in steps}
    beside: dict[tuple[str, str], list[float]] = {key: [] for key in steps}
    for _ in range(rounds):
        torch.set_num_threads(1)
        for key, step in steps.items():
            alone[key] += times(step)
        torch.set_num_threads(2)
        with busy(cores[1]):
            for key, step in steps.items():
                beside[key] += times(step)
    columns = (f"{what} {where}" for where in ("on 1 thread", "beside a busy core") for what in ("median", "mean"))
    print(",".join(["case", "size", *columns, "ratio of medians", "ratio of means"]))
    for key in steps:
        figures = [function(of[key]) for of in (alone, beside) for function in (statistics.median, statistics.mean)]
        ratios = figures[2] / figures[0], figures[3] / figures[1]
        print(",".join([*key, *(f"{x:.3g}" for x in (*figures, *ratios))]), flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.threads", description=__doc__)
    parse.add_argument("names", nargs="*", metavar="NAME", choices=[[], *ALL], help="cases, all by default")
    parse.add_argument("--threads", type=int, default=2)
    parse.add_argument("--sizes", type=parse_sizes, default=parse_sizes(SIZES["cpu"]))
    parse.add_argument("--seconds", type=float, default=0.5, help="time for one figure")
    parse.add_argument("--busy", action="store_true", help="with another process on one of two cores")
    parse.add_argument("--json", type=Path, metavar="FILE")
    options = parse.parse_args(arguments)
    about = machine.describe(torch.device("cpu"), ())
    if options.busy:
        print(f"# {about['hardware']}, torch {about['torch']}, {about['date']}: `{about['command']}`, ms")
        beside_busy_core(options.names or list(ALL), options.sizes)
        return 0
    clock = CpuClock(options.seconds)
    print(f"{about['hardware']}, {about['cores']} cores  torch {about['torch']}  {about['date']}\n$ {about['command']}")
    print(f"ms, minimum of many calls that take turns; bar for 2 threads: {BAR}, or what a copy gains\n")
    print(f"{'case':18}{'size':18}{'1 thread':>10}{f'{options.threads} threads':>12}{'speed-up':>10}")

    rows = []
    for size in options.sizes:
        for name in (COPY, *(options.names or ALL)):
            if name == COPY:
                source = torch.ones(size)
                call = partial(torch.empty_like(source).copy_, source)
            else:
                call = partial(ALL[name].call, *ALL[name].inputs(size, torch.float32, torch.device("cpu")))
            contestants = [with_threads(n, call) for n in (1, options.threads)]
            one, many = (clock.value(t) * 1e3 for t in clock.race(contestants))
            text = "x".join(map(str, size))
            rows.append({"case": name, "size": text, "one": one, "many": many, "speed_up": one / many})
            print(f"{name:18}{text:18}{one:10.3g}{many:12.3g}{one / many:10.2f}", flush=True)
    if options.threads == 2:
        bars = {row["size"]: min(BAR, row["speed_up"]) for row in rows if row["case"] == COPY}
        large = {"x".join(map(str, size)) for size in options.sizes if size[0] * size[-2] * size[-1] > LARGE}
        missed = [
            f"{row['case']} {row['size']} {row['speed_up']:.2f}"
            for row in rows
            if row["size"] in large and row["speed_up"] < bars[row["size"]]
        ]
        print("\n" + (f"below the bar: {', '.join(missed)}" if missed else "every case meets the bar"))
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(
            json.dumps({"machine": about, "threads": options.threads, "rows": rows}, indent=1) + "\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
