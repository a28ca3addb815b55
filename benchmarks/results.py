"""The committed tables: benchmarks/results/MACHINE/BENCHMARK.csv. Lines that begin with # say how a table was made."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.measure import KVISION, Row

FOLDER = Path(__file__).parent / "results"
_STAGES = {"forward": "forward", "backward": "backward", "forward+backward": "both"}


def read(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """The lines about a table, and its rows by column."""
    lines = path.read_text().splitlines()
    about = [line for line in lines if line.startswith("#")]
    return about, list(csv.DictReader(lines[len(about) :]))


def write(path: Path, about: Sequence[str], rows: Sequence[dict[str, str]]) -> None:
    columns = list(dict.fromkeys(column for row in rows for column in row))
    with path.open("w", newline="") as file:
        file.writelines(f"{line}\n" for line in about)
        table = csv.DictWriter(file, columns, lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def merge_cases(path: Path, measured: Sequence[Row], machine: dict[str, Any]) -> None:
    """Replace the figures of cases, sizes and types that were measured; a row each, with a column for every stage and library."""
    about, rows = read(path) if path.exists() else ([f"# {machine['hardware']}, torch {machine['torch']}: ms"], [])
    by_key = {(row["case"], row["size"], row["dtype"]): row for row in rows}
    for m in measured:
        if m.value is None:
            continue
        row = by_key.setdefault((m.case, m.size, m.dtype), {"case": m.case, "size": m.size, "dtype": m.dtype})
        stage = _STAGES[m.stage]
        row[stage if m.library == KVISION else f"{m.library} {stage}"] = f"{m.value * 1e3:.3g}"
        if m.library == KVISION:
            row[f"{stage} floor"] = f"{m.floor * 1e3:.3g}"
            row |= {"date": machine["date"][:10], "commit": machine["commit"] or ""}
            if m.launches is not None:
                row |= {"extra": f"{m.extra or 0:.2f}", "launches": str(m.launches)}
            if m.host is not None:
                row["host us"] = f"{m.host * 1e6:.1f}"
    write(path, about, list(by_key.values()))
