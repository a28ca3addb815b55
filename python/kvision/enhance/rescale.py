"""A factor as a module."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._modules import FunctionModule
from kvision.core.exceptions import TypeCheckError


class Rescale(FunctionModule):
    """Multiply images by a factor, as a module.

    Args:
        factor: a number, or a tensor without axes; an nn.Parameter is learned.

    Raises:
        TypeCheckError: factor is neither; the input is not a real tensor.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.Rescale(1 / 255)(torch.tensor([0, 255]))
        tensor([0., 1.])
    """

    def __init__(self, factor: float | Tensor) -> None:
        factor = factor if isinstance(factor, Tensor) else _check.scalar("Rescale", "factor", factor)
        if isinstance(factor, bool) or not isinstance(factor, (int, float, Tensor)):
            raise TypeCheckError(f"Rescale: expected factor to be a number or a Tensor, got {factor!r}")
        if isinstance(factor, int):
            _check.representable("Rescale", "factor", factor, torch.float64)
        if isinstance(factor, Tensor) and factor.dim() > 0:
            raise TypeCheckError(f"Rescale: expected factor without axes, got shape {tuple(factor.shape)}")
        super().__init__(factor=factor)

    def forward(self, input: Tensor) -> Tensor:
        _check.numbers("Rescale", "input", input)
        return input * self.factor
