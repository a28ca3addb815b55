"""The module form of a function."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from torch import Tensor, nn


class FunctionModule(nn.Module):
    """Keeps the arguments of a function as attributes and shows them in its repr.

    A plain tensor becomes a buffer, which moves with the module and is not in its state dict. An nn.Parameter stays one.

    Example:
        >>> FunctionModule(kernel_size=3)
        FunctionModule(kernel_size=3)
    """

    def __init__(self, **arguments: Any) -> None:
        super().__init__()
        self._argument_names = tuple(arguments)
        for name, value in arguments.items():
            if isinstance(value, Tensor) and not isinstance(value, nn.Parameter):
                self.register_buffer(name, value, persistent=False)
            else:
                setattr(self, name, value)

    def extra_repr(self) -> str:
        return ", ".join(f"{name}={getattr(self, name)!r}" for name in self._argument_names)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...  # the arguments, of any type
