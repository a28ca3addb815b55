"""Text tables of rows, bars and faster peers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from benchmarks.awkward import Ratio
from benchmarks.bars import CheckedBar, Loss
from benchmarks.measure import KVISION, Row

LEGEND = """\
ms: median, min: minimum, +-: interquartile range over median; floor: ms that the bytes to read and write once take at
copy bandwidth; xfloor: time over floor; xkv: time over kvision's; eq: = equal to kvision, b but for the border,
~ close, x different"""
CUDA_LEGEND = """\
extra: GPU memory beyond input and output (and gradients), in units of input + output; launches: kernels, fills and
copies of one call; host: us of host time for one call on 1x3x256x256"""

COLUMNS = (
    ("case", 17), ("stage", 17), ("library", 12), ("ms", 9), ("min", 9), ("+-", 6), ("floor", 8), ("xfloor", 8),
    ("xkv", 8), ("eq", 3),
)  # fmt: skip
CUDA_COLUMNS = (*COLUMNS, ("extra", 7), ("launches", 9), ("host", 7))


class Table:
    """Formats rows one by one; a row that repeats the case or the stage of the row above leaves that cell empty."""

    def __init__(self, cuda: bool) -> None:
        self._columns = CUDA_COLUMNS if cuda else COLUMNS
        self._above: tuple[str, str] = ("", "")
        self._kvision: dict[tuple[str, ...], float] = {}

    def header(self) -> str:
        self._above = ("", "")
        return self._line(name for name, _ in self._columns)

    def line(self, row: Row) -> str:
        cell = (row.case, row.size, row.dtype, row.stage)
        if row.library == KVISION and row.value is not None:
            self._kvision[cell] = row.value
        case = row.case if row.case != self._above[0] else ""
        stage = row.stage if case or row.stage != self._above[1] else ""
        self._above = (row.case, row.stage)
        if row.failure is not None:
            return self._line((case, stage, row.library)) + f"  FAILED {row.failure}"
        ours = self._kvision.get(cell)
        return self._line((
            case,
            stage,
            row.library,
            number(row.timing.median * 1e3),
            number(row.timing.minimum * 1e3),
            f"{row.timing.spread:.0%}",
            number(row.floor * 1e3),
            number(row.value / row.floor),
            number(ours and row.value / ours),
            row.agreement,
            None if row.extra is None else f"{row.extra:.2f}",
            row.launches,
            None if row.host is None else f"{row.host * 1e6:.1f}",
        ))  # fmt: skip

    def _line(self, cells: Iterable[Any]) -> str:
        texts = ("-" if cell is None else str(cell) for cell in cells)
        return "".join(
            f"{text:{'<' if index < 3 else '>'}{width}}"
            for index, (text, (_, width)) in enumerate(zip(texts, self._columns))
        ).rstrip()


def number(x: float | None) -> str | None:
    """Three significant digits, without an exponent."""
    if x is None:
        return None
    return f"{x:.3g}" if x < 999.5 else f"{x:.0f}"


def heading(machine: dict[str, Any], bandwidth: float) -> str:
    """The metadata of the results in three lines."""
    versions = "  ".join(f"{name} {version}" for name, version in machine["peers"].items())
    return (
        f"{machine['hardware']}  copy {bandwidth / 1e9:.4g} GB/s  threads {machine['threads']}  {machine['date']}\n"
        f"kvision {machine['kvision']} ({machine['commit'] or 'no git'}, kernels: {machine['kernels']})"
        f"  torch {machine['torch']}  {versions}\n$ {machine['command']}"
    )


def summary(checked: Sequence[CheckedBar], lost: Sequence[Loss]) -> str:
    """Bars, a line for each case and size, missed ones in capitals. Then every peer that is faster than kvision."""
    lines = [f"bars: {sum(v.met for v in checked)} met, {sum(not v.met for v in checked)} missed (measured/bar)"]
    for cell in dict.fromkeys((v.case, v.size, v.dtype) for v in checked):
        of_cell = (v for v in checked if (v.case, v.size, v.dtype) == cell)
        lines.append(f"  {cell[0]:17}{cell[1]:18}{cell[2]:9}" + "  ".join(map(_bar, of_cell)))
    lines.append("kvision is slower than" if lost else "kvision is nowhere slower than a peer")
    for cell in dict.fromkeys((loss.case, loss.stage, loss.size, loss.dtype) for loss in lost):
        of_cell = [loss for loss in lost if (loss.case, loss.stage, loss.size, loss.dtype) == cell]
        faster = ", ".join(
            f"{loss.peer}{f' [{loss.agreement}]' if loss.agreement else ''} {loss.factor:.2f}x" for loss in of_cell
        )
        lines.append("  {:17}{:17}{:18}{:9}".format(*cell) + faster)
    return "\n".join(lines)


def ratios(worst: Sequence[Ratio]) -> str:
    """The worst ratio of each case, with its size."""
    lines = ["awkward sizes, the worst time over floor next to that of the nearest aligned size"]
    lines += [f"  {r.case:17}{r.stage:17}{r.dtype:9}{number(r.factor):>6}  {r.size}" for r in worst]
    return "\n".join(lines)


def _bar(bar: CheckedBar) -> str:
    text = f"{bar.what} {number(bar.measured)}/{number(bar.limit)}"
    return text if bar.met else f"MISSED {text}"
