"""The module form of a function, and modules that hold what they are made of."""

from __future__ import annotations

import functools
import re
import warnings
from itertools import product
from types import FunctionType
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor, nn

from kvision._torch_compat import ConstantModule, LoadedModule, carry_tangents, in_function_transform


class Sample:
    """The shape of an image, or of what else a function takes, and its type."""

    def __init__(self, *shape: int, dtype: torch.dtype = torch.float32) -> None:
        self.shape, self.dtype = shape, dtype

    def batch(self, size: int, channels: int, device: torch.device) -> Tensor:
        """`size` samples; `channels` counts if it is not 0."""
        inner = (channels, *self.shape[1:]) if channels and len(self.shape) > 2 else self.shape
        return torch.empty((size, *inner), dtype=self.dtype, device=device)


IMAGE, PLANE, VOLUME = Sample(3, 256, 256), Sample(1, 256, 256), Sample(3, 64, 64, 64)
LABELS = Sample(256, 256, dtype=torch.int64)


_MOST_SAMPLES = 16  # of a constructor's call


class FunctionModule(ConstantModule):
    """Keeps the arguments of a function as attributes and shows them in its repr.

    A plain tensor becomes a buffer, which moves with the module and is not in its state dict. An nn.Parameter stays one.
    What every call would refuse, the constructor refuses: it calls the function on no samples, whose checks are the only ones.

    Example:
        >>> FunctionModule(kernel_size=3)
        FunctionModule(kernel_size=3)
    """

    samples: ClassVar[tuple[Sample, ...]] = (IMAGE,)  # what the forward takes, without the batch

    def __init__(self, **arguments: Any) -> None:
        super().__init__()
        self._argument_names = tuple(arguments)
        for name, value in arguments.items():
            if isinstance(value, Tensor) and not isinstance(value, nn.Parameter) and not hasattr(nn.Module, name):
                self.register_buffer(name, value, persistent=False)
            else:
                setattr(self, name, value)
        tensors = [x for x in arguments.values() if isinstance(x, Tensor)]
        has_values = not any(x.is_meta for x in tensors) and not torch.compiler.is_compiling()
        if has_values and type(self).forward is not nn.Module.forward:
            self._refuse_wrong_arguments(tensors)

    def _refuse_wrong_arguments(self, tensors: list[Tensor]) -> None:
        """Raise the error of a call on no samples that names an argument of the constructor; others depend on the images."""
        device = next((x.device for x in tensors if x.device.type != "cpu"), torch.device("cpu"))
        error = self._error_of_a_call(0, 0, device)
        subject = re.match(r"\w+: (?:expected )?(\w+)", str(error))
        if subject is None or not any(name.endswith(subject[1]) for name in self._argument_names):
            return
        lengths = {len(x) for name in self._argument_names if isinstance(x := getattr(self, name), (tuple, list))}
        sizes = (0, *sorted({n for x in tensors for n in x.shape if n > 0} | lengths))
        if isinstance(error, ValueError) and len(sizes) > 1:
            # What has a row for each sample or channel fits some number of them. One of more axes may have the size of images.
            calls = (self._error_of_a_call(*each, device) for each in product(sizes, sizes))
            is_known = sizes[-1] <= _MOST_SAMPLES and all(x.dim() < 3 for x in tensors)
            if not is_known or any(not isinstance(each, (TypeError, ValueError)) for each in calls):
                return
        raise error  # type: ignore[misc]  # it has a text

    def _error_of_a_call(self, batch: int, channels: int, device: torch.device) -> Exception | None:
        try:
            with torch.no_grad():
                self.forward(*(sample.batch(batch, channels, device) for sample in self.samples))
        except Exception as error:
            return error
        return None

    def extra_repr(self) -> str:
        return ", ".join(f"{name}={getattr(self, name)!r}" for name in self._argument_names)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...  # the arguments, of any type


def give_own_forward(cls: type[nn.Module]) -> None:
    """Give a class that inherits `forward` a copy with code of its own, to be called when the class is made.

    torch.compile keeps eight graphs of a code, whichever classes it runs for: the ninth class would hit the limit.
    """
    if "forward" in vars(cls):
        return
    inherited = (vars(base).get("forward") for base in cls.__mro__)
    forward: Any = next(f for f in inherited if f is not None and not hasattr(f, "__wrapped__"))
    code = forward.__code__.replace()
    own = FunctionType(code, forward.__globals__, forward.__name__, forward.__defaults__, forward.__closure__)
    own.__kwdefaults__ = forward.__kwdefaults__
    cls.forward = functools.update_wrapper(own, forward)


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
