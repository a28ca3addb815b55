"""Images that tests of features detect on."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor


def photo(height: int = 120, width: int = 150, dtype: torch.dtype = torch.float64) -> Tensor:
    data = pytest.importorskip("skimage.data")
    return torch.from_numpy(data.camera())[None, None, 100 : 100 + height, 150 : 150 + width].to(dtype) / 255


def blobs(centers: Tensor, sigma: float, size: int) -> Tensor:
    """An image with a Gaussian blob at each of the points (N, 2)."""
    grid = torch.arange(size, dtype=torch.float64)
    x, y = (torch.exp(-((grid - c[:, None]) ** 2) / (2 * sigma**2)) for c in centers.T)
    return torch.einsum("nh,nw->hw", y, x)[None, None]
