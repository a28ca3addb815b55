"""Calls leak no memory: the heap and the GPU's memory do not grow over thousands of them."""

from __future__ import annotations

import ctypes
import gc
import sys
import time
import warnings
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import kvision as K
from benchmarks.sample_calls import SampleCall, Size, sample_calls

pytestmark = pytest.mark.programs

SIZE = Size(1, 3, 17, 18)
WARM_UP, CALLS = 2_000, 20_000
QUICK = 5e-4  # seconds: the functions that are called take less, forward and backward
# Their results or their scratch change in size with random numbers or with the data.
EXCLUDED = ("geometry.random_intrinsics",)


class MallocInfo(ctypes.Structure):
    """glibc's struct mallinfo2."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in (
            "arena",
            "ordblks",
            "smblks",
            "hblks",
            "hblkhd",
            "usmblks",
            "fsmblks",
            "uordblks",
            "fordblks",
            "keepcost",
        )
    ]


def heap_in_use() -> int:
    """Bytes that malloc has handed out, in its arenas and as mappings of their own."""
    mallinfo2 = ctypes.CDLL(None).mallinfo2
    mallinfo2.restype = MallocInfo
    info = mallinfo2()
    return info.uordblks + info.hblkhd


def exercise(call: SampleCall, device: torch.device) -> Callable[[], None]:
    """A function of no arguments that calls one function on its tensors, forward, and backward where it has a gradient."""
    tensors = call.tensors(SIZE, device)
    leaves = {k: v.requires_grad_(v.is_floating_point()) for k, v in tensors.items()}
    wanted = [leaf for leaf in leaves.values() if leaf.requires_grad]

    def run() -> None:
        output = call.call(K, leaves)
        results = [y for y in (output if isinstance(output, (tuple, list)) else [output]) if isinstance(y, Tensor)]
        differentiable = [y for y in results if y.requires_grad]
        if differentiable and wanted:
            ones = [torch.ones_like(y) for y in differentiable]
            torch.autograd.grad(differentiable, wanted, ones, allow_unused=True)

    return run


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="mallinfo2 is glibc's")
@pytest.mark.slow
def test_calls_do_not_leak(device: torch.device) -> None:
    """At least 20,000 calls of all quick functions in turn, after 2,000, grow the heap by less than a byte a call.

    Where they grow it by more, they are called again: what leaks grows each time, a block that is allocated once does not.
    """
    if not hasattr(ctypes.CDLL(None), "mallinfo2"):
        pytest.skip("mallinfo2 came with glibc 2.33")
    warnings.simplefilter("ignore")
    runs = []
    for call in sample_calls():
        run = exercise(call, device)
        try:
            run()
        except (ValueError, RuntimeError):
            continue  # the size does not suit the function
        if min(seconds(run) for _ in range(3)) < QUICK and call.name not in EXCLUDED:
            runs.append(run)
    assert len(runs) > 150
    for _ in range(-(-WARM_UP // len(runs))):
        call_all(runs, device)
    turns = -(-CALLS // len(runs))
    calls = turns * len(runs)
    for _ in range(2):
        before = in_use(device)
        for _ in range(turns):
            call_all(runs, device)
        heap, gpu = (b - a for a, b in zip(before, in_use(device)))
        print(f"{calls} calls of {len(runs)} functions: heap {heap / calls:+.2f} bytes a call, GPU {gpu:+} bytes")
        if heap < calls and gpu <= 0:
            break
    assert heap < calls
    assert gpu <= 0


def seconds(run: Callable[[], None]) -> float:
    begin = time.perf_counter()
    run()
    return time.perf_counter() - begin


def call_all(runs: list[Callable[[], None]], device: torch.device) -> None:
    for run in runs:
        run()
    # Else more calls wait from one turn to the next, and the driver allocates for them.
    if device.type == "cuda":
        torch.cuda.synchronize()


def in_use(device: torch.device) -> tuple[int, int]:
    gc.collect()
    if device.type == "cuda":
        torch.cuda.synchronize()
        time.sleep(0.1)  # autograd's thread holds the last gradients a moment longer than their caller
        return heap_in_use(), torch.cuda.memory_allocated()
    return heap_in_use(), 0
