"""The benchmarks measure what they say: floors, agreement, bars, losses, and the shape of what they print."""

from __future__ import annotations

import csv
import gc
import json
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks import __main__ as command
from benchmarks import awkward, kernels, overhead, results, scaling, sift_cpu, sobel_figure, threads
from benchmarks.bars import EXTRA, check, losses
from benchmarks.case import Bars, Case, dead_leaves, nonlinear_backward, photographs
from benchmarks.cases import ALL
from benchmarks.measure import BACKWARD, BOTH, FORWARD, KVISION, Row, measure
from benchmarks.peers import PEERS, agreement
from benchmarks.table import Table, summary
from benchmarks.timing import CpuClock, Timing

CPU = torch.device("cpu")
SIZE = (2, 3, 8, 9)
BYTES = 4 * 2 * 3 * 8 * 9


def rows_of(case: Case, peers: Sequence[str] = (), **options) -> list[Row]:
    return list(measure(case, SIZE, torch.float32, CPU, peers, CpuClock(0.003), 1e9, **options))


# -- floors


def test_floors_are_bytes_over_bandwidth():
    square = Case("square", lambda x: x * x, backward=nonlinear_backward)
    floors = {row.stage: row.floor for row in rows_of(square, backward=True)}
    assert floors == pytest.approx({FORWARD: 2 * BYTES / 1e9, BACKWARD: 3 * BYTES / 1e9, BOTH: 5 * BYTES / 1e9})


def test_every_output_of_a_call_counts():
    halves = Case("halves", lambda x: (x[:, :1].clone(), x[:, 1:].clone()), result=lambda y: y[1])
    (row,) = rows_of(halves)
    assert row.floor == pytest.approx(2 * BYTES / 1e9)


@pytest.mark.parametrize("name, forward, both", [("sobel", 2, 5), ("spatial_gradient", 3, 6), ("gauss5", 2, 4)])
def test_floors_of_the_filters(name, forward, both):
    rows = {row.stage: row for row in rows_of(ALL[name], backward=True)}
    assert rows[FORWARD].floor == pytest.approx(forward * BYTES / 1e9)
    assert rows[BOTH].floor == pytest.approx(both * BYTES / 1e9)


# -- clocks


def test_the_cpu_clock_tells_the_slower_contestant():
    quick, slow = CpuClock(0.02).race([lambda: time.sleep(0.001), lambda: time.sleep(0.004)])
    assert 0.001 <= quick.minimum <= quick.median < 0.004 <= slow.minimum
    assert quick.repeats > slow.repeats >= 3


def test_setup_is_not_timed():
    (timing,) = CpuClock(0.02).race([(lambda: time.sleep(0.005), lambda _: None)])
    assert timing.median < 0.001


# -- agreement


@pytest.mark.parametrize(
    "change, sign",
    [
        (lambda y: y + 1e-6, "="),
        (lambda y: torch.nn.functional.pad(y[..., 2:-2, 2:-2], (2, 2, 2, 2)), "b"),
        (lambda y: y + 5e-3, "~"),
        (lambda y: 2 * y, "x"),
        (lambda y: y[..., 1:], "x"),
        (lambda y: torch.where(y == y.max(), torch.nan, y), "x"),
    ],
)
def test_agreement(change, sign):
    ours = photographs((1, 3, 20, 20), torch.float32, CPU)[0]
    assert agreement(ours, change(ours), border=2) == sign


def double_opencv(image, out=None, scratch=None):
    scratch = np.add(image, 0, out=scratch)
    return np.add(scratch, image, out=out), scratch


