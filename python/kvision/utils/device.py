"""What hardware and which modes are on."""

from __future__ import annotations

import importlib.util

import torch
from torch import Tensor

__all__ = [
    "get_cuda_device_if_available",
    "get_cuda_or_mps_device_if_available",
    "get_mps_device_if_available",
    "is_autocast_enabled",
    "is_mps_tensor_safe",
    "xla_is_available",
]


def get_cuda_device_if_available(index: int = 0) -> torch.device:
    """The CUDA device of this number, or the CPU where there is no CUDA.

    Example:
        >>> import kvision as K
        >>> K.utils.get_cuda_device_if_available().type in ("cuda", "cpu")
        True
    """
    return torch.device("cuda", index) if torch.cuda.is_available() else torch.device("cpu")


def get_mps_device_if_available() -> torch.device:
    """Apple's GPU, or the CPU where there is none.

    Example:
        >>> import kvision as K
        >>> K.utils.get_mps_device_if_available().type in ("mps", "cpu")
        True
    """
    return torch.device("mps" if torch.backends.mps.is_available() else "cpu")


def get_cuda_or_mps_device_if_available() -> torch.device:
    """The first CUDA device, else Apple's GPU, else the CPU.

    Example:
        >>> import kvision as K
        >>> K.utils.get_cuda_or_mps_device_if_available().type in ("cuda", "mps", "cpu")
        True
    """
    return get_cuda_device_if_available() if torch.cuda.is_available() else get_mps_device_if_available()


def is_mps_tensor_safe(x: Tensor) -> bool:
    """Whether `x` is on Apple's GPU.

    Example:
        >>> import torch, kvision as K
        >>> K.utils.is_mps_tensor_safe(torch.zeros(1))
        False
    """
    return x.device.type == "mps"


def is_autocast_enabled(both: bool = True) -> bool:
    """Whether autocast is on: for any kind of device, or with `both=False` for CUDA alone.

    Example:
        >>> import torch, kvision as K
        >>> with torch.autocast("cpu"):
        ...     K.utils.is_autocast_enabled(), K.utils.is_autocast_enabled(both=False)
        (True, False)
    """
    return any(map(torch.is_autocast_enabled, ("cpu", "cuda", "mps", "xpu") if both else ("cuda",)))


def xla_is_available() -> bool:
    """Whether the package `torch_xla` is installed.

    Example:
        >>> import kvision as K
        >>> K.utils.xla_is_available() in (True, False)
        True
    """
    return importlib.util.find_spec("torch_xla") is not None
