"""`python -m benchmarks.plots`: the plots of docs/performance.md and docs/batches.md, from the committed results, to docs/pictures.

Nothing is measured here. Every number comes from a table in benchmarks/results.
"""

from __future__ import annotations

import csv
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PICTURES = ROOT / "docs" / "pictures"

# Titles of panels, and the tables of results that they show.
H200 = [
    ("Filters", "filters"),
    ("Color and enhance", "color"),
    ("Warps and sizes", "geometry"),
    ("Losses, morphology", "losses"),
]
EPYC = [("Filters", ["filters"]), ("Color and enhance", ["color"]), ("Warps and sizes", ["warps", "sizes"])]
GPU_SIZES = ("128x3x256x256", "32x3x1080x1920")
CPU_SIZES = ("16x3x256x256", "1x3x1080x1920")
COLORS = ("#0f766e", "#c2410c")

NUMBER = r" +([\d.e+-]+)"
ROW = rf"(\S*) +(?:(forward\+backward|forward|backward) +)?([a-z]+){NUMBER}{NUMBER} +\d+%{NUMBER}{NUMBER} "
Cases = list[tuple[str, list[float | None]]]  # a case and its value at each size


class Row(NamedTuple):
    """One library in one case: milliseconds (median and minimum) and the median over the floor."""

    size: str
    case: str
    stage: str
    library: str
    median: float
    minimum: float
    over_floor: float


def rows(text: str) -> list[Row]:
    """The rows of the tables that `python -m benchmarks` prints, at any size."""
    table_rows: list[Row] = []
    size = case = stage = ""
    for line in text.splitlines():
        heading = re.match(r"(\d+(?:x\d+)+) float32", line)
        if heading:
            size, case, stage = heading[1], "", ""
            continue
        row = re.match(ROW, line)
        if row and size:
            case, stage = row[1] or case, row[2] or stage
            table_rows.append(Row(size, case, stage, row[3], float(row[4]), float(row[5]), float(row[7])))
    return table_rows


def table(machine: str, file: str) -> list[Row]:
    return rows((RESULTS / machine / f"{file}.txt").read_text())


def over_floor(file: str) -> Cases:
    """Time over the floor of every case of a file, forward, at both sizes, on the H200."""
    of = {
        (row.case, row.size): row.over_floor
        for row in table("h200", file)
        if (row.stage, row.library) == ("forward", "kvision")
    }
    return [(case, [of.get((case, size)) for size in GPU_SIZES]) for case in dict.fromkeys(case for case, _ in of)]


def speedup(machine: str, files: Sequence[str], peer: str, sizes: Sequence[str], without: str | None = None) -> Cases:
    """The peer's time over kvision's of the same run, forward; without the cases of another file.

    Medians on the GPU and minima on the CPU, as benchmarks/README.md says.
    """
    ratio: dict[tuple[str, str], float] = {}
    for file in files:
        forward = [row for row in table(machine, file) if row.stage == "forward"]
        times = {(row.case, row.size, row.library): row.median if machine == "h200" else row.minimum for row in forward}
        for (case, size, library), time in times.items():
            if library == peer:
                ratio[case, size] = time / times[case, size, "kvision"]
    left_out = {row.case for row in table(machine, without)} if without else set()
    cases = dict.fromkeys(case for case, _ in ratio if case not in left_out)
    return [(case, [ratio.get((case, size)) for size in sizes]) for case in cases]


