"""`python -m benchmarks.plots`: the plots of docs/performance.md and docs/batches.md, from the committed results, to docs/pictures.

Nothing is measured here. Every number comes from a table in benchmarks/results.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import augmentation_table, cases, results

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"

# Titles of panels, and the modules of benchmarks/cases that they show.
PANELS = [
    ("Filters", ("filters",)),
    ("Color and enhance", ("color", "enhance")),
    ("Warps and sizes", ("geometry",)),
    ("Losses, morphology", ("losses",)),
]
GPU_SIZES = ("128x3x256x256", "32x3x1080x1920")
CPU_SIZES = ("16x3x256x256", "1x3x1080x1920")
COLORS = ("#0f766e", "#c2410c")
# The rows of the README's table, and their sizes on the GPU and on one thread of the CPU.
HEADLINE = ("sobel", "gauss11", "median5", "canny", "filter2d_3x3", "rgb_to_lab", "warp_affine", "ssim11")
HEADLINE_SIZES = {"h200": "128x3x256x256", "epyc": "16x3x256x256"}

Cases = list[tuple[str, list[float | None]]]  # a case and its value at each size


def table(machine: str, name: str) -> list[dict[str, str]]:
    return results.read(results.FOLDER / machine / f"{name}.csv")[1]


def quotients(machine: str, modules: Sequence[str], sizes: Sequence[str], above: str, below: str) -> Cases:
    """One column over another for every float32 case of the modules that has both, at these sizes."""
    names = {case.name for module in modules for case in getattr(cases, module).CASES}
    values: dict[str, dict[str, float]] = {}
    for row in table(machine, "cases"):
        if row["case"] in names and row["dtype"] == "float32" and row["size"] in sizes and row[above] and row[below]:
            values.setdefault(row["case"], {})[row["size"]] = float(row[above]) / float(row[below])
    order = [case.name for module in modules for case in getattr(cases, module).CASES if case.name in values]
    return [(name, [values[name].get(size) for size in sizes]) for name in order]


def headline(machine: str) -> Cases:
    """Milliseconds forward of kvision, Kornia and OpenCV for each row of the README's table that the machine has."""
    rows = {
        row["case"]: row
        for row in table(machine, "cases")
        if row["size"] == HEADLINE_SIZES[machine] and row["dtype"] == "float32"
    }
    columns = ("forward", "kornia forward", "opencv forward")
    times = [
        (name, [float(rows[name][c]) if rows[name].get(c) else None for c in columns])
        for name in HEADLINE
        if name in rows
    ]
    if machine == "h200":
        first = table(machine, "augmentation")[0]
        times.append(("crop, flip, jitter, normalize", [float(first["kvision ms"]), float(first["kornia ms"]), None]))
    return times


def batches() -> dict[str, list[tuple[int, float]]]:
    """Batch size and milliseconds a batch of every library of the Sobel figure."""
    curves: dict[str, list[tuple[int, float]]] = {}
    for row in table("h200", "sobel_figure"):
        curves.setdefault(row["library"], []).append((int(row["batch"]), float(row["ms"])))
    return curves


def augmentations() -> list[dict[str, Any]]:
    """The rows of the table of augmentations, one for each batch."""
    keys = ("operation", "library", "device")
    return [
        {**row, "batch": int(batch), "side": int(side), "ms": float(ms)}
        for row in table("h200", "augmentation_table")
        for shape, ms in row.items()
        if shape not in keys and ms
        for batch, side in [shape.split("x")]
    ]


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
    save(figure, path)


def style() -> None:
    """The same bits for the same numbers, with text as text."""
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams.update(
        {"svg.hashsalt": "kvision", "svg.fonttype": "none", "font.size": 8, "font.family": "DejaVu Sans"}
    )


def panels_of(groups: Sequence[tuple[str, Cases]], width: float, height: float) -> tuple[Any, Any, int]:
    """A figure with a panel of this width for each group, its axes, and the cases of the longest group, each of this height."""
    style()
    import matplotlib.pyplot as plt

    longest = max(len(rows) for _, rows in groups)
    size = (width * len(groups), 1.1 + height * longest)
    return *plt.subplots(1, len(groups), figsize=size, squeeze=False, layout="constrained"), longest


