"""The module form of a function, and modules that hold what they are made of."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from kvision._torch_compat import LoadedModule, carry_tangents, in_function_transform


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


class StatefulModule(LoadedModule):
    """Keeps tensors that an object is made of in its state dict, under Kornia's names.

    These are `_data` of a quaternion or `_origin` of a line, unlike the arguments of a function: what was fitted or given as
    the object's content.
    """

    def _store(self, name: str, x: Tensor) -> None:
        """Keep `x` as an nn.Parameter if it is one, else as a buffer."""
        if isinstance(x, nn.Parameter):
            self.register_parameter(name, x)
        else:
            self.register_buffer(name, x)

    def _before_loading(self, state_dict: dict[str, Any], prefix: str, is_strict: bool, errors: list[str]) -> None:
        """Read the names of kvision 0.1.0, which saved nothing but parameters, and say so of a tensor that is missing."""
        for name in (*self._parameters, *self._buffers):
            key, old_key = prefix + name, prefix + name.removeprefix("_")
            if key in state_dict:
                continue
            if old_key in state_dict:
                state_dict[key] = state_dict.pop(old_key)
                continue
            reason = f'"{key}" of {type(self).__name__}: files of kvision 0.1.0 may lack rotations, lines and planes'
            if is_strict:
                errors.append(reason + ".")
            else:
                warnings.warn(f"{reason}; it keeps its value.", stacklevel=2)


def learned(x: Tensor) -> Tensor:
    """`x` as an nn.Parameter, so that an optimizer finds it, unless it belongs to a graph or cannot have a gradient."""
    return x if _keeps_its_graph(x) else nn.Parameter(x)


def as_operands(x: Tensor, *operands: Tensor) -> Tensor:
    """The result `x` of operands as :func:`learned` has it, but without a gradient unless one of them needs one."""
    return x if _keeps_its_graph(x) else nn.Parameter(x, any(operand.requires_grad for operand in operands))


def _keeps_its_graph(x: Tensor) -> bool:
    return (
        x.requires_grad
        or isinstance(x, nn.Parameter)
        or not (x.is_floating_point() or x.is_complex())
        or in_function_transform()
        or carry_tangents(x)
        or torch.compiler.is_compiling()
    )
