"""`python -m benchmarks [NAMES] ...`: the cases, next to the copy bandwidth and every installed peer."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch

from benchmarks import awkward, bars, machine, results, table
from benchmarks.case import Size
from benchmarks.cases import ALL
from benchmarks.measure import FORWARD, KVISION, Row, measure, name_of, size_name
from benchmarks.peers import PEERS, set_threads
from benchmarks.timing import CpuClock, clock

SIZES = {"cpu": "16x3x256x256,1x3x1080x1920", "cuda": "128x3x256x256,32x3x1080x1920"}


def main(arguments: Sequence[str] | None = None) -> int:
    options = parser().parse_args(arguments)
    unknown = [name for name in options.names if name not in ALL]
    if unknown:
        print(f"benchmarks: no case called {', '.join(unknown)}; there are {', '.join(ALL)}", file=sys.stderr)
        return 2
    if options.device == "cuda" and not torch.cuda.is_available():
        print("benchmarks: --device cuda: this torch sees no CUDA device", file=sys.stderr)
        return 2
    cases = [ALL[name] for name in options.names or ALL]
    device = torch.device(options.device)
    set_threads(options.threads)
    peers = [name for name in options.peers if PEERS[name].installed]
    stopwatch = clock(device, options.seconds)
    bandwidth = stopwatch.copy_bandwidth()
    about = machine.describe(device, peers)
    on_gpu = device.type == "cuda"
    print(table.heading(about, bandwidth), table.LEGEND, *[table.CUDA_LEGEND] * on_gpu, sep="\n", flush=True)

    rows: list[Row] = []
    layout = table.Table(on_gpu)
    round_sizes = options.sizes or parse_sizes(SIZES[device.type])
    has_awkward = options.sizes is None if options.awkward is None else options.awkward
    awkward_sizes = awkward.sizes(round_sizes[0]) if has_awkward else []
    neighbors = [size for size in map(awkward.aligned, awkward_sizes) if size not in (*round_sizes, *awkward_sizes)]
    for size in dict.fromkeys([*round_sizes, *awkward_sizes, *neighbors]):
        for dtype in options.dtype:
            print(f"\n{size_name(size)} {name_of(dtype)}{copied(size, dtype, stopwatch)}")
            print(layout.header(), flush=True)
            for case in cases:
                measured = measure(
                    case, size, dtype, device, [] if size in neighbors else peers, stopwatch, bandwidth,
                    backward=options.backward, batch_one=size == round_sizes[0],
                )  # fmt: skip
                for row in where_served(measured, case.name, size, dtype):
                    rows.append(row)
                    print(layout.line(row), flush=True)

    with_bars = set(map(size_name, round_sizes))
    checked = bars.check(cases, [row for row in rows if row.size in with_bars], on_gpu)
    lost = bars.losses(rows)
    ratios = awkward.worst_ratios(rows, awkward_sizes)
    print("", table.summary(checked, lost), sep="\n")
    if ratios:
        print(table.ratios(ratios))
    if options.csv:
        results.merge_cases(options.csv, rows, about)
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        report = {
            "machine": {**about, "copy_bandwidth": bandwidth},
            "rows": [dataclasses.asdict(row) for row in rows],
            "bars": [{**dataclasses.asdict(v), "met": v.met} for v in checked],
            "losses": [dataclasses.asdict(loss) for loss in lost],
            "awkward": [dataclasses.asdict(ratio) for ratio in ratios],
        }
        options.json.write_text(json.dumps(report, indent=1) + "\n")
    return 0


def where_served(rows: Iterator[Row], case: str, size: Size, dtype: torch.dtype) -> Iterator[Row]:
    """The rows of a case, or one that says why it does not serve this size: some need even sides."""
    try:
        yield from rows
    except ValueError as error:
        yield Row(case, size_name(size), name_of(dtype), KVISION, FORWARD, failure=str(error).splitlines()[0])


def parser() -> argparse.ArgumentParser:
    parse = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parse.add_argument("names", nargs="*", metavar="NAME", help=f"cases to run, all by default: {', '.join(ALL)}")
    parse.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parse.add_argument("--peers", type=parse_peers, default=list(PEERS), help=f"of {','.join(PEERS)}; 'none' for none")
    parse.add_argument("--sizes", type=parse_sizes, help="such as 16x3x256x256,1x3x1080x1920; default: the bars' sizes")
    parse.add_argument(
        "--awkward", action=argparse.BooleanOptionalAction,
        help="measure sizes that are not aligned, too; default: unless --sizes is given",
    )  # fmt: skip
    parse.add_argument("--dtype", type=parse_dtypes, default=[torch.float32], help="such as float32,float16")
    parse.add_argument("--backward", action="store_true", help="time backward and forward + backward too")
    parse.add_argument("--threads", type=int, default=1, help="of torch and OpenCV on the CPU (default 1)")
    parse.add_argument("--seconds", type=float, default=0.5, help="time for one figure (default 0.5)")
    parse.add_argument("--json", type=Path, metavar="FILE", help="write everything there too")
    parse.add_argument(
        "--csv", type=Path, metavar="FILE", help="replace these cases in a committed table, results/MACHINE/cases.csv"
    )
    return parse


def parse_peers(text: str) -> list[str]:
    names = [] if text == "none" else text.split(",")
    for name in names:
        if name not in PEERS:
            raise argparse.ArgumentTypeError(f"no peer called {name!r}; there are {', '.join(PEERS)}")
    return names


def parse_sizes(text: str) -> list[Size]:
    sizes = [tuple(int(n) for n in size.split("x") if n.isdigit()) for size in text.split(",")]
    if any(len(size) != 4 for size in sizes):
        raise argparse.ArgumentTypeError(f"sizes are BxCxHxW, got {text!r}")
    return sizes


def parse_dtypes(text: str) -> list[torch.dtype]:
    names = {name_of(dtype): dtype for dtype in (torch.float32, torch.float16, torch.bfloat16, torch.float64)}
    if not set(text.split(",")) <= set(names):
        raise argparse.ArgumentTypeError(f"dtypes are {', '.join(names)}; got {text!r}")
    return [names[name] for name in text.split(",")]


def copied(size: Size, dtype: torch.dtype, stopwatch: object) -> str:
    """Time of a plain copy of such a batch on a CPU. It is below the floor where the batch fits the cache."""
    if not isinstance(stopwatch, CpuClock):
        return ""
    source = torch.ones(size, dtype=dtype).view(torch.uint8).numpy()
    target = np.zeros_like(source)
    return f" (plain copy {stopwatch.value(stopwatch.time(lambda: np.copyto(target, source))) * 1e3:.3g} ms)"


if __name__ == "__main__":
    sys.exit(main())