def save(figure: Any, path: Path) -> None:
    import matplotlib.pyplot as plt

    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def dots(path: Path, groups: Sequence[tuple[str, Cases]], sizes: Sequence[str], label: str) -> None:
    """Cases from top to bottom, a dot for each size; one panel a group, on a logarithmic scale with a line at 1."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    figure, axes, longest = panels_of(groups, 2.6, 0.15)
    for axis, (title, rows) in zip(axes[0], groups):
        for i, (size, color) in enumerate(zip(sizes, COLORS)):
            points = [(values[i], y) for y, (_, values) in enumerate(rows) if values[i] is not None]
            axis.scatter([x for x, _ in points], [y for _, y in points], 14, color, label=size, zorder=3)
        axis.set_yticks(range(len(rows)), [case for case, _ in rows])
        axis.set_ylim(longest - 0.5, -0.8)
        axis.set_xscale("log")
        axis.axvline(1, color="#8a8a8a", linewidth=0.8)
        axis.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        axis.xaxis.set_minor_formatter(NullFormatter())
        values = [value for _, pair in rows for value in pair if value is not None]
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
    save(figure, path)


def bars(path: Path, groups: Sequence[tuple[str, Cases]], labels: Sequence[str], label: str) -> None:
    """Cases from top to bottom, a bar for each library; one panel a group, on logarithmic scales."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    figure, axes, longest = panels_of(groups, 4.6, 0.36)
    for axis, (title, rows) in zip(axes[0], groups):
        for i, (name, color) in enumerate(zip(labels, (*COLORS, "#8a8a8a"))):
            measured = [(y + 0.26 * (i - 1), times[i]) for y, (_, times) in enumerate(rows) if times[i] is not None]
            if measured:
                axis.barh([y for y, _ in measured], [ms for _, ms in measured], 0.24, color=color, label=name)
        axis.set_yticks(range(len(rows)), [case for case, _ in rows])
        axis.set_ylim(longest - 0.4, -0.6)
        axis.set_xscale("log")
        shortest = min(ms for _, times in rows for ms in times if ms is not None)
        axis.set_xlim(10 ** math.floor(math.log10(shortest)), None)
        axis.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set_axisbelow(True)
        axis.grid(axis="x", color="#e4e4e4")
        axis.set_title(title, fontsize=9)
        axis.set_xlabel(label)
        axis.legend(frameon=False, loc="lower right", handlelength=1.2)
        for side in ("top", "right", "left"):
            axis.spines[side].set_visible(False)
        axis.tick_params(axis="y", length=0)
    save(figure, path)


def main() -> int:
    def panels(machine: str, sizes: Sequence[str], above: str, below: str) -> list[tuple[str, Cases]]:
        groups = [(title, quotients(machine, modules, sizes, above, below)) for title, modules in PANELS]
        return [(title, of_group) for title, of_group in groups if of_group]

    titles = {"h200": "One NVIDIA H200, 128x3x256x256", "epyc": "One thread of an AMD EPYC, 16x3x256x256"}
    groups = [(title, headline(machine)) for machine, title in titles.items()]
    bars(PICTURES / "headline.svg", groups, ("kvision", "Kornia", "OpenCV"), "milliseconds, less is better")
    floor = panels("h200", GPU_SIZES, "forward", "forward floor")
    dots(PICTURES / "h200_floor.svg", floor, GPU_SIZES, "time / floor")
    kornia = panels("h200", GPU_SIZES, "kornia forward", "forward")
    dots(PICTURES / "h200_kornia.svg", kornia, GPU_SIZES, "Kornia's time / kvision's")
    opencv = panels("epyc", CPU_SIZES, "opencv forward", "forward")
    dots(PICTURES / "epyc_opencv.svg", opencv, CPU_SIZES, "OpenCV's time / kvision's")
    curves(PICTURES / "sobel_batches.svg", batches(), "milliseconds a batch")
    style()
    title = "Augmentation on one NVIDIA H200 and on one thread of its host"
    save(augmentation_table.draw(augmentations(), title), PICTURES / "augmentation_batches.svg")
    return 0


if __name__ == "__main__":
    sys.exit(main())
