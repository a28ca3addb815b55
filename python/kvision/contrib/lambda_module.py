"""Any function as a module."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import nn

from kvision.core.exceptions import TypeCheckError


class Lambda(nn.Module):
    """Wrap a function as a module, say for nn.Sequential.

    Args:
        func: what a call of the module calls, with all its arguments.

    Raises:
        TypeCheckError: func cannot be called.

    Example:
        >>> import torch, kvision as K
        >>> K.contrib.Lambda(torch.neg)(torch.ones(2))
        tensor([-1., -1.])
    """

    def __init__(self, func: Callable[..., Any]) -> None:
        super().__init__()
        if not callable(func):
            raise TypeCheckError(f"Lambda: expected func to be callable, got {func!r}", actual_type=type(func))
        self.func = func

    def forward(self, img: Any, *args: Any, **kwargs: Any) -> Any:
        return self.func(img, *args, **kwargs)

    def extra_repr(self) -> str:
        return getattr(self.func, "__name__", repr(self.func))