def test_a_wrong_result_and_a_failing_peer_show():
    peers = {
        "kornia": lambda x: 3 * x,
        "opencv": double_opencv,
        "skimage": lambda image: image + image,
        "scipy": lambda image: image.no_such_thing(),
    }
    for peer in peers:
        pytest.importorskip(PEERS[peer].module)
    rows = {row.library: row for row in rows_of(Case("double", lambda x: 2 * x, peers), list(peers))}
    assert {name: row.agreement for name, row in rows.items()} == {
        KVISION: None, "kornia": "x", "opencv": "=", "skimage": "=", "scipy": None
    }  # fmt: skip
    assert rows["scipy"].value is None and "no_such_thing" in rows["scipy"].failure


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in ALL if name != "match_smnn10000"])  # match_smnn with more points
def test_the_cases_do_the_same_work_as_their_peers(name):
    case = ALL[name]
    exact = (
        "kornia",
        "torchvision",
        "opencv",
        "scipy",
    )  # PIL rounds to 8 bits, scikit-image has definitions of its own
    peers = [peer for peer in exact if peer in case.peers and PEERS[peer].installed]
    for row in measure(case, (2, 3, 64, 80), torch.float32, CPU, peers, CpuClock(0.001), 1e9):
        assert row.failure is None
        if row.library != KVISION:
            assert row.agreement in ("=" if row.library == "kornia" else "=b~"), row.library


# -- bars and losses


def row(library: str, stage: str = FORWARD, value: float = 1.0, dtype: str = "float32", **more) -> Row:
    return Row(
        "work", "1x3x8x8", dtype, library, stage, value, Timing(value, value, 0.0, 9), more.pop("floor", 1.0), **more
    )


def judged(bars: Bars, rows: list[Row], cuda: bool) -> dict[str, bool]:
    return {bar.what: bar.met for bar in check([Case("work", torch.neg, bars=bars)], rows, cuda)}


def test_bars_on_a_cpu():
    rows = [row(KVISION, value=1.0), row("opencv", value=1.5), row("kornia", value=0.9), row("scipy", value=0.1)]
    assert judged(Bars(opencv=0.5), rows, cuda=False) == {"of opencv's time": False, "of kornia's time": False}
    assert judged(Bars(opencv=0.7, kornia=None), rows, cuda=False) == {"of opencv's time": True}
    assert judged(Bars(opencv=1.0, kornia=None), rows[:1], cuda=False) == {}


def test_bars_on_a_gpu():
    bars = Bars(floor=1.2, both=1.4, backward=1.3, half=1.7)
    rows = [
        row(KVISION, value=1.1, launches=1, host=14e-6),
        row(KVISION, BACKWARD, value=1.5),
        row(KVISION, BOTH, value=2.6, floor=2.0, extra=EXTRA / 2),
        row(KVISION, value=0.6, dtype="float16"),
    ]
    assert judged(bars, rows, cuda=True) == {
        "floor": True,
        "f+b floor": True,
        "backward/forward": False,
        "f+b extra memory": True,
        "launches": True,
        "host us": True,
        "float16 speed-up": True,
    }
    worse = [row(KVISION, value=1.3, launches=2, host=16e-6), row(KVISION, value=0.9, dtype="float16")]
    assert not any(judged(bars, worse, cuda=True).values())


def test_losses_name_the_faster_peers_the_worst_first():
    rows = [row(KVISION), row("kornia", value=0.99), row("opencv", value=0.5, agreement="="), row("pil", value=0.25)]
    assert [(loss.peer, loss.factor, loss.agreement) for loss in losses(rows)] == [
        ("pil", 4.0, None),
        ("opencv", 2.0, "="),
    ]
    assert "opencv [=] 2.00x" in summary([], losses(rows))
    assert "nowhere slower" in summary([], losses(rows[:2]))


# -- awkward sizes


def test_awkward_sizes_have_the_pixels_of_the_round_one_and_an_aligned_neighbor():
    awkward_sizes = awkward.sizes((128, 3, 256, 256))
    assert awkward_sizes == awkward.sizes((128, 3, 256, 256)) and (49, 3, 335, 513) in awkward_sizes
    for size in awkward_sizes:
        assert size[0] * size[2] * size[3] == pytest.approx(128 * 256 * 256, rel=0.05)
    assert awkward.aligned((49, 3, 335, 513)) == (49, 3, 335, 528)
    assert awkward.aligned((31, 3, 427, 640)) == (31, 3, 427, 640)


