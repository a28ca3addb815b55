"""Large inputs in chunks."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from kvision import _check

__all__ = ["batched_forward"]


def batched_forward(
    model: nn.Module, data: Tensor, device: str | torch.device, batch_size: int = 128, **kwargs: Any
) -> Tensor:
    """Run a module on a batch too large for the device, chunk by chunk.

    Args:
        model: a module with one tensor as result; it is moved to `device`.
        data: (B, ...), on any device.
        device: where the module runs.
        batch_size: samples at a time.
        kwargs: passed on to the module.

    Returns:
        The results of all chunks, (B, ...), on the device of `data`.

    Raises:
        TypeCheckError: `data` is not a tensor, or `batch_size` not an int.
        ValueCheckError: `batch_size` is less than 1.

    Example:
        >>> import torch, kvision as K
        >>> K.utils.batched_forward(torch.nn.Flatten(), torch.rand(300, 2, 2), "cpu").shape
        torch.Size([300, 4])
    """
    _check.is_tensor("batched_forward", "data", data)
    (batch_size,) = _check.ints("batched_forward", "batch_size", batch_size, 1)
    model = model.to(device)
    return torch.cat([model(chunk.to(device), **kwargs).to(data.device) for chunk in data.split(batch_size)])
