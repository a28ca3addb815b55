"""Numbers that the host knows, on the device of an image: those of all calls, and those of one."""

from __future__ import annotations

import functools
from typing import Any

import torch
from torch import Tensor

from kvision._torch_compat import in_function_transform

# What captured CUDA graphs read: their replays read this memory as long as they live, which nobody can ask.
_in_graphs: dict[tuple[Any, ...], Tensor] = {}
_copied_in_graphs: list[Tensor] = []


def constant(values: tuple[Any, ...], like: Tensor, dtype: torch.dtype | None = None) -> Tensor:
    """Numbers, or rows of them, as a tensor with the device and type of `like`. Not to be written to.

    The last thousand are kept on their device: a copy waits for the device, and a CUDA graph would repeat it from memory of the
    host that has other owners by then.
    """
    dtype = dtype or like.dtype
    if type(like) is not Tensor or torch.compiler.is_compiling() or in_function_transform():
        return torch.tensor(values, device=like.device, dtype=dtype)  # a tracer stores it in the graph
    kept = _kept(values, like.device, dtype)
    if like.is_cuda and torch.cuda.is_current_stream_capturing():
        _in_graphs[values, like.device, dtype] = kept
    return kept


def on_device(numbers: Tensor, device: torch.device) -> Tensor:
    """Numbers, which nobody writes to, on a device, without waiting for it."""
    copies = device.type == "cuda" and numbers.device.type == "cpu" and not torch.compiler.is_compiling()
    if copies and torch.cuda.is_current_stream_capturing():
        numbers = numbers.pin_memory()  # as torch asks for
        _copied_in_graphs.append(numbers)  # each replay copies what is there by then
    return numbers.to(device, non_blocking=True)


@functools.lru_cache(maxsize=1024)
def _kept(values: tuple[Any, ...], device: torch.device, dtype: torch.dtype) -> Tensor:
    with torch.inference_mode(False):
        return torch.tensor(values, device=device, dtype=dtype)