def test_the_worst_ratio_of_a_case_is_listed():
    def at(size: str, xfloor: float, **more) -> Row:
        return replace(row(KVISION, value=xfloor, **more), size=size)

    rows = [
        at("2x3x8x15", 1.5), at("2x3x8x16", 1.2), at("2x3x9x17", 1.4), at("2x3x9x32", 1.0),
        at("2x3x8x15", 3.0, dtype="float16"), at("2x3x8x16", 1.0, dtype="float16"),
        at("2x3x7x48", 9.0), replace(at("2x3x9x17", 1.0), library="kornia"),
    ]  # fmt: skip
    worst = awkward.worst_ratios(rows, [(2, 3, 8, 15), (2, 3, 9, 17), (2, 3, 7, 48)])
    assert [(r.dtype, r.size, r.factor) for r in worst] == [("float16", "2x3x8x15", 3.0), ("float32", "2x3x9x17", 1.4)]


def test_the_table_of_common_operators_has_means_by_type_and_size():
    cost, small, large = awkward.Cost, (17, 15), (16, 32)
    measured = [
        cost("sobel", "float32", small, 2.0), cost("gray", "float32", small, 8.0), cost("copy", "float32", small, 1.1),
        cost("sobel", "float32", large, 3.0), cost("gray", "float32", large, None, "no such type"),
    ]  # fmt: skip
    table = [line.split() for line in awkward.lines(measured)]
    assert table[0] == ["17x15", "16x32"]
    assert ["gray", "float32", "8.00", "-"] in table and ["copy", "float32", "1.10", "-"] in table
    assert table[-1] == ["geometric", "mean", "float32", "4.00", "3.00"]  # without the copy


def test_the_table_of_common_operators_measures_bytes_and_a_part(capsys):
    options = ["gray", "copy", "--device", "cpu", "--types", "float16", "uint8", "--sizes", "17x15", "--pixels", "300"]
    assert awkward.main([*options, "--seconds", "0.001"]) == 0
    assert capsys.readouterr().out.count("uint8") >= 3
    assert awkward.main([*options, "--seconds", "0.001", "--limit", "0"]) == 0
    assert "(stopped by --limit)" in capsys.readouterr().out


