"""`python -m benchmarks.kernels [NAMES]`: the kernels of a case by Nsight Compute, forward and backward: what limits them.

On one GPU, whose `ncu` must be on the PATH (or in CUDA_HOME/bin) and allowed to read the counters. One line a kernel:

    us       its time                        L1%, fma%, alu%, xu%, lsu%  the fraction of the time that wavefronts of
    Minst    million instructions of a warp                              the L1 and these pipes are busy
    issue%   issue slots used                stalls                      warps that wait at an issue, by reason
    warps%   resident warps, of the maximum  rdMB, wrMB                  megabytes of device memory

and registers of a thread, threads of a block, blocks, and bytes of shared memory of a block.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks import machine
from benchmarks.__main__ import parse_dtypes, parse_sizes
from benchmarks.cases import ALL
from benchmarks.measure import tensors_of

_PIPES = ("fma", "alu", "xu", "lsu")
_STALLS = {
    "memory": "long_scoreboard",
    "barrier": "barrier",
    "shared": "short_scoreboard",
    "queue": "mio_throttle",
    "math": "math_pipe_throttle",
    "chosen": "not_selected",
    "fixed": "wait",
    "L1": "lg_throttle",
}
# (heading, width, digits, factor, metric)
_COLUMNS = [
    ("us", 8, 1, 1e-3, "gpu__time_duration.sum"),
    ("Minst", 7, 2, 1e-6, "smsp__inst_executed.sum"),
    ("issue%", 6, 0, 1, "smsp__issue_active.avg.pct_of_peak_sustained_active"),
    ("warps%", 6, 0, 1, "sm__warps_active.avg.pct_of_peak_sustained_active"),
    ("regs", 4, 0, 1, "launch__registers_per_thread"),
    ("block", 5, 0, 1, "launch__block_size"),
    ("grid", 7, 0, 1, "launch__grid_size"),
    ("smem", 6, 0, 1, "launch__shared_mem_per_block"),
    ("rdMB", 6, 0, 1e-6, "dram__bytes_read.sum"),
    ("wrMB", 6, 0, 1e-6, "dram__bytes_write.sum"),
    ("L1%", 4, 0, 1, "l1tex__data_pipe_lsu_wavefronts.avg.pct_of_peak_sustained_elapsed"),
    *((f"{pipe}%", 4, 0, 1, f"sm__inst_executed_pipe_{pipe}.avg.pct_of_peak_sustained_active") for pipe in _PIPES),
    *(
        (name, max(4, len(name)), 1, 1, f"smsp__average_warps_issue_stalled_{reason}_per_issue_active.ratio")
        for name, reason in _STALLS.items()
    ),
]
_INSIDE = "KVISION_BENCHMARKS_UNDER_NCU"


def run(names: list[str], size: tuple[int, ...], dtype: torch.dtype) -> None:
    """The program that ncu profiles: each case once forward and backward, after a call that is not profiled."""
    for name in names:
        first, *rest = ALL[name].inputs(size, dtype, torch.device("cuda"))
        call_watched(name, lambda x, name=name, rest=rest: ALL[name].call(x, *rest), first)


def call_watched(name: str, call: Callable[[Tensor], Any], x: Tensor) -> None:
    """Call once forward and backward under the profiler, after a call that is not profiled."""
    call(x)
    with _watched(), torch.cuda.nvtx.range(name):
        call(x)
    if not x.is_floating_point():
        return
    leaf = x.detach().requires_grad_()
    outputs = [y for y in tensors_of(call(leaf)) if y.requires_grad]
    grads = [torch.ones_like(y) for y in outputs]
    with _watched():  # torch's autograd engine runs in another thread, outside of this thread's range
        torch.autograd.grad(outputs, leaf, grads)


@contextlib.contextmanager
def _watched() -> Iterator[None]:
    torch.cuda.synchronize()
    torch.cuda.profiler.start()
    yield
    torch.cuda.synchronize()
    torch.cuda.profiler.stop()


def rows(report: str, names: Sequence[str] = tuple(ALL)) -> Iterator[str]:
    """Parse ncu's CSV into a row for each kernel, with the name of its range."""
    names = sorted(names, key=len, reverse=True)  # some begin as others
    lines = report[report.index('"ID"') :].splitlines()
    kernels: dict[str, dict[str, str]] = {}
    for row in csv.DictReader(lines):
        kernel = kernels.setdefault(row["ID"], {})
        kernel["name"] = _short(row["Kernel Name"])
        kernel["range"] = next((v for k, v in row.items() if "Range" in k and v), "")
        kernel[row["Metric Name"]] = row["Metric Value"].replace(",", "")
    for kernel in kernels.values():
        case = next((n for n in names if re.search(rf"(?<!\w){re.escape(n)}(?!\w)", kernel["range"])), "  backward")
        figures = " ".join(
            f"{_number(kernel.get(metric)) * by:{width}.{digits}f}" for _, width, digits, by, metric in _COLUMNS
        )
        yield f"{case:20} {kernel['name']:36} {figures}"


