"""`python -m benchmarks.sobel_figure`: the Sobel figure of the Kornia paper (Riba et al., WACV 2020) on this machine.

Median wall time of the Sobel magnitude of a batch of RGB images of 256x256, for batches of 1 to 128, for every library
installed and, where there is a GPU, on it too; the time of a GPU call ends when its result is ready. Writes sobel.csv,
sobel.json and, where matplotlib is installed, sobel.png.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import torch

from benchmarks import machine, peers
from benchmarks.cases import ALL
from benchmarks.measure import KVISION
from benchmarks.peers import PEERS
from benchmarks.table import number
from benchmarks.timing import Call

CASE = ALL["sobel"]
MIN_REPEATS = 3  # minimum number of repeats for slow libraries


def contestants(batch: int, side: int) -> Iterator[tuple[str, Call]]:
    """(name, call) of every library on each of its devices."""
    for device in ["cpu", "cuda"] if torch.cuda.is_available() else ["cpu"]:
        inputs = CASE.inputs((batch, 3, side, side), torch.float32, torch.device(device))
        for library, work in {KVISION: CASE.call, **CASE.peers}.items():
            peer = PEERS.get(library)
            if peer is None or (peer.installed and peer.serves(inputs[0].device, torch.float32)):
                bind = peers.tensors if peer is None else peer.bind
                suffix = f" {device}" if bind is peers.tensors else ""
                call = bind(work, inputs, CASE.result).call
                yield library + suffix, (lambda c=call: (c(), torch.cuda.synchronize())) if device == "cuda" else call


def wall_times(call: Call, repeats: int, seconds: float) -> list[float]:
    """Wall time of each of `repeats` calls, or of as many as fit in `seconds`."""
    call()
    times: list[float] = []
    deadline = time.perf_counter() + seconds
    while len(times) < repeats and (len(times) < MIN_REPEATS or time.perf_counter() < deadline):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return times


def plot(rows: Sequence[dict[str, Any]], title: str, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8, 5.5), layout="constrained")
    for library in dict.fromkeys(row["library"] for row in rows):
        own = [row for row in rows if row["library"] == library]
        bold = {"linewidth": 2.5, "zorder": 3} if library.startswith(KVISION) else {"linewidth": 1.2}
        axes.loglog([r["batch"] for r in own], [r["ms"] for r in own], marker="o", markersize=4, label=library, **bold)
    ticks = sorted({row["batch"] for row in rows})
    axes.set_xscale("log", base=2)
    axes.set_xticks(ticks, list(map(str, ticks)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("batch size (RGB, 256x256)")
    axes.set_ylabel("ms a batch, median")
    axes.set_title(title, fontsize=10)
    axes.grid(which="major", alpha=0.3)
    axes.legend(frameon=False, ncols=2)
    figure.savefig(path, dpi=150)
    pyplot.close(figure)


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.sobel_figure", description=__doc__)
    parse.add_argument("--out", type=Path, default=Path("out/sobel_figure"), metavar="DIR")
    parse.add_argument("--repeats", type=int, default=500)
    parse.add_argument("--seconds", type=float, default=20, help="most time for one cell; then fewer repeats are taken")
    parse.add_argument("--threads", type=int, default=os.cpu_count(), help="of torch and OpenCV; default: all cores")
    parse.add_argument(
        "--batches", type=lambda text: [int(n) for n in text.split(",")], default=[2**n for n in range(8)]
    )
    parse.add_argument("--side", type=int, default=256, help=argparse.SUPPRESS)  # for tests
    options = parse.parse_args(arguments)
    peers.set_threads(options.threads)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    about = machine.describe(device, [name for name in CASE.peers if PEERS[name].installed])
    options.out.mkdir(parents=True, exist_ok=True)

    rows: list[dict[str, Any]] = []
    for batch in options.batches:
        for library, call in contestants(batch, options.side):
            times = wall_times(call, options.repeats, options.seconds)
            rows.append(
                {"library": library, "batch": batch, "ms": statistics.median(times) * 1e3, "repeats": len(times)}
            )
            print(f"\r{library} batch {batch}" + " " * 20, end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)

    print(f"{about['hardware']} / {about['cpu']}  threads {about['threads']}  torch {about['torch']}  {about['date']}")
    print(f"$ {about['command']}\nSobel magnitude of RGB {options.side}x{options.side}, median wall ms a batch\n")
    print(f"{'batch':16}" + "".join(f"{batch:>10}" for batch in options.batches))
    for library in dict.fromkeys(row["library"] for row in rows):
        own = [row for row in rows if row["library"] == library]
        cells = (f"{number(row['ms'])}{'*' if row['repeats'] < options.repeats else ' '}" for row in own)
        print(f"{library:16}" + "".join(f"{cell:>10}" for cell in cells))
    fewest = min(row["repeats"] for row in rows)
    short = f"; * as many as fitted in {options.seconds:g} s, at least {fewest}" if fewest < options.repeats else ""
    print(f"\n{options.repeats} repeats{short}")

    with (options.out / "sobel.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, ["library", "batch", "ms", "repeats"])
        writer.writeheader()
        writer.writerows(rows)
    (options.out / "sobel.json").write_text(json.dumps({"machine": about, "rows": rows}, indent=1) + "\n")
    try:
        plot(rows, f"Sobel, {about['hardware']}, {about['threads']} CPU threads", options.out / "sobel.png")
    except ImportError:
        print("no sobel.png: matplotlib is not installed")
    print(f"written to {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