@pytest.mark.slow
def test_command_line_measures_awkward_sizes_and_their_neighbors(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(awkward, "SHAPES", ((17, 15),))
    monkeypatch.setattr(awkward, "RANDOM_SHAPES", 0)
    out = tmp_path / "result.json"
    options = ["--sizes", "1x3x16x16", "--awkward", "--seconds", "0.003", "--peers", "opencv", "--json", str(out)]
    assert command.main(["sobel", "rgb_to_yuv420", *options]) == 0
    assert "awkward sizes" in capsys.readouterr().out
    report = json.loads(out.read_text())
    assert [(ratio["case"], ratio["size"]) for ratio in report["awkward"]] == [("sobel", "1x3x17x15")]
    libraries = {(r["size"], r["library"]) for r in report["rows"] if r["case"] == "sobel"}
    assert {("1x3x17x15", "opencv"), ("1x3x17x16", KVISION)} <= libraries and ("1x3x17x16", "opencv") not in libraries
    failed = [r for r in report["rows"] if r["case"] == "rgb_to_yuv420" and r["failure"]]
    assert {r["size"] for r in failed} == {"1x3x17x15", "1x3x17x16"}


# -- what is printed and written


def test_committed_tables_are_small_and_take_new_figures(tmp_path):
    tables = list(results.FOLDER.glob("*/*.csv"))
    assert tables and sum(len(path.read_text().splitlines()) for path in tables) <= 4000
    path, machine = (
        tmp_path / "cases.csv",
        {"date": "2026-11-28T01:02:03", "commit": "abc", "hardware": "X", "torch": "2"},
    )
    results.merge_cases(path, [row(KVISION, value=2e-3, floor=1e-3), row("opencv", value=4e-3, floor=1e-3)], machine)
    results.merge_cases(path, [row(KVISION, value=3e-3, floor=1e-3)], machine)
    about, (merged,) = results.read(path)
    assert about == ["# X, torch 2: ms"] and merged["case"] == "work" and merged["commit"] == "abc"
    assert (merged["forward"], merged["forward floor"], merged["opencv forward"]) == ("3", "1", "4")


@pytest.mark.parametrize("cuda", [False, True])
def test_table_lines_fit_the_header(cuda):
    table = Table(cuda)
    header = table.header()
    lines = [
        table.line(r)
        for r in (row(KVISION, value=2e-3, floor=1e-3), row("opencv", value=1e-3, floor=1e-3, agreement="="))
    ]
    assert all(len(line) <= len(header) + 1 for line in lines)
    case, stage, library, ms, _, _, floor, over_floor, over_kvision, _ = lines[0].split()[:10]
    assert (case, stage, library, ms, floor, over_floor, over_kvision) == ("work", FORWARD, KVISION, "2", "1", "2", "1")
    assert lines[1].split()[0] == "opencv" and lines[1].split()[6:8] == ["0.5", "="]


@pytest.mark.slow
def test_command_line(tmp_path, capsys):
    out = tmp_path / "deep" / "result.json"
    options = [
        "--sizes",
        "1x3x16x16",
        "--seconds",
        "0.003",
        "--peers",
        "opencv,scipy",
        "--backward",
        "--json",
        str(out),
    ]
    assert command.main(["sobel", "box5", *options]) == 0
    printed = capsys.readouterr().out
    assert "GB/s" in printed and "xfloor" in printed and "bars: " in printed
    report = json.loads(out.read_text())
    assert report["machine"]["threads"] == 1 and report["machine"]["copy_bandwidth"] > 1e8
    assert {"hardware", "torch", "kvision", "peers", "command", "date", "commit"} <= report["machine"].keys()
    assert {row["case"] for row in report["rows"]} == {"sobel", "box5"}
    assert {row["stage"] for row in report["rows"] if row["library"] == KVISION} == {FORWARD, BACKWARD, BOTH}
    assert {bar["what"] for bar in report["bars"]} <= {"of opencv's time"}


def test_command_line_refuses_unknown_options(capsys):
    assert command.main(["no_such_case"]) == 2
    for wrong in (["--peers", "photoshop"], ["--sizes", "3x4"], ["--dtype", "int8"]):
        with pytest.raises(SystemExit):
            command.main(wrong)


def test_photographs_are_the_same_every_time_and_fill_the_range():
    (first,), (second,) = (photographs((3, 3, 32, 48), torch.float32, CPU) for _ in range(2))
    assert torch.equal(first, second) and not torch.equal(first[0], first[1])
    assert first.min() >= 0 and first.max() <= 1 and dead_leaves((3, 32, 48)).std() > 0.1


# -- the other commands


def test_overhead(tmp_path, capsys):
    out = tmp_path / "overhead.json"
    assert overhead.main(["--calls", "2", "--blocks", "1", "--json", str(out)]) == 0
    rows = json.loads(out.read_text())["rows"]
    assert rows[0]["call"] == "aten mul" and all(r["forward"] > 0 for r in rows)


def test_sobel_figure(tmp_path, capsys):
    options = ["--repeats", "5", "--batches", "1,2", "--side", "16", "--seconds", "0.05", "--threads", "1"]
    assert sobel_figure.main([*options, "--out", str(tmp_path)]) == 0
    rows = list(csv.DictReader((tmp_path / "sobel.csv").open()))
    assert {(r["library"], r["batch"]) for r in rows} >= {("kvision cpu", "1"), ("kvision cpu", "2")}
    assert all(float(r["ms"]) > 0 and 3 <= int(r["repeats"]) <= 5 for r in rows)


@pytest.mark.native
def test_sift_cpu(capsys, monkeypatch):
    pytest.importorskip("skimage")
    monkeypatch.setattr(sift_cpu, "SIZE", (48, 64))
    monkeypatch.setattr(sift_cpu, "BATCHES", (1, 7))
    assert sift_cpu.main(["--features", "5", "--seconds", "0.003"]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    ratios = {line[0]: float(line[-1]) for line in lines if len(line) > 2 and line[0] in ("astronaut", "camera", "7")}
    assert len(ratios) == 3 and min(ratios.values()) > 0


def test_threads(capsys):
    assert threads.main(["sobel", "--sizes", "1x3x16x16", "--seconds", "0.003"]) == 0
    assert "speed-up" in capsys.readouterr().out


@pytest.fixture(autouse=True)
def same_threads():
    gc.freeze()  # clocks collect garbage before each round, among what these tests make alone
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def test_kernels_reads_what_ncu_writes():
    head = '"ID","Kernel Name","Id:Domain:Push/Pop_Range:PL_Type","Metric Name","Metric Value"'
    name = "void kv::cuda::(anonymous namespace)::sample_tiles<float, (int)2>(kv::Sample<float>, kv::cuda::Tiles, bool)"
    report = f"""==PROF== Connected
{head}
"0","{name}","0:<default domain>:warp_affine:none","gpu__time_duration.sum","69,504"
"0","{name}","0:<default domain>:warp_affine:none","launch__registers_per_thread","48"
"1","kv::cuda::<unnamed>::gather(int)","","gpu__time_duration.sum","1000"
"""
    forward, backward = kernels.rows(report)
    assert forward.split()[:4] == ["warp_affine", "sample_tiles<float,", "2>", "69.5"] and " 48 " in forward
    assert backward.split()[:3] == ["backward", "gather", "1.0"]


# -- scaling


@pytest.mark.slow
def test_scaling_on_two_processes(tmp_path, monkeypatch, capsys):
    """Two CPU processes and one give the same augmented bits and nearly the same losses; the rest are figures."""
    monkeypatch.setattr(scaling, "ALL", {name: ALL[name] for name in ("sobel", "warp_affine")})
    small = ["--batch", "40", "--size", "32", "--crop", "24", "--seconds", "0.02"]
    assert scaling.main(["--device", "cpu", "--ranks", "1,2", *small, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "64 images by seeds of samples on 1, 2 ranks: the same bits\n" in printed
    assert "2 cases on cpu, 4 threads at once: the same bits\n" in printed
    rows = json.loads((tmp_path / "scaling.json").read_text())["rows"]
    assert [row["ranks"] for row in rows] == [1, 2] and all(0 < row["share"] < 1 for row in rows)
    assert len(rows[0]["losses"]) == scaling.STEPS
    assert rows[1]["losses"] == pytest.approx(rows[0]["losses"], rel=1e-3)
    assert (tmp_path / "scaling.txt").read_text() + f"written to {tmp_path}\n" == printed


def scaled(ranks: int, alone: float, without: float, augmented: float, share: float = 0.01) -> scaling.Row:
    return scaling.Row(ranks, alone, alone / ranks, without, augmented, share, "digest", [1.0, 0.5])


def test_efficiency_is_the_rate_over_that_of_single_ranks():
    rows = [scaled(1, 100, 10, 9), scaled(2, 190, 18, 17), scaled(4, 400, 32, 27)]
    assert scaling.efficiency(rows, "alone") == pytest.approx([1, 0.95, 1])
    share, alone, training = scaling.bars(rows)
    assert share.endswith("1.00% / 3%") and alone.endswith("100.00% / 98%")
    assert training.endswith(f"{27 / 9 / (32 / 10):.2%} / 95%  MISSED")


def test_differences_between_devices_are_reported():
    one = [torch.ones(2)]
    assert scaling.compared(one, lambda: [torch.ones(2)]) == ""
    assert scaling.compared(one, lambda: [torch.tensor([1.0, 1.5])]) == "differs by 0.5"
    assert scaling.compared(one, lambda: torch.ones(2) + torch.ones(3)).startswith("RuntimeError: The size")
