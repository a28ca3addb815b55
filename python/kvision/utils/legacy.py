"""Names that older code imports. Current torch has the same features."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import torch
from torch import Tensor

from kvision import _check

__all__ = ["map_location_to_cpu", "torch_meshgrid"]


def torch_meshgrid(tensors: Sequence[Tensor], indexing: Literal["ij", "xy"]) -> tuple[Tensor, ...]:
    """Make coordinate grids, as `torch.meshgrid` does.

    Args:
        tensors: the coordinates along each axis, (N_i,).
        indexing: 'xy' or 'ij', as in `torch.meshgrid`.

    Returns:
        One grid for each tensor.

    Raises:
        ValueError: `indexing` is neither.

    Example:
        >>> import torch, kvision as K
        >>> [grid.shape for grid in K.utils.torch_meshgrid([torch.arange(2), torch.arange(3)], "xy")]
        [torch.Size([3, 2]), torch.Size([3, 2])]
    """
    _check.choice("torch_meshgrid", "indexing", indexing, ("ij", "xy"))
    return torch.meshgrid(*tensors, indexing=indexing)


def map_location_to_cpu(storage: Any, *args: Any, **kwargs: Any) -> Any:
    """Keep a loaded storage on the CPU: a `map_location` for `torch.load`, the same as "cpu".

    Args:
        storage: the storage, which `torch.load` reads into CPU memory.

    Returns:
        The same storage. Further arguments, such as the device it was saved from, are ignored.

    Example:
        >>> import kvision as K
        >>> K.utils.map_location_to_cpu("storage", "cuda:0")
        'storage'
    """
    return storage
