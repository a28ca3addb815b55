"""Which devices there are, and whether autocast is on."""

from __future__ import annotations

import importlib.util

import torch
from torch import Tensor

from kvision import _check

__all__ = [
    "get_cuda_device_if_available",
    "get_cuda_or_mps_device_if_available",
    "get_mps_device_if_available",
    "is_autocast_enabled",
    "is_mps_tensor_safe",
    "xla_is_available",
]


def get_cuda_device_if_available(index: int = 0) -> torch.device:
    """Return a CUDA device, or the CPU where there is no CUDA.

    Args:
        index: number of the CUDA device.

    Returns:
        The device `cuda:index`, or `cpu`.

    Example:
        >>> import kvision as K
        >>> K.utils.get_cuda_device_if_available().type in ("cuda", "cpu")
        True
    """
    return torch.device("cuda", index) if torch.cuda.is_available() else torch.device("cpu")


def get_mps_device_if_available() -> torch.device:
    """Return Apple's GPU, or the CPU where there is none.

    Returns:
        The device `mps`, or `cpu`.

    Example:
        >>> import kvision as K
        >>> K.utils.get_mps_device_if_available().type in ("mps", "cpu")
        True
    """
    return torch.device("mps" if torch.backends.mps.is_available() else "cpu")


def get_cuda_or_mps_device_if_available() -> torch.device:
    """Return the first CUDA device, else Apple's GPU, else the CPU.

    Returns:
        The device `cuda:0`, `mps` or `cpu`.

    Example:
        >>> import kvision as K
        >>> K.utils.get_cuda_or_mps_device_if_available().type in ("cuda", "mps", "cpu")
        True
    """
    return get_cuda_device_if_available() if torch.cuda.is_available() else get_mps_device_if_available()


def is_mps_tensor_safe(x: Tensor) -> bool:
    """Tell whether a tensor is on Apple's GPU.

    Args:
        x: any tensor.

    Returns:
        True for a tensor on an MPS device.

    Raises:
        TypeCheckError: `x` is not a tensor.

    Example:
        >>> import torch, kvision as K
        >>> K.utils.is_mps_tensor_safe(torch.zeros(1))
        False
    """
    _check.is_tensor("is_mps_tensor_safe", "x", x)
    return x.device.type == "mps"


def is_autocast_enabled(both: bool = True) -> bool:
    """Tell whether autocast is on.

    Args:
        both: query every kind of device; False queries CUDA alone.

    Returns:
        True inside of an autocast block for such a device.

    Raises:
        TypeCheckError: `both` is no switch.

    Example:
        >>> import torch, kvision as K
        >>> with torch.autocast("cpu"):
        ...     K.utils.is_autocast_enabled(), K.utils.is_autocast_enabled(both=False)
        (True, False)
    """
    both = _check.switch("is_autocast_enabled", "both", both)
    return any(map(torch.is_autocast_enabled, ("cpu", "cuda", "mps", "xpu") if both else ("cuda",)))


def xla_is_available() -> bool:
    """Tell whether the package `torch_xla` is installed.

    Returns:
        True where it can be imported.

    Example:
        >>> import kvision as K
        >>> K.utils.xla_is_available() in (True, False)
        True
    """
    return importlib.util.find_spec("torch_xla") is not None
