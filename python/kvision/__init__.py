"""kvision: differentiable computer vision for PyTorch with hand-written CPU and CUDA kernels.

    >>> import torch, kvision as K
    >>> K.filters.sobel(torch.rand(1, 3, 8, 8)).shape
    torch.Size([1, 3, 8, 8])
"""

from kvision import filters
from kvision._ops import backend
from kvision._version import __version__

__all__ = ["__version__", "backend", "filters"]
