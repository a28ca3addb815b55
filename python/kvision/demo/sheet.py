"""A sheet of the gallery: steps, each of which makes an image of every photo."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from kvision._trace import native_operators
from kvision.image import tensor_to_image

Image = np.ndarray[Any, Any]


class StepInput(NamedTuple):
    """The input of a step that does not take the photos themselves; it is shown in a column left of the result."""

    title: str
    make: Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Step:
    """One column: `call` takes the batch of photos (B, 3, H, W) in [0, 1], and `show` converts its result to images.

    `caption` is the call of kvision for photos x, and what it shows.

    `opencv` does the same work to one (H, W, 3) image.
    """

    title: str
    caption: str
    call: Callable[[Tensor], Any]
    opencv: Callable[[Image], Any] | None = None
    show: Callable[[Any], Tensor] = lambda result: result
    input: StepInput | None = None


@dataclass(frozen=True)
class Sheet:
    """A part of the gallery."""

    title: str
    steps: Sequence[Step]


@dataclass(frozen=True)
class Column:
    """The result of a step: images (B, 1 or 3, H, W), the backend that served it, its milliseconds and OpenCV's.

    `slowdown` is the middle one of its times over the quickest: what else the machine does.
    """

    title: str
    caption: str
    pictures: Tensor
    input: tuple[str, Tensor] | None
    backend: str
    ms: float
    opencv_ms: float | None
    slowdown: float


def run(step: Step, photos: Tensor) -> Column:
    """Run one step, and time it and OpenCV at the same work."""
    x = photos if step.input is None else step.input.make(photos)
    result = step.call(x)
    calls: list[Callable[[], Any]] = [lambda: step.call(x)]
    if step.opencv is not None:
        images = [np.ascontiguousarray(tensor_to_image(image)) for image in x]
        work = step.opencv
        calls.append(lambda: [work(image) for image in images])
    own, *opencv = in_turns(calls, x.device)
    return Column(
        title=step.title,
        caption=step.caption,
        pictures=step.show(result).clamp(0, 1),
        input=None if step.input is None else (step.input.title, x),
        backend="native" if native_operators(lambda: step.call(x)) else "reference",
        ms=min(own),
        opencv_ms=min(opencv[0]) if opencv else None,
        slowdown=statistics.median(own) / min(own),
    )


def in_turns(calls: Sequence[Callable[[], Any]], device: torch.device) -> list[list[float]]:
    """Milliseconds of calls in four turns, each of at least one call and of as many more as fit in 25 ms.

    Other work of the machine comes and goes: in turns it meets all calls. The first call of a turn warms up and is not counted,
    unless it is as long as the turn. The time of a call includes the wait for its result.
    """
    times: list[list[float]] = [[] for _ in calls]
    for _ in range(4):
        for call, own in zip(calls, times):
            turn: list[float] = []
            while sum(turn) < 25:
                begin = time.perf_counter()
                call()
                if device.type == "cuda":
                    torch.cuda.synchronize(device)
                turn.append((time.perf_counter() - begin) * 1e3)
            own += turn[1:] or turn
    return times


def cores_left(seconds: float = 0.2) -> float:
    """How many cores the threads of torch get, by how long they run while all of them have work."""
    x = torch.zeros(1 << 20)
    x.exp()  # starts them
    begin, began = time.perf_counter(), time.process_time()
    while time.perf_counter() - begin < seconds:
        x.exp()
    return (time.process_time() - began) / (time.perf_counter() - begin)
