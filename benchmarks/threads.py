"""`python -m benchmarks.threads [NAMES]`: how much faster kvision is with several CPU threads than with one."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
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


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.threads", description=__doc__)
    parse.add_argument("names", nargs="*", metavar="NAME", choices=[[], *ALL], help="cases, all by default")
    parse.add_argument("--threads", type=int, default=2)
    parse.add_argument("--sizes", type=parse_sizes, default=parse_sizes(SIZES["cpu"]))
    parse.add_argument("--seconds", type=float, default=0.5, help="time for one figure")
    parse.add_argument("--json", type=Path, metavar="FILE")
    options = parse.parse_args(arguments)
    about = machine.describe(torch.device("cpu"), ())
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
