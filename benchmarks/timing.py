"""Time, memory and launches of a call, and the copy bandwidth, which defines their floors.

GPU times are CUDA events around one call that starts with none of its data in the L2 cache and the host far ahead.
CPU times are wall times of successive calls, with the caches as the previous call leaves them.
"""

from __future__ import annotations

import gc
import math
import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

Call = Callable[[], Any]


@dataclass(frozen=True)
class Timing:
    """Seconds of one call over many repeats; `spread` is the interquartile range over the median."""

    median: float
    minimum: float
    spread: float
    repeats: int

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Timing:
        median = statistics.median(seconds)
        low, _, high = statistics.quantiles(seconds, n=4) if len(seconds) > 1 else (median,) * 3
        return cls(median, min(seconds), (high - low) / median, len(seconds))


class Clock:
    """Times calls on one device.

    `race` takes several contestants and times each in every round, so that a temporary slowdown of the machine
    affects them all. A contestant is a call, or a pair (setup, call): setup runs before each timed call, untimed,
    and its result is the argument of the call.
    """

    min_calls = 2  # timed calls of a round

    def __init__(self, seconds: float = 0.5, rounds: int = 3) -> None:
        self.seconds, self.rounds = seconds, rounds

    def race(self, contestants: Sequence[Call | tuple[Call, Callable[[Any], Any]]]) -> list[Timing]:
        pairs = [c if isinstance(c, tuple) else (_no_setup, _ignoring(c)) for c in contestants]
        seconds: list[list[float]] = [[] for _ in pairs]
        gc.collect()
        gc.disable()  # garbage collection inside a timed call would add to its time
        try:
            for _ in range(self.rounds):
                for (setup, call), collected in zip(pairs, seconds):
                    call(setup())  # warm-up: caches, allocator, thread pool, compiled code
                    collected.extend(self._round(setup, call, self.seconds / self.rounds))
        finally:
            gc.enable()
        return [Timing.of(s) for s in seconds]

    def time(self, call: Call) -> Timing:
        return self.race([call])[0]

    def value(self, timing: Timing) -> float:
        """The statistic that bars and ratios use."""
        raise NotImplementedError

    def copy_bandwidth(self) -> float:
        """Bytes a second of a plain copy much larger than the caches. Reads and writes both count."""
        raise NotImplementedError

    def _round(self, setup: Call, call: Callable[[Any], Any], budget: float) -> list[float]:
        raise NotImplementedError


class CpuClock(Clock):
    def value(self, timing: Timing) -> float:
        """The minimum, because other load on the machine only adds time."""
        return timing.minimum

    def copy_bandwidth(self, megabytes: int = 512) -> float:
        threads = torch.get_num_threads()
        source, target = (np.full(megabytes << 20, fill, np.uint8) for fill in (1, 0))
        with ThreadPoolExecutor(threads) as pool:
            parts = list(zip(np.array_split(target, threads), np.array_split(source, threads)))
            seconds = self.time(lambda: list(pool.map(lambda part: np.copyto(*part), parts)))
        return 2 * source.nbytes / self.value(seconds)

    def _round(self, setup: Call, call: Callable[[Any], Any], budget: float) -> list[float]:
        seconds: list[float] = []
        deadline = time.perf_counter() + budget
        while len(seconds) < self.min_calls or time.perf_counter() < deadline:
            given = setup()
            start = time.perf_counter()
            call(given)
            seconds.append(time.perf_counter() - start)
        return seconds


class CudaClock(Clock):
    """CUDA events. Before each timed call a buffer larger than the L2 cache is written and the GPU is put to sleep for
    longer than the host needs to enqueue the call, so that the events do not include a wait for the host.
    """

    max_calls = 200  # timed calls of a round, enough for a median

    def __init__(self, seconds: float = 0.5, rounds: int = 3) -> None:
        super().__init__(seconds, rounds)
        cache = torch.cuda.get_device_properties("cuda").L2_cache_size
        self._flush = torch.empty(max(4 * cache, 64 << 20), dtype=torch.uint8, device="cuda")
        cycles = 20_000_000
        torch.cuda._sleep(cycles)
        self._cycles_per_second = cycles / self._events(lambda: torch.cuda._sleep(cycles))

    def value(self, timing: Timing) -> float:
        """The median, because nothing else runs on the device and its clock varies in both directions."""
        return timing.median

    def copy_bandwidth(self, megabytes: int = 2048) -> float:
        source = torch.ones(megabytes << 20, dtype=torch.uint8, device="cuda")
        target = torch.empty_like(source)
        return 2 * source.numel() / self.value(self.time(lambda: target.copy_(source)))

    def _round(self, setup: Call, call: Callable[[Any], Any], budget: float) -> list[float]:
        given = setup()
        torch.cuda.synchronize()
        start = time.perf_counter()
        call(given)
        host = time.perf_counter() - start
        torch.cuda.synchronize()
        whole = time.perf_counter() - start
        del given
        cycles = int(1.5 * host * self._cycles_per_second)
        repeats = min(self.max_calls, max(self.min_calls, math.ceil(budget / (whole + host))))
        events = []
        for _ in range(repeats):
            given = setup()
            self._flush.fill_(0)
            torch.cuda._sleep(cycles)
            begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
            begin.record()
            call(given)
            end.record()
            events.append((begin, end))
        torch.cuda.synchronize()
        return [begin.elapsed_time(end) * 1e-3 for begin, end in events]

    @staticmethod
    def _events(call: Call) -> float:
        begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        begin.record()
        call()
        end.record()
        end.synchronize()
        return begin.elapsed_time(end) * 1e-3


def clock(device: torch.device, seconds: float = 0.5, rounds: int = 3) -> Clock:
    return CudaClock(seconds, rounds) if device.type == "cuda" else CpuClock(seconds, rounds)


def host_seconds(call: Call, calls: int = 25, blocks: int = 15) -> float:
    """Wall time per call without synchronization: the host's cost of a call."""
    call()
    seconds = []
    for _ in range(blocks):
        torch.cuda.synchronize()
        start = time.perf_counter()
        for _ in range(calls):
            call()
        seconds.append((time.perf_counter() - start) / calls)
    torch.cuda.synchronize()
    return statistics.median(seconds)


def extra_bytes(call: Call) -> int:
    """Peak GPU memory of `call` beyond the memory in use before it and its results."""
    call()
    torch.cuda.synchronize()
    before = torch.cuda.memory_allocated()
    torch.cuda.reset_peak_memory_stats()
    kept = call()
    torch.cuda.synchronize()
    peak = torch.cuda.max_memory_allocated()
    returned = torch.cuda.memory_allocated() - before
    del kept
    return peak - before - returned


def launches(call: Call) -> int:
    """Kernels, fills and copies that one call puts on the device."""
    activities = [torch.profiler.ProfilerActivity.CPU, torch.profiler.ProfilerActivity.CUDA]
    call()
    torch.cuda.synchronize()
    with torch.profiler.profile(activities=activities) as profile:
        call()
        torch.cuda.synchronize()
    return sum(event.device_type == torch.autograd.DeviceType.CUDA for event in profile.events())


def _no_setup() -> None:
    return None


def _ignoring(call: Call) -> Callable[[Any], Any]:
    return lambda _: call()
