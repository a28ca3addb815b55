"""`python -m benchmarks.augmentation_table`: Table 2 of the paper on augmentation in Kornia (Shi et al., 2020) on this machine.

Median wall time of eleven operations on one image of 224 to 600 pixels a side, and on batches of 1 to 128 images of 224. kvision,
Kornia and torchvision are measured, as far as they are installed, on the CPU and, where there is one, on a GPU. The time of a GPU
call ends when its result is ready. Every operation always acts. torchvision draws one set of parameters for a batch. Writes
table.csv, whose columns are images x side, and, where matplotlib is installed, batches.png.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import kvision.augmentation as A
from benchmarks import machine, results
from benchmarks.augmentation import JITTER, imported_libraries
from benchmarks.case import photographs
from benchmarks.peers import set_threads
from benchmarks.sobel_figure import wall_times
from benchmarks.table import number

SIZES, BATCHES = (224, 320, 448, 600), tuple(2**n for n in range(8))
COLORS = {"kvision": "#0f766e", "kornia": "#c2410c", "torchvision": "#64748b"}

# Operations of kvision and Kornia, which have the same names, and of torchvision; `n` is the side of the images.
Make = Callable[[Any, int], Callable[[Tensor], Tensor]]
OPERATIONS: dict[str, tuple[Make, Make]] = {
    "RandomPerspective": (lambda K, n: K.RandomPerspective(0.5, p=1.0), lambda T, n: T.RandomPerspective(0.5, p=1.0)),
    "ColorJitter": (lambda K, n: K.ColorJitter(*JITTER, p=1.0), lambda T, n: T.ColorJitter(*JITTER)),
    "RandomAffine": (
        lambda K, n: K.RandomAffine(30.0, (0.1, 0.1), (0.8, 1.2), 10.0, p=1.0),
        lambda T, n: T.RandomAffine(30.0, (0.1, 0.1), (0.8, 1.2), 10.0),
    ),
    "RandomVerticalFlip": (lambda K, n: K.RandomVerticalFlip(p=1.0), lambda T, n: T.RandomVerticalFlip(1.0)),
    "RandomHorizontalFlip": (lambda K, n: K.RandomHorizontalFlip(p=1.0), lambda T, n: T.RandomHorizontalFlip(1.0)),
    "RandomRotation": (lambda K, n: K.RandomRotation(30.0, p=1.0), lambda T, n: T.RandomRotation(30.0)),
    "RandomCrop": (lambda K, n: K.RandomCrop((7 * n // 8,) * 2), lambda T, n: T.RandomCrop(7 * n // 8)),
    "RandomErasing": (lambda K, n: K.RandomErasing(p=1.0), lambda T, n: T.RandomErasing(1.0)),
    "RandomGrayscale": (lambda K, n: K.RandomGrayscale(p=1.0), lambda T, n: T.RandomGrayscale(1.0)),
    "RandomResizedCrop": (
        lambda K, n: K.RandomResizedCrop((7 * n // 8,) * 2),
        lambda T, n: T.RandomResizedCrop(7 * n // 8, antialias=False),
    ),
    "CenterCrop": (lambda K, n: K.CenterCrop(7 * n // 8), lambda T, n: T.CenterCrop(7 * n // 8)),
}


def numbers(text: str) -> list[int]:
    return [int(n) for n in text.split(",")]


def calls(device: torch.device, libraries: dict[str, Any], batch: int, side: int) -> Iterator[tuple[str, str, Any]]:
    """(operation, library, call) of every operation on a batch."""
    (images,) = photographs((batch, 3, side, side), torch.float32, device)
    for name, (of_kornia, of_torchvision) in OPERATIONS.items():
        for library, module in libraries.items():
            augment = (of_torchvision if library == "torchvision" else of_kornia)(module, side)

            def call(augment: Any = augment) -> None:
                augment(images)
                if device.type == "cuda":
                    torch.cuda.synchronize()

            yield name, library, call


def by_shape(rows: Sequence[dict[str, Any]]) -> list[dict[str, str]]:
    """A row for each operation, library and device, with a column for each batch."""
    table: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows:
        keys = {name: row[name] for name in ("operation", "library", "device")}
        table.setdefault(tuple(keys.values()), keys)[f"{row['batch']}x{row['side']}"] = f"{row['ms']:.3g}"
    return list(table.values())


def draw(rows: Sequence[dict[str, Any]], title: str) -> Any:
    """A figure with a panel for each operation: milliseconds against the size of the batch."""
    from matplotlib import pyplot

    side = min(row["side"] for row in rows)
    rows = [row for row in rows if row["side"] == side]
    ticks = sorted({row["batch"] for row in rows})
    figure, axes = pyplot.subplots(3, 4, figsize=(10, 7), sharex=True, sharey=True, layout="constrained")
    for axis, name in zip(axes.flat, OPERATIONS):
        for library, device in dict.fromkeys((row["library"], row["device"]) for row in rows):
            own = [r for r in rows if (r["operation"], r["library"], r["device"]) == (name, library, device)]
            line = "-" if device == "cuda" else "--"
            label = f"{library}, {'GPU' if device == 'cuda' else 'CPU'}"
            xs, ys = [r["batch"] for r in own], [r["ms"] for r in own]
            axis.loglog(xs, ys, line, color=COLORS[library], marker="o", markersize=3, label=label)
        axis.set_xscale("log", base=2)
        axis.set_xticks(ticks, list(map(str, ticks)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.set_title(name, fontsize=9)
        axis.grid(which="major", alpha=0.3)
    for axis in axes.flat[len(OPERATIONS) :]:
        axis.axis("off")
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="lower right", frameon=False)
    figure.supxlabel(f"images in a batch (RGB, {side}x{side})")
    figure.supylabel("milliseconds a batch, median")
    figure.suptitle(title, fontsize=10)
    return figure


def print_table(rows: Sequence[dict[str, Any]], by: str, values: Sequence[int], libraries: Sequence[str]) -> None:
    """Operations down, libraries and sizes across; `by` is "side" or "batch"."""
    for device in dict.fromkeys(row["device"] for row in rows):
        times = {(r["operation"], r["library"], r[by]): r["ms"] for r in rows if r["device"] == device}
        print(f"\n{device:22}" + "".join(f"{library:>{9 * len(values)}}" for library in libraries))
        print(f"{by:22}" + "".join(f"{value:>9}" for value in values) * len(libraries))
        for name in OPERATIONS:
            cells = (number(times.get((name, library, value))) or "-" for library in libraries for value in values)
            print(f"{name:22}" + "".join(f"{cell:>9}" for cell in cells))


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.augmentation_table", description=__doc__)
    parse.add_argument("--out", type=Path, default=Path("out/augmentation_table"), metavar="DIR")
    parse.add_argument("--repeats", type=int, default=100)
    parse.add_argument(
        "--seconds", type=float, default=0.3, help="most time for one cell; then fewer repeats are taken"
    )
    parse.add_argument("--threads", type=int, default=1, help="of torch on the CPU (default 1)")
    parse.add_argument("--sizes", type=numbers, default=list(SIZES), help="sides of one image")
    parse.add_argument("--batches", type=numbers, default=list(BATCHES), help="numbers of images of the first size")
    here = ["cpu", "cuda"] if torch.cuda.is_available() else ["cpu"]
    parse.add_argument("--devices", nargs="+", choices=here, default=here)
    options = parse.parse_args(arguments)
    warnings.simplefilter("ignore")
    set_threads(options.threads)
    devices = options.devices
    libraries = {"kvision": A, **imported_libraries()}
    about = machine.describe(
        torch.device(devices[-1]), [name for name in libraries if name != "kvision" and find_spec(name)]
    )
    options.out.mkdir(parents=True, exist_ok=True)

    shapes = dict.fromkeys([(1, side) for side in options.sizes] + [(n, options.sizes[0]) for n in options.batches])
    rows: list[dict[str, Any]] = []
    for device in devices:
        for batch, side in shapes:
            for name, library, call in calls(torch.device(device), libraries, batch, side):
                times = wall_times(call, options.repeats, options.seconds)
                row = {"operation": name, "library": library, "device": device, "batch": batch, "side": side}
                rows.append({**row, "ms": 1e3 * statistics.median(times), "repeats": len(times)})
            print(f"\r{device} {batch}x3x{side}x{side}" + " " * 20, end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)

    print(
        f"{about['hardware']} / {about['cpu']}  threads {about['threads']}  {about['date']}  kvision {about['commit']}",
        end="  ",
    )
    print(
        f"torch {about['torch']}  {about['peers']}\n$ {about['command']}\nfloat32, median wall ms of a call; one image:"
    )
    print_table([row for row in rows if row["batch"] == 1], "side", options.sizes, list(libraries))
    print(f"\nbatches of {options.sizes[0]}x{options.sizes[0]}:")
    print_table([row for row in rows if row["side"] == options.sizes[0]], "batch", options.batches, list(libraries))

    made = f"# {about['hardware']} / {about['cpu']}, {about['threads']} CPU threads, torch {about['torch']}: `{about['command']}`"
    results.write(options.out / "table.csv", [made, "# ms, medians, of images x side"], by_shape(rows))
    try:
        import matplotlib
    except ImportError:
        print("no batches.png: matplotlib is not installed")
    else:
        matplotlib.use("Agg")
        figure = draw(rows, f"Augmentation, {about['hardware']}, {about['threads']} CPU threads")
        figure.savefig(options.out / "batches.png", dpi=120)
    print(f"written to {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
