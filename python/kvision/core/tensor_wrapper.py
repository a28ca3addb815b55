"""A base for classes that are a tensor with a name: points, scalars, vectors."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator
from typing import Any

from torch import Tensor

from kvision import _check

__all__ = ["TensorWrapper"]


class TensorWrapper:
    """Holds a tensor and behaves like it: torch functions, methods, attributes and operators give the wrapper's class.

    A result in a list or tuple is wrapped as well; one that is not a tensor (a shape, a float) is returned as it is.
    Operators such as `+=` change the wrapped tensor in place. `bool`, `int`, `float` and `len` give Python values.

    Args:
        data: a tensor, or a wrapper whose tensor is taken over.

    Raises:
        TypeCheckError: `data` is not a tensor.

    Example:
        >>> import torch, kvision as K
        >>> x = K.core.TensorWrapper(torch.tensor([3.0, 4.0]))
        >>> 2 * x
        TensorWrapper(tensor([6., 8.]))
        >>> torch.linalg.norm(x).unwrap()
        tensor(5.)
    """

    def __init__(self, data: Tensor | TensorWrapper) -> None:
        tensor = _unwrap(data)
        _check.is_tensor(type(self).__name__, "data", tensor)
        self._data: Tensor = tensor

    @property
    def data(self) -> Tensor:
        """The tensor itself."""
        return self._data

    def unwrap(self) -> Tensor:
        """The tensor itself."""
        return self._data

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._data})"

    def __getattr__(self, name: str) -> Any:
        # Only names this class lacks arrive here. Special ones are asked for by copy and pickle, before _data is set.
        if name == "_data" or name.startswith("__"):
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        value = getattr(self._data, name)
        if not callable(value):
            return self._wrap(value)
        return lambda *args, **kwargs: self._wrap(value(*_unwrap(args), **_unwrap(kwargs)))

    def __iter__(self) -> Iterator[Any]:
        return map(self._wrap, self._data)

    @classmethod
    def __torch_function__(
        cls, func: Callable[..., Any], types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        return cls._wrap(func(*_unwrap(args), **_unwrap(kwargs or {})))

    @classmethod
    def _wrap(cls, value: Any) -> Any:
        """`value` with its tensors in this class. Subclasses whose last axis has a meaning may refuse some."""
        if isinstance(value, Tensor):
            return cls(value)
        return type(value)(map(cls._wrap, value)) if type(value) in (list, tuple) else value


def _unwrap(value: Any) -> Any:
    if isinstance(value, TensorWrapper):
        return value._data
    if type(value) in (list, tuple):
        return type(value)(map(_unwrap, value))
    return {k: _unwrap(v) for k, v in value.items()} if type(value) is dict else value


def _forward(name: str) -> Callable[..., Any]:
    """The special method `name`, which Python looks up on the class without calling `__getattr__`."""

    def method(self: TensorWrapper, *args: Any, **kwargs: Any) -> Any:
        return self._wrap(getattr(self._data, name)(*_unwrap(args), **_unwrap(kwargs)))

    return method


def _forward_in_place(name: str) -> Callable[..., Any]:
    update = getattr(operator, name)

    def method(self: TensorWrapper, other: Any) -> TensorWrapper:
        self._data = update(self._data, _unwrap(other))
        return self

    return method


_BINARY = ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow", "matmul", "and", "or", "xor", "lshift", "rshift")
_COMPARISON = ("eq", "ne", "lt", "le", "gt", "ge")
_UNARY = ("neg", "pos", "abs", "invert", "bool", "int", "float", "complex", "index", "len")
_ACCESS = ("getitem", "setitem", "contains", "array", "dlpack", "dlpack_device")
for _name in (*_BINARY, *(f"r{_name}" for _name in _BINARY), *_COMPARISON, *_UNARY, *_ACCESS):
    setattr(TensorWrapper, f"__{_name}__", _forward(f"__{_name}__"))
for _name in _BINARY:
    setattr(TensorWrapper, f"__i{_name}__", _forward_in_place(f"__i{_name}__"))
