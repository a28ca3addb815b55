"""Records which operators of kvision a call ran natively; for the demo and the benchmarks, too slow for other calls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from kvision._torch_compat import TorchDispatchMode


def native_operators(call: Callable[[], Any]) -> list[str]:
    """Names of the operators whose kernels served `call`, in order; empty where references served all of it."""
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
