"""`python -m benchmarks.host_time [NAMES]`: host time of a case's call, with its kernels still queued.

On one GPU, 1x3x256x256 float32, in microseconds: the public call without a gradient, the operators under it alone, and
the public call with a graph, next to torch's product in the same run. Times are the minimum of several blocks,
because other load only adds time.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import torch

from benchmarks import machine
from benchmarks.case import Case
from benchmarks.cases import ALL
from benchmarks.timing import host_seconds
from kvision import _ops

SIZE = (1, 3, 256, 256)


def microseconds(call: Callable[[], Any]) -> float:
    return min(host_seconds(call, calls=20, blocks=7) for _ in range(3)) * 1e6


def operators_of(call: Callable[[], Any]) -> list[tuple[Callable[..., Any], tuple[Any, ...]]]:
    """The operators and the kernels of fast paths that a call dispatches, with their arguments."""
    seen: list[tuple[Callable[..., Any], tuple[Any, ...]]] = []
    called = _ops.Operator.__call__
    kernels = [path.kernel for path in _ops.FastPath.all]

    def record(self: _ops.Operator, *args: Any) -> Any:
        seen.append((self, args))
        return called(self, *args)

    def recorder(kernel: Any) -> Callable[..., Any]:
        def record_kernel(*args: Any) -> Any:
            seen.append((kernel, args))
            return kernel(*args)

        return record_kernel

    _ops.Operator.__call__ = record  # type: ignore[method-assign]
    for path, kernel in zip(_ops.FastPath.all, kernels):
        path.kernel = recorder(kernel)
    try:
        call()
    finally:
        _ops.Operator.__call__ = called  # type: ignore[method-assign]
        for path, kernel in zip(_ops.FastPath.all, kernels):
            path.kernel = kernel
    return seen


def row(case: Case, device: torch.device) -> str:
    inputs = case.inputs(SIZE, torch.float32, device)
    operators = operators_of(lambda: case.call(*inputs))
    public = microseconds(lambda: case.call(*inputs))
    alone = microseconds(lambda: [operator(*args) for operator, args in operators])
    line = f"{case.name:22}{public:9.1f}{alone:11.1f}"
    if not inputs[0].is_floating_point():
        return line
    leaf = inputs[0].detach().clone().requires_grad_()
    return line + f"{microseconds(lambda: case.call(leaf, *inputs[1:])):12.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="cases; default: all")
    names = parser.parse_args().names or list(ALL)
    if not torch.cuda.is_available():
        parser.error("this needs a GPU; for the CPU there is `python -m benchmarks.overhead`")
    device = torch.device("cuda")
    x = torch.rand(SIZE, device=device)
    leaf = x.clone().requires_grad_()
    print(f"{machine.hardware(device)}  torch {torch.__version__}  $ {machine.command()}\n")
    print(f"{'case':22}{'public':>9}{'operators':>11}{'with graph':>12}")
    print(f"{'x * 2':22}{microseconds(lambda: x * 2):9.1f}{'':11}{microseconds(lambda: leaf * 2):12.1f}")
    for name in names:
        print(row(ALL[name], device), flush=True)


if __name__ == "__main__":
    main()