def batches() -> dict[str, list[tuple[int, float]]]:
    """Batch size and milliseconds a batch of every library of the Sobel figure."""
    curves: dict[str, list[tuple[int, float]]] = {}
    with (RESULTS / "h200" / "sobel_figure" / "sobel.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            curves.setdefault(row["library"], []).append((int(row["batch"]), float(row["ms"])))
    return curves


def curves(path: Path, lines: dict[str, list[tuple[int, float]]], label: str) -> None:
    """Both axes logarithmic; a panel for the CPU and one for the GPU, where a library names its device."""
    import matplotlib

    style()
    import matplotlib.pyplot as plt
    from matplotlib.ticker import FuncFormatter

    panels = {"CPU": [name for name in lines if not name.endswith(" cuda")]}
    panels["GPU"] = [name for name in lines if name.endswith(" cuda")]
    colors = matplotlib.colormaps["tab10"]
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), sharey=True, layout="constrained")
    for axis, (device, names) in zip(axes, panels.items()):
        for i, name in enumerate(sorted(names, key=lambda name: -lines[name][-1][1])):  # as they lie
            own = name.startswith("kvision")
            xs, ys = zip(*lines[name])
            color = COLORS[0] if own else COLORS[1] if name.startswith("kornia") else colors(i)
            axis.loglog(
                xs, ys, marker="o", markersize=3, color=color, linewidth=2.2 if own else 1.2, label=name.split()[0]
            )
        ticks = [x for x, _ in lines[names[0]]]
        axis.set_xscale("log", base=2)
        axis.set_xticks(ticks, [str(x) for x in ticks])
        axis.set_ylim(None, 6000)
        axis.legend(frameon=False, loc="upper left", ncols=3)
        axis.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))
        axis.grid(color="#e4e4e4")
        axis.set_title(device, fontsize=9)
        axis.set_xlabel("images in a batch")
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    axes[0].set_ylabel(label)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def style() -> None:
    """The same bits for the same numbers, with text as text."""
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams.update(
        {"svg.hashsalt": "kvision", "svg.fonttype": "none", "font.size": 8, "font.family": "DejaVu Sans"}
    )


def dots(path: Path, groups: Sequence[tuple[str, Cases]], sizes: Sequence[str], label: str) -> None:
    """Cases from top to bottom, a dot for each size; one panel a group, on a logarithmic scale with a line at 1."""
    style()
    import matplotlib.pyplot as plt
    from matplotlib.ticker import FuncFormatter, NullFormatter

    longest = max(len(cases) for _, cases in groups)
    figure, axes = plt.subplots(
        1, len(groups), figsize=(2.6 * len(groups), 1.1 + 0.15 * longest), squeeze=False, layout="constrained"
    )
    for axis, (title, cases) in zip(axes[0], groups):
        for i, (size, color) in enumerate(zip(sizes, COLORS)):
            points = [(values[i], y) for y, (_, values) in enumerate(cases) if values[i] is not None]
            axis.scatter([x for x, _ in points], [y for _, y in points], 14, color, label=size, zorder=3)
        axis.set_yticks(range(len(cases)), [case for case, _ in cases])
        axis.set_ylim(longest - 0.5, -0.8)
        axis.set_xscale("log")
        axis.axvline(1, color="#8a8a8a", linewidth=0.8)
        axis.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        axis.xaxis.set_minor_formatter(NullFormatter())
        values = [value for _, pair in cases for value in pair if value is not None]
        ticks = [
            t
            for t in (0.5, 1, 2, 3, 5, 10, 20, 50, 100, 200, 500, 1000, 3000)
            if 0.9 * min(1, *values) <= t <= 1.2 * max(values)
        ]
        axis.set_xticks(ticks[:: 2 if len(ticks) > 5 else 1])
        axis.grid(axis="x", color="#e4e4e4")
        axis.set_title(title, fontsize=9)
        axis.set_xlabel(label)
        for side in ("top", "right", "left"):
            axis.spines[side].set_visible(False)
        axis.tick_params(axis="y", length=0)
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def main() -> int:
    dots(PICTURES / "h200_floor.svg", [(title, over_floor(file)) for title, file in H200], GPU_SIZES, "time / floor")
    kornia = [
        ("Filters", speedup("h200", ["filters"], "kornia", GPU_SIZES)),
        ("Color and enhance", speedup("h200", ["all", "histogram"], "kornia", GPU_SIZES, without="filters")),
        ("Warps and sizes", speedup("h200", ["geometry"], "kornia", GPU_SIZES)),
        ("Losses, morphology", speedup("h200", ["losses"], "kornia", GPU_SIZES)),
    ]
    dots(PICTURES / "h200_kornia.svg", kornia, GPU_SIZES, "Kornia's time / kvision's")
    opencv = [(title, speedup("epyc", files, "opencv", CPU_SIZES)) for title, files in EPYC]
    dots(PICTURES / "epyc_opencv.svg", opencv, CPU_SIZES, "OpenCV's time / kvision's")
    curves(PICTURES / "sobel_batches.svg", batches(), "milliseconds a batch")
    return 0


if __name__ == "__main__":
    sys.exit(main())
