"""Names older code imports for what torch does by itself today."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

__all__ = ["map_location_to_cpu", "torch_meshgrid"]


def torch_meshgrid(tensors: Sequence[Tensor], indexing: str) -> tuple[Tensor, ...]:
    """`torch.meshgrid` of a list.

    Example:
        >>> import torch, kvision as K
        >>> [grid.shape for grid in K.utils.torch_meshgrid([torch.arange(2), torch.arange(3)], "xy")]
        [torch.Size([3, 2]), torch.Size([3, 2])]
    """
    return torch.meshgrid(*tensors, indexing=indexing)


def map_location_to_cpu(storage: Any, *args: Any, **kwargs: Any) -> Any:
    """A `map_location` for `torch.load` that leaves storages on the CPU, where they are read; same as "cpu".

    Example:
        >>> import kvision as K
        >>> K.utils.map_location_to_cpu("storage", "cuda:0")
        'storage'
    """
    return storage
