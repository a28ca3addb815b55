"""The libraries that kvision is compared with: their inputs, number of threads, and agreement of results.

Every peer gets its inputs in its fastest layout, prepared in advance. Tensor libraries are called once on the batch.
NumPy libraries and OpenCV go image by image over contiguous (H, W, C) arrays; OpenCV writes into outputs and scratch
that were allocated beforehand, and scratch is shared by the images, so that it stays in the cache.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.timing import Call

Work = Callable[..., Any]


@dataclass(frozen=True)
class Bound:
    """Work bound to its inputs: `call` runs it once, `result` converts its output to a (B, C, ...) tensor."""

    call: Call
    result: Callable[[], Tensor]


@dataclass(frozen=True)
class Peer:
    """A library to compare with. `bind(work, inputs, result)` creates its call. `tensors` marks tensor libraries."""

    name: str
    module: str
    bind: Callable[[Work, Sequence[Tensor], Callable[[Any], Tensor]], Bound]
    tensors: bool = False

    @property
    def installed(self) -> bool:
        return importlib.util.find_spec(self.module) is not None

    @property
    def version(self) -> str:
        return importlib.import_module(self.module).__version__

    def serves(self, device: torch.device, dtype: torch.dtype) -> bool:
        return self.tensors or (device.type == "cpu" and dtype == torch.float32)


def tensors(work: Work, inputs: Sequence[Tensor], result: Callable[[Any], Tensor]) -> Bound:
    """Call `work(*inputs)` on the batch."""

    def call() -> Any:
        return work(*inputs)

    return Bound(call, lambda: result(call()).detach())


def arrays(work: Work, inputs: Sequence[Tensor], result: Callable[[Any], Tensor]) -> Bound:
    """Call `work(image, ...)` for each sample; each call allocates its result."""
    samples = _samples(inputs)

    def call() -> list[Any]:
        return [work(*sample) for sample in samples]

    return Bound(call, lambda: _batch(call()))


def opencv(work: Work, inputs: Sequence[Tensor], result: Callable[[Any], Tensor]) -> Bound:
    """Call `work(image, ..., out, *scratch)` for each sample. A first `work(image, ...)` allocates output and scratch.

    `work` returns its output, or a tuple of its output and its scratch arrays; an output is an array or a list of them.
    """
    samples = _samples(inputs)
    first = work(*samples[0])
    output, *scratch = first if isinstance(first, tuple) else (first,)
    outputs = [_like(output) for _ in samples]

    def call() -> None:
        for sample, out in zip(samples, outputs):
            work(*sample, out, *scratch)

    def computed() -> Tensor:
        call()
        return _batch(outputs)

    return Bound(call, computed)


def pillow(work: Work, inputs: Sequence[Tensor], result: Callable[[Any], Tensor]) -> Bound:
    """Call `work(image)` for each sample, an 8-bit RGB image. The result is an image or an array."""
    from PIL import Image

    images = [Image.fromarray(np.rint(sample[0] * 255).astype(np.uint8)) for sample in _samples(inputs)]

    def call() -> list[Any]:
        return [work(image) for image in images]

    return Bound(call, lambda: _batch([np.asarray(output) for output in call()]))


PEERS = {
    peer.name: peer
    for peer in (
        Peer("kornia", "kornia", tensors, tensors=True),
        Peer("torchvision", "torchvision", tensors, tensors=True),
        Peer("opencv", "cv2", opencv),
        Peer("skimage", "skimage", arrays),
        Peer("scipy", "scipy", arrays),
        Peer("pil", "PIL", pillow),
    )
}


def optional(module: str) -> ModuleType | None:
    """Import a module, or return None where it is not installed. Cases name their peers' functions through it."""
    return importlib.import_module(module) if importlib.util.find_spec(module.split(".")[0]) else None


def set_threads(threads: int) -> None:
    """Let torch and OpenCV use that many threads; the other peers are single-threaded."""
    torch.set_num_threads(threads)
    if PEERS["opencv"].installed:
        importlib.import_module("cv2").setNumThreads(threads)


def agreement(ours: Tensor, theirs: Tensor, border: int) -> str:
    """How close two results are, relative to the range of ours, as one character.

    `=` equal up to rounding (1e-3, 1e-2 for half types), `b` equal but for `border` pixels along the border, `~` close
    (mean error up to 1e-2), `x` different.
    """
    if ours.shape != theirs.shape:
        return "x"
    exact = 1e-3 if torch.finfo(ours.dtype).bits >= 32 else 1e-2
    ours, theirs = ours.double(), theirs.to(ours.device, torch.float64)
    error = (ours - theirs).abs() / (ours.max() - ours.min())
    inner = error[..., border:-border, border:-border] if border else error
    for sign, figure, limit in (("=", error.max(), exact), ("b", _max(inner), exact), ("~", error.mean(), 1e-2)):
        if figure <= limit:  # false for NaN
            return sign
    return "x"


def _max(x: Tensor) -> Tensor:
    return x.max() if x.numel() else x.new_tensor(torch.inf)


def _samples(inputs: Sequence[Tensor]) -> list[tuple[np.ndarray, ...]]:
    """The arrays of each sample: (H, W, C) for an image, (H, W) if C is 1. An input of batch 1 is repeated."""
    batch = max(map(len, inputs))
    return list(zip(*([_array(sample) for sample in x.expand(batch, *x.shape[1:])] for x in inputs)))


def _array(sample: Tensor) -> np.ndarray:
    array = sample.detach().cpu().numpy()
    if array.ndim == 3:
        array = array[0] if len(array) == 1 else array.transpose(1, 2, 0)
    return np.ascontiguousarray(array)


def _batch(outputs: Sequence[Any]) -> Tensor:
    """Stack results (H, W) to (B, 1, H, W), (H, W, C) to (B, C, H, W), lists of n to (B, C, n, H, W). Bytes are scaled."""
    return torch.stack([_tensor(output) for output in outputs])


def _tensor(output: Any) -> Tensor:
    if isinstance(output, list):
        return torch.stack([_tensor(plane) for plane in output], 1)
    image = torch.from_numpy(np.array(output))  # a copy, because the memory of a Pillow image is read-only
    if image.dtype == torch.uint8:
        image = image / 255
    return image.unsqueeze(0) if image.ndim == 2 else image.permute(2, 0, 1)


def _like(output: Any) -> Any:
    return [_like(plane) for plane in output] if isinstance(output, list) else np.empty_like(output)
