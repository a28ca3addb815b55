"""Tensors of numbers that are known before a call, on the device of an image."""

from __future__ import annotations

import functools
from typing import Any

import torch
from torch import Tensor

from kvision._torch_compat import in_function_transform


def constant(values: tuple[Any, ...], like: Tensor, dtype: torch.dtype | None = None) -> Tensor:
    """Numbers, or rows of them, as a tensor with the device and type of `like`. Not to be written to.

    Each is copied to a device once in a process: a copy waits for the device, and a CUDA graph would repeat it from memory
    of the host that has other owners by then.
    """
    dtype = dtype or like.dtype
    if type(like) is Tensor and not torch.compiler.is_compiling() and not in_function_transform():
        return _kept(values, like.device, dtype)
    return torch.tensor(values, device=like.device, dtype=dtype)  # a tracer stores it in the graph


@functools.cache
def _kept(values: tuple[Any, ...], device: torch.device, dtype: torch.dtype) -> Tensor:
    with torch.inference_mode(False):
        return torch.tensor(values, device=device, dtype=dtype)