def _number(value: str | None) -> float:
    try:
        return float(value or "nan")
    except ValueError:  # "n/a", where the chip has no such counter
        return float("nan")


def _short(kernel: str) -> str:
    """`sample_tiles<float, 2>` of void kv::filters::cuda::(anonymous namespace)::sample_tiles<float, (int)2>(...)."""
    kernel = re.sub(r"^void |\(anonymous namespace\)::|<?unnamed>::|\b\w+::|\((int|bool|unsigned long)\)", "", kernel)
    return kernel.partition("(")[0][:36]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="cases; default: all")
    parser.add_argument("--sizes", type=parse_sizes, default=[(128, 3, 256, 256)], help="one; default: 128x3x256x256")
    parser.add_argument("--dtype", type=parse_dtypes, default=[torch.float32], help="one; default: float32")
    options = parser.parse_args()
    names, size, dtype = options.names or list(ALL), options.sizes[0], options.dtype[0]
    if is_watched():
        return run(names, size, dtype)
    try:
        print_kernels("benchmarks.kernels", names)
    except FileNotFoundError as error:
        parser.error(str(error))


def is_watched() -> bool:
    """Whether this process is the program that ncu profiles."""
    return _INSIDE in os.environ


def print_kernels(module: str, names: Sequence[str]) -> None:
    """Run a module with the arguments of this program again, under ncu, and print its kernels by the names of their ranges."""
    ncu = shutil.which("ncu") or shutil.which(
        "ncu", path=str(Path(os.environ.get("CUDA_HOME", "/usr/local/cuda")) / "bin")
    )
    if ncu is None or not torch.cuda.is_available():
        raise FileNotFoundError("this needs a GPU, and Nsight Compute's ncu on the PATH or in CUDA_HOME/bin")
    metrics = ",".join(metric for *_, metric in _COLUMNS)
    watched = [sys.executable, "-m", module, *sys.argv[1:]]
    flags = ["--clock-control", "none", "--profile-from-start", "off", "--nvtx", "--csv", "--print-units", "base"]
    done = subprocess.run(
        [ncu, *flags, "--metrics", metrics, *watched],
        env={**os.environ, _INSIDE: "1"},
        capture_output=True,
        text=True,
    )
    if done.returncode or '"ID"' not in done.stdout:
        sys.exit(f"ncu ended with {done.returncode}:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    print(f"{machine.hardware(torch.device('cuda'))}  torch {torch.__version__}  $ {machine.command()}\n")
    headings = " ".join(f"{name:>{width}}" for name, width, *_ in _COLUMNS)
    print(f"{'case':20} {'kernel':36} {headings}")
    for row in rows(done.stdout, names):
        print(row, flush=True)


if __name__ == "__main__":
    main()
