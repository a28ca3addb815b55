"""A sheet of the gallery: steps, each of which makes an image of every photo."""

from __future__ import annotations

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
    """The result of a step: images (B, 1 or 3, H, W), the backend that served it, and its milliseconds and OpenCV's."""

    title: str
    caption: str
    pictures: Tensor
    input: tuple[str, Tensor] | None
    backend: str
    ms: float
    opencv_ms: float | None


def run(step: Step, photos: Tensor) -> Column:
    """Run one step, and time it and OpenCV at the same work."""
    x = photos if step.input is None else step.input.make(photos)
    result = step.call(x)
    opencv_ms = None
    if step.opencv is not None:
        images = [np.ascontiguousarray(tensor_to_image(image)) for image in x]
        work = step.opencv
        opencv_ms = quickest(lambda: [work(image) for image in images])
    return Column(
        title=step.title,
        caption=step.caption,
        pictures=step.show(result).clamp(0, 1),
        input=None if step.input is None else (step.input.title, x),
        backend="native" if native_operators(lambda: step.call(x)) else "reference",
        ms=quickest(lambda: step.call(x), x.device),
        opencv_ms=opencv_ms,
    )


def quickest(call: Callable[[], Any], device: torch.device | None = None) -> float:
    """Milliseconds of the quickest of at least three calls, and of as many more as fit in a tenth of a second.

    The time of a call includes the wait for its result. One more call goes first, to warm up.
    """
    times: list[float] = []
    begin = time.perf_counter()
    while len(times) < 4 or time.perf_counter() - begin < 0.1:
        start = time.perf_counter()
        call()
        if device is not None and device.type == "cuda":
            torch.cuda.synchronize(device)
        times.append(time.perf_counter() - start)
    return min(times[1:]) * 1e3
