"""kvision: differentiable computer vision for PyTorch with hand-written CPU and CUDA kernels.

    >>> import torch, kvision as K
    >>> K.filters.sobel(torch.rand(1, 3, 8, 8)).shape
    torch.Size([1, 3, 8, 8])
"""

import importlib
from typing import Any

from kvision import filters
from kvision._ops import backend
from kvision._version import __version__

__all__ = ["__version__", "backend", "filters", "info"]


def __getattr__(name: str) -> Any:
    if name == "info":  # imported late, because `python -m kvision.info` warns when it is loaded before it runs
        return importlib.import_module("kvision.info")
    raise AttributeError(f"module 'kvision' has no attribute {name!r}")

