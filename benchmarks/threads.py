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

BAR = 1.7  # of two threads


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
    print(f"ms, minimum of many calls; bar for 2 threads: {BAR}\n")
    print(f"{'case':18}{'size':18}{'1 thread':>10}{f'{options.threads} threads':>12}{'speed-up':>10}")

    rows = []
    for size in options.sizes:
        for name in options.names or ALL:
            case = ALL[name]
            call = partial(case.call, *case.inputs(size, torch.float32, torch.device("cpu")))
            contestants = [with_threads(n, call) for n in (1, options.threads)]
            one, many = (clock.value(t) * 1e3 for t in clock.race(contestants))
            text = "x".join(map(str, size))
            rows.append({"case": name, "size": text, "one": one, "many": many, "speed_up": one / many})
            print(f"{name:18}{text:18}{one:10.3g}{many:12.3g}{one / many:10.2f}", flush=True)
    if options.threads == 2:
        missed = [f"{row['case']} {row['size']} {row['speed_up']:.2f}" for row in rows if row["speed_up"] < BAR]
        print("\n" + (f"below the bar: {', '.join(missed)}" if missed else "every case meets the bar"))
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(
            json.dumps({"machine": about, "threads": options.threads, "rows": rows}, indent=1) + "\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
