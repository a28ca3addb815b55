"""How much shared memory a GPU gives a block of a CUDA kernel, which limits the sizes that some kernels take."""

from __future__ import annotations

import os

import torch
from torch import Tensor

from kvision._torch_compat import constant_in_graphs

_TUNED_FOR = 227 << 10  # bytes, of compute capabilities 9.0 and 10.0


def fitting(x: Tensor, limit: int) -> int:
    """The part of `limit`, which needs up to 227 KiB, that fits the GPU of `x`; on the CPU all of it."""
    return limit * min(_shared_memory(x.device.index or 0), _TUNED_FOR) // _TUNED_FOR if x.is_cuda else limit


@constant_in_graphs
def _shared_memory(device: int) -> int:
    """The bytes a block may have; KVISION_SHARED_MEMORY lowers them, so that any GPU can test what smaller ones run."""
    chosen = int(os.environ.get("KVISION_SHARED_MEMORY") or _TUNED_FOR)
    if not torch.cuda.is_available():  # the graph of a GPU that is elsewhere
        return chosen
    properties = torch.cuda.get_device_properties(device)
    return min(chosen, getattr(properties, "shared_memory_per_block_optin", 64 << 10))
