"""The commands of the benchmarks of augmentation and of inputs, on small images."""

from __future__ import annotations

import gc
from pathlib import Path

import pytest

import kvision.augmentation as A
from benchmarks import augmentation_bars, augmentation_table, corruptions, inputs, results
from benchmarks.timing import Clock, CpuClock


@pytest.fixture(autouse=True)
def quick_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """One round with one timed call; the copies that measure the bandwidth of memory would take seconds.

    Clocks collect garbage before each round, among what these tests make alone.
    """
    gc.freeze()
    monkeypatch.setattr(Clock.__init__, "__defaults__", (0.0, 1))
    monkeypatch.setattr(Clock, "min_calls", 1)
    monkeypatch.setattr(CpuClock, "copy_bandwidth", lambda self: 1e10)


def test_table_by_size_and_batch(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--repeats", "3", "--seconds", "0", "--sizes", "16,24", "--batches", "1,2", "--out", str(tmp_path)]
    assert augmentation_table.main(options) == 0
    _, rows = results.read(tmp_path / "table.csv")
    rows = [row for row in rows if (row.pop("library"), row.pop("device")) == ("kvision", "cpu")]
    assert [row.pop("operation") for row in rows] == [*augmentation_table.OPERATIONS] and len(rows) == 11
    assert all(row.keys() == {"1x16", "1x24", "2x16"} and min(map(float, row.values())) > 0 for row in rows)
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith("RandomErasing") for line in lines) >= 2


def test_bars(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    small = [p._replace(size=(2, *p.size[1:-2], 32, 32)) for p in augmentation_bars.PIPELINES]
    monkeypatch.setattr(augmentation_bars, "PIPELINES", small)
    assert augmentation_bars.main(["--device", "cpu", "--seconds", "0.001"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line[:20].rstrip() for line in lines[-len(small) :]] == [p.name for p in small]
    assert augmentation_bars.checked(0.2, 0.1, 3) == "0.200! (0.1)" and augmentation_bars.checked(7, None, 0) == "7"


def test_corruptions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Rows by parts of names; classes and common corruptions have them, and those with a reason are among them."""
    for name, value in (("CPU_BATCH", 1), ("SIDE", 48)):
        monkeypatch.setattr(corruptions, name, value)
    table = tmp_path / "table.csv"
    assert corruptions.main(["Grid", "contrast", "--device", "cpu", "--seconds", "0", "--csv", str(table)]) == 0
    rows = [line.split()[0] for line in capsys.readouterr().out.splitlines()[3:]]
    assert rows == [row["augmentation"] for row in results.read(table)[1]]
    assert rows == ["GridDropout", "GridMask", "GridDistortion", "contrast"]
    names = {name for name, _ in corruptions.augmentations()}
    assert names >= {*corruptions.REASONS, *A.CommonCorruption.NAMES}


def test_inputs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Every group prints its figures; those of another run replace the rows of its groups alone."""
    monkeypatch.setattr(inputs, "dead_leaves", lambda size: inputs.torch.rand(size[0], 90, 70))
    for name, value in (("SIDE", 64), ("FRAME", (64, 96)), ("CROP", (32, 32))):
        monkeypatch.setattr(inputs, name, value)
    monkeypatch.setattr(inputs.Setup, "bandwidth", 1e10)  # the copies that measure it take seconds
    table = tmp_path / "inputs.csv"
    options = ["--device", "cpu", "--seconds", "0.001", "--count", "2", "--csv", str(table)]
    assert inputs.main(options) == 0
    lines = capsys.readouterr().out.splitlines()
    about, rows = results.read(table)
    assert {row["group"] for row in rows} == inputs.GROUPS.keys() and len(about) == 1
    assert all(float(row["value"]) > 0 and any(row["name"] in line for line in lines) for row in rows)
    assert inputs.main([*options, "bytes"]) == 0
    assert len(results.read(table)[1]) == len(rows)
    assert inputs.Figure("", "", 0.9, "", 0.97, True).is_missed and not inputs.Figure("", "", 1.2, "", 1.25).is_missed
