"""Which of kvision's operators ran their kernels during a call. For the demo and the benchmarks, not for fast paths."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from kvision._torch_compat import TorchDispatchMode


def native_operators(call: Callable[[], Any]) -> list[str]:
    """Names of the operators that `call` had served by kernels, in order; empty where the references did all."""
    with _Recorder() as recorder:
        call()
    return list(dict.fromkeys(recorder.names))


class _Recorder(TorchDispatchMode):
    def __init__(self) -> None:
        super().__init__()
        self.names: list[str] = []

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func.namespace == "kvision":
            self.names.append(func.name().split("::")[1].split(".")[0])
        return func(*args, **(kwargs or {}))
