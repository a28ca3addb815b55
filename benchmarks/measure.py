"""Runs cases and yields one row for each library and stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from benchmarks import timing
from benchmarks.case import Case, Size, nbytes
from benchmarks.peers import PEERS, agreement, tensors
from benchmarks.timing import Clock, Timing

KVISION = "kvision"
FORWARD, BACKWARD, BOTH = "forward", "backward", "forward+backward"


@dataclass(frozen=True)
class Row:
    """One library's figures for one stage of a case; a `failure` replaces them. Times are seconds.

    `value` is the time that bars apply to (Clock.value), `floor` the time of the memory traffic alone. `extra` is the
    peak GPU memory beyond inputs and results, in units of input + output; `launches` counts the kernels, fills and copies
    of one call; `host` is the host's time for a call on one image.
    """

    case: str
    size: str
    dtype: str
    library: str
    stage: str
    value: float | None = None
    timing: Timing | None = None
    floor: float | None = None
    agreement: str | None = None
    extra: float | None = None
    launches: int | None = None
    host: float | None = None
    failure: str | None = None


def name_of(dtype: torch.dtype) -> str:
    return str(dtype).removeprefix("torch.")


def size_name(size: Size) -> str:
    return "x".join(map(str, size))


def measure(
    case: Case,
    size: Size,
    dtype: torch.dtype,
    device: torch.device,
    peers: Sequence[str],
    clock: Clock,
    bandwidth: float,
    *,
    backward: bool = False,
    batch_one: bool = False,
) -> Iterator[Row]:
    """Measure `case` at one size. `bandwidth`, bytes a second, sets the floors. `batch_one` adds the host time."""
    where = (case.name, size_name(size), name_of(dtype))
    on_gpu = device.type == "cuda"
    if on_gpu:
        torch.cuda.empty_cache()  # the previous case's cached blocks would count for this case
    inputs = case.inputs(size, dtype, device)
    outputs = tensors_of(case.call(*inputs))
    floors = {
        FORWARD: case.forward(inputs, outputs) / bandwidth,
        BACKWARD: case.backward(inputs, outputs) / bandwidth,
    }
    floors[BOTH] = floors[FORWARD] + floors[BACKWARD]
    unit = nbytes(inputs) + nbytes(outputs)
    del outputs

    bound = {KVISION: tensors(case.call, inputs, case.result)}
    signs: dict[str, str] = {}
    ours = bound[KVISION].result()
    for peer in (PEERS[name] for name in peers if name in case.peers and PEERS[name].serves(device, dtype)):
        try:
            candidate = peer.bind(case.peers[peer.name], inputs, case.result)
            signs[peer.name] = agreement(ours, candidate.result(), case.border)
            bound[peer.name] = candidate
        except Exception as error:  # a peer may fail in any way; the table reports it and continues
            yield Row(*where, peer.name, FORWARD, failure=_words(error))
    del ours

    for library, measured in zip(bound, clock.race([b.call for b in bound.values()])):
        call = bound[library].call
        yield Row(
            *where,
            library,
            FORWARD,
            value=clock.value(measured),
            timing=measured,
            floor=floors[FORWARD],
            agreement=signs.get(library),
            extra=timing.extra_bytes(call) / unit if on_gpu else None,
            launches=timing.launches(call) if on_gpu else None,
            host=_host(case, library, dtype, device) if on_gpu and batch_one else None,
        )
    if not backward:
        return

    stages: dict[str, dict[str, Any]] = {BACKWARD: {}, BOTH: {}}
    for library in bound:
        if library != KVISION and not PEERS[library].tensors:
            continue
        try:
            step = Step(_work(case, library), inputs)
            step()
            stages[BACKWARD][library] = (step.forward, step.backward)
            stages[BOTH][library] = step
        except Exception as error:
            yield Row(*where, library, BOTH, failure=_words(error))
    for stage, contestants in stages.items():
        for (library, call), measured in zip(contestants.items(), clock.race(list(contestants.values()))):
            yield Row(
                *where,
                library,
                stage,
                value=clock.value(measured),
                timing=measured,
                floor=floors[stage],
                extra=timing.extra_bytes(call) / unit if on_gpu and stage == BOTH else None,
            )


class Step:
    """Forward and backward of `work` by its first input: separate as methods, both when called."""

    def __init__(self, work: Callable[..., Any], inputs: Sequence[Tensor]) -> None:
        self._work, self._leaf, self._rest = work, inputs[0].detach().requires_grad_(), inputs[1:]
        self._upstream = [torch.rand_like(output) for output in self.forward()]

    def forward(self) -> list[Tensor]:
        return [output for output in tensors_of(self._work(self._leaf, *self._rest)) if output.requires_grad]

    def backward(self, outputs: list[Tensor]) -> tuple[Tensor, ...]:
        return torch.autograd.grad(outputs, self._leaf, self._upstream)

    def __call__(self) -> Any:
        outputs = self.forward()
        return outputs, self.backward(outputs)


def _work(case: Case, library: str) -> Callable[..., Any]:
    return case.call if library == KVISION else case.peers[library]


def _host(case: Case, library: str, dtype: torch.dtype, device: torch.device) -> float:
    inputs = case.inputs((1, 3, 256, 256), dtype, device)
    work = _work(case, library)
    return timing.host_seconds(lambda: work(*inputs))


def tensors_of(output: Any) -> list[Tensor]:
    return [output] if isinstance(output, Tensor) else list(output)


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"[:160]
